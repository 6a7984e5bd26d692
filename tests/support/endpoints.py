"""What an endpoint of `ros` is given, on one thread and without ROS: it remembers what was asked and told."""

from __future__ import annotations

import copy

from canopen_control.ros import interfaces
from canopen_control.ros.sample_publisher import SamplePublisher
from canopen_control.ros.sample_topics import SAMPLE_TOPICS
from canopen_control.rpc.messages.samples import kind_of


class Client:
    def __init__(self):
        self.asked, self.said, self.closed = [], [], 0

    def ask(self, request, answer):
        self.asked.append((request, answer))

    def send_periodically(self, request, every_ns):
        self.said.append((request, every_ns))

    def close(self):
        self.closed += 1


class Publisher:
    def __init__(self, kind, topic, quality):
        self.kind, self.topic, self.quality = kind, topic, quality
        self.subscribers, self.collected = 1, []

    def get_subscription_count(self):
        return self.subscribers

    def publish(self, message):
        self.collected.append(copy.deepcopy(message))


class Ros:
    """What an endpoint is given, on one thread."""

    def __init__(self):
        self.node, self.asked, self.collected, self.clients, self.commanded = self, [], [], [], []
        self.subscriptions, self.services, self.publishers, self.left, self.lacking = {}, {}, [], [], []
        self.watched = []

    def subscribe(self, kind, topic, callback, quality):
        self.subscriptions[topic] = (kind, callback, quality)
        return topic

    def serve(self, kind, name, handler):
        self.services[name] = (interface(kind), handler)
        return name

    def leave_out(self, interface):
        self.lacking.append(interface)

    def frame(self, name):
        return name

    def create_publisher(self, *what):
        self.publishers.append(Publisher(*what))
        return self.publishers[-1]

    def watch_process_data(self, watcher, wanted):
        self.watching = (watcher, wanted)

    def unsubscribe(self, which):
        self.left.append(which)

    unserve = destroy_publisher = unsubscribe

    def get_namespace(self):
        return "/robot"

    def get_name(self):
        return "bridge"

    def unix(self, stamp):
        return stamp

    def hand_over(self, function):
        function()

    def connect(self):
        self.clients.append(Client())
        return self.clients[-1]

    def command(self, request):
        self.commanded.append(request)

    def ask(self, request, answer):
        self.asked.append((request, answer))

    def watch_publishers(self, commanded, topic, values):
        self.watched.append((commanded, topic, values))

    def warn(self, _key, text):
        self.collected.append(text)

    def publish(self, topic, message):
        self.subscriptions[topic][1](message)

    def call(self, service, *inputs, request=None, **fields):
        """Call a service, answer what it asks of the robot, in order, with `given`: results, or texts of refusals."""
        kind, handler = self.services[service]
        replies, answers = [], iter(inputs)
        handler(request or kind.Request(**fields), kind.Response(), replies.append)
        requests = []
        while self.asked:
            expected, answer = self.asked.pop(0)
            requests.append(expected)
            result = next(answers)
            answer(*((None, result) if isinstance(result, str) else (result, None)))
        (response,) = replies
        return response, requests


def publisher_of(ros, controller, topic):
    """Return the publisher of one topic of a controller's samples."""
    (row,) = [
        sample_topic
        for sample_topic in SAMPLE_TOPICS
        if sample_topic.topic == topic and kind_of(sample_topic.kind) == controller.tells
    ]
    return SamplePublisher(ros, controller, row)


FACTORY = interfaces._Factory()


def interface(name):
    """Return an interface without the self-test that loads ROS's libraries: nothing is sent."""
    return FACTORY.service_of(name) if "/srv/" in name else FACTORY.class_of(name)
