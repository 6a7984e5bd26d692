"""Some other ROS program, for the tests: does what lines of JSON on its standard input say, answers on its output.

Run as a process; knows nothing of the package, unless its first argument is --interfaces: then it makes the classes of
packages that are not installed with the package's help.
"""

import importlib
import json
import sys
import threading
import time

import rclpy
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_system_default

QOS = {
    "default": qos_profile_system_default,
    "reliable": QoSProfile(depth=100),
    "best_effort": QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT),
    "latched": QoSProfile(
        depth=10, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
    ),
}


def kind(name):
    package, group, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.{group}"), short)


def plain(value):
    """Return a message as JSON holds it."""
    if hasattr(value, "get_fields_and_field_types"):
        return {field: plain(getattr(value, field)) for field in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, str | int | float | bool):
        return value
    return [plain(element) for element in value]


def filled(message, data):
    """Fill a message from JSON."""
    types = message.get_fields_and_field_types()
    for field, value in data.items():
        inner = getattr(message, field)
        if isinstance(value, dict):
            filled(inner, value)
        elif types[field].startswith("sequence<") and value and isinstance(value[0], dict):
            setattr(message, field, [filled(kind(_full(types[field]))(), element) for element in value])
        elif types[field] == "octet":
            setattr(message, field, bytes([value]))
        else:
            setattr(message, field, value)
    return message


def _full(text):
    package, _, short = text.removeprefix("sequence<").rstrip(">").partition("/")
    return f"{package}/msg/{short}"


class Peer:
    def __init__(self):
        rclpy.init()
        self.executor = rclpy.executors.SingleThreadedExecutor()
        self.lock = threading.Lock()
        self._make_node()

    def _make_node(self):
        self.node = rclpy.create_node("peer")
        self.executor.add_node(self.node)
        self.publishers, self.clients, self.timers, self.subscriptions = {}, {}, {}, {}
        self.actions, self.goals, self.requests = {}, {}, []

    def begin(self):
        """Begin anew, with another node: for the tests of another module."""
        for client in self.actions.values():
            client.destroy()
        self.executor.remove_node(self.node)
        self.node.destroy_node()
        self._make_node()
        self.say(done="begin")

    def say(self, **answer):
        with self.lock:
            print(json.dumps(answer), flush=True)

    def subscribe(self, topic, of, qos="reliable"):
        self.subscriptions[topic] = self.node.create_subscription(
            kind(of), topic, lambda message: self.say(topic=topic, message=plain(message)), QOS[qos]
        )
        self.say(done="subscribe")

    def unsubscribe(self, topic):
        self.node.destroy_subscription(self.subscriptions.pop(topic))
        self.say(done="unsubscribe")

    def publish(self, topic, of, data, qos="reliable", rate=None):
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(kind(of), topic, QOS[qos])
        publisher, message = self.publishers[topic], filled(kind(of)(), data)
        if topic in self.timers:
            self.node.destroy_timer(self.timers.pop(topic))
        publisher.publish(message)
        if rate is not None:
            self.timers[topic] = self.node.create_timer(1 / rate, lambda: self._again(topic, publisher, message))
        self.say(done="publish", subscribers=publisher.get_subscription_count())

    def _again(self, topic, publisher, message):
        if self.publishers.get(topic) is publisher:  # otherwise the timer had already fired when it was renewed
            publisher.publish(message)

    def silence(self, topic):
        self.node.destroy_timer(self.timers.pop(topic))
        self.say(done="silence")

    def renew(self, topic):
        """Let the next publication be a new publisher's."""
        if topic in self.timers:
            self.node.destroy_timer(self.timers.pop(topic))
        if topic in self.publishers:
            self.node.destroy_publisher(self.publishers.pop(topic))
        self.say(done="renew")

    def flood(self, topic, of, count, data=None, rate=None):
        """Publish so many at a rate, else as fast as it goes; without data the first number counts."""
        publisher = self.publishers.setdefault(topic, self.node.create_publisher(kind(of), topic, QOS["reliable"]))
        while not publisher.get_subscription_count():
            time.sleep(0.001)
        begin = time.monotonic()
        for number in range(count):
            publisher.publish(kind(of)(data=data or [float(number), 0.0]))
            while rate is not None and time.monotonic() < begin + number / rate:
                pass
        self.say(done="flood", hz=count / (time.monotonic() - begin))

    def call(self, service, of, data, timeout=10.0):
        cls = kind(of)
        new = service not in self.clients
        if new:
            self.clients[service] = self.node.create_client(cls, service)
        client = self.clients[service]
        if not client.wait_for_service(timeout):
            self.say(done="call", error="no such service")
            return
        if new:
            # the server must have discovered the client too, else rmw drops its answer; no event reports this
            time.sleep(0.2)
        future = client.call_async(filled(cls.Request(), data))
        future.add_done_callback(lambda future: self.say(done="call", response=plain(future.result())))

    def serve(self, service, of, response):
        """Serve with an answer that is always the same, and remember what was asked."""

        def answer(request, reply):
            self.requests.append(plain(request))
            return filled(reply, response)

        self.node.create_service(kind(of), service, answer)
        self.say(done="serve")

    def served(self):
        requests, self.requests = self.requests, []
        self.say(done="served", requests=requests)

    def goal(self, action, of, data, name, points=0, ask=True):
        """Send a goal of an action; what becomes of it comes as messages of a topic of that name.

        `points` is how many times its only point is sent; with `ask` the result is requested once it is accepted.
        """
        cls = kind(of)
        if action not in self.actions:
            self.actions[action] = ActionClient(self.node, cls, action)
        client = self.actions[action]
        if not client.wait_for_server(10.0):
            self.say(done="goal", error="no such action")
            return
        goal = filled(cls.Goal(), data)
        if points:
            goal.trajectory.points = list(goal.trajectory.points) * points
        future = client.send_goal_async(
            goal, feedback_callback=lambda message: self.say(topic=name, message={"feedback": plain(message.feedback)})
        )
        future.add_done_callback(lambda future: self._judged(name, future.result(), ask=ask))
        self.say(done="goal")

    def _judged(self, name, handle, *, ask):
        self.goals[name] = handle
        self.say(topic=name, message={"accepted": handle.accepted})
        if ask:
            self._ask_result(name)

    def result(self, name):
        """Request the result of a goal that was sent with ask=False."""
        self._ask_result(name)
        self.say(done="result")

    def _ask_result(self, name):
        future = self.goals[name].get_result_async()
        future.add_done_callback(lambda future: self._ended(name, future.result()))

    def _ended(self, name, response):
        self.say(topic=name, message={"status": response.status, **plain(response.result)})

    def cancel(self, name):
        future = self.goals[name].cancel_goal_async()
        future.add_done_callback(lambda future: self.say(done="cancel", goals=len(future.result().goals_canceling)))

    def parameters(self, node, values, file="", name=""):
        """Do what `ros2 param` does, with rclpy's own client of a node's parameters: list, describe, get, set, load."""
        del name
        client = AsyncParameterClient(self.node, node)
        ready = client.wait_for_services(10.0)
        names = []

        def listed(future):
            names.extend(future.result().result.names)
            client.get_parameters(names).add_done_callback(got)

        def got(future):
            self.say(topic=node, message={"values": dict(zip(names, map(plain, future.result().values), strict=True))})
            client.describe_parameters(names).add_done_callback(described)

        def described(future):
            match = {descriptor["name"]: descriptor for descriptor in map(plain, future.result().descriptors)}
            self.say(topic=node, message={"descriptors": match})
            expected = [Parameter(name, value=value) for name, value in values.items()]
            client.set_parameters(expected).add_done_callback(done)

        def done(future):
            self.say(topic=node, message={"results": [plain(result) for result in future.result().results]})
            if file:
                client.load_parameter_file(file).add_done_callback(loaded)

        def loaded(future):
            self.say(topic=node, message={"loaded": [plain(result) for result in future.result().results]})

        client.list_parameters().add_done_callback(listed)
        self.say(done="parameters", ready=ready)

    def graph(self):
        topics = dict(self.node.get_topic_names_and_types())
        services = dict(self.node.get_service_names_and_types())
        self.say(
            done="graph",
            topics=topics,
            services=services,
            nodes=self.node.get_fully_qualified_node_names()
            if hasattr(self.node, "get_fully_qualified_node_names")
            else self.node.get_node_names(),
        )

    def wire(self, topics):
        """Tell what DDS shows of topics by their names there."""
        result = {}
        for topic in topics:
            look = self.node.get_subscriptions_info_by_topic if "Request" in topic else None
            for endpoint in (look or self.node.get_publishers_info_by_topic)(topic, no_mangle=True):
                quality = endpoint.qos_profile
                result[topic] = [
                    endpoint.topic_type, str(endpoint.topic_type_hash),
                    *(str(int(part)) for part in (quality.reliability, quality.durability, quality.history)),
                    str(quality.depth),
                ]  # fmt: skip
        self.say(done="wire", found=result)

    def endpoints(self, topic):
        publishers = self.node.get_publishers_info_by_topic(topic)
        self.say(
            done="endpoints",
            publishers=[
                {
                    "node": publisher.node_name,
                    "reliability": publisher.qos_profile.reliability.name,
                    "durability": publisher.qos_profile.durability.name,
                    "hash": str(publisher.topic_type_hash),
                }
                for publisher in publishers
            ],
        )


def main():
    peer = Peer()
    executor = peer.executor

    def obey():
        for line in sys.stdin:
            order = json.loads(line)
            # everything runs between callbacks, in the spinning thread
            executor.create_task(lambda order=order: getattr(peer, order.pop("do"))(**order))
        executor.create_task(rclpy.shutdown)

    threading.Thread(target=obey, daemon=True).start()
    peer.say(done="start")
    while rclpy.ok():
        executor.spin_once(timeout_sec=0.5)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--interfaces"]:
        importlib.import_module("canopen_control.ros.interfaces").provide()
    main()
