"""What the tests of `ros` share: a domain of its own, other ROS programs as processes, and a robot to show."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from base64 import b64decode, b64encode
from pathlib import Path
from queue import Empty, Queue

import pytest
from support import host
from support.jsonserver import json_server, say
from support.processes import Stage, go_first

from canopen_control.host.environment import clean_environment
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import socket_path

ROOT = host.ROOT
PEER = Path(__file__).with_name("ros_peer.py")
TIMEOUT = host.TIMEOUT_S


def forget_ports(number, folder=Path("/dev/shm")):
    """Remove the ports in shared memory that killed programs of a ROS domain have left: the next would take them."""
    first = 7400 + 250 * number  # DDSI-RTPS, clause 9.6.1.1
    for port in range(first, first + 250):
        for name in (f"fastrtps_port{port}", f"fastrtps_port{port}_el", f"sem.fastrtps_port{port}_mutex"):
            (folder / name).unlink(missing_ok=True)


_DOMAINS = range(20, 100)  # up to domain 101 the ports are below the ephemeral ports
_TURNS = itertools.count(os.getpid())


@contextlib.contextmanager
def domain():
    """Yield a ROS domain that no other test of this host uses now, nor has just used: programs of it may still end."""
    first = next(_TURNS) * 7
    for turn in range(len(_DOMAINS)):
        number = _DOMAINS[(first + turn) % len(_DOMAINS)]
        fd = os.open(
            f"{tempfile.gettempdir()}/canopen_control_test_domain_{number}",
            os.O_RDWR | os.O_CREAT | os.O_CLOEXEC,
            0o666,
        )
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(fd)
            continue
        try:
            forget_ports(number)
            yield number
        finally:
            os.close(fd)
        return
    raise AssertionError("all ROS domains are taken")


def ros_environment(number, **more):
    """Return the environment of a ROS program of its own, as from a fresh shell."""
    environment = clean_environment(ros=True)
    for name in ("RMW_IMPLEMENTATION", "ROS_LOCALHOST_ONLY", "FASTRTPS_DEFAULT_PROFILES_FILE", "AMENT_PREFIX_PATH"):
        environment.pop(name, None)
    environment.update(
        ROS_DOMAIN_ID=str(number),
        ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
        FASTRTPS_DEFAULT_PROFILES_FILE=str(ROOT / "canopen_control/ros/loopback.xml"),
        PYTHONPATH=str(ROOT),
    )
    environment.update(more)
    return environment


@contextlib.contextmanager
def stage(folder, **more):
    """Yield a Stage in a folder, with its ROS `domain` and `environment`: for the programs of all tests of a module."""
    folder.chmod(0o700)
    with pytest.MonkeyPatch.context() as patch, domain() as number:
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        programs = Stage(folder, folder)
        programs.domain = number
        programs.environment = ros_environment(number, _ROS_WHEELS_BOOTSTRAP_COMPLETE="1", **more)
        try:
            yield programs
        finally:
            programs.end()


def run_ros(code, number=0, arguments=(), **more):
    """Run code in a fresh interpreter that may import rclpy; return what it printed. It asserts for itself."""
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, env=ros_environment(number, **more), capture_output=True, text=True, timeout=180)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


class Peer:
    """A ROS program of its own; `order` makes it do something, `messages` is what its subscriptions got."""

    def __init__(self, number, *arguments, **more):
        self._process = subprocess.Popen(
            [sys.executable, str(PEER), *arguments],
            env=ros_environment(number, **more),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._answers, self._messages, self._errors = Queue(), {}, []
        self._threads = [threading.Thread(target=self._read), threading.Thread(target=self._read_errors)]
        for thread in self._threads:
            thread.start()
        self._answer()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def _read(self):
        for line in self._process.stdout:
            try:
                answer = json.loads(line)
            except ValueError:  # DDS itself printed this, after waiting in vain for an answer
                self._errors.append(line)
                continue
            if "topic" in answer:
                self._messages.setdefault(answer["topic"], Queue()).put(answer["message"])
            else:
                self._answers.put(answer)

    def _read_errors(self):
        self._errors.extend(self._process.stderr)

    def _answer(self, timeout=TIMEOUT):
        try:
            return self._answers.get(timeout=timeout)
        except Empty:
            self._process.kill()
            raise AssertionError(f"the ROS program does not answer: {''.join(self._errors)}") from None

    def order(self, do, **params):
        """Have it do something, and return its answer."""
        for name in (params.get("topic"), params.get("name")):
            if name is not None:
                self._messages.setdefault(name, Queue())
        self._process.stdin.write(json.dumps({"do": do, **params}) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def call(self, service, of="std_srvs/srv/Trigger", /, **data):
        """Call a service that may take a drive's time, and return its response."""
        return self.order("call", service=service, of=of, data=data, timeout=TIMEOUT)["response"]

    def publisher(self, topic):
        """Return the only publisher of a topic, once DDS has discovered it and its node, which are two messages."""
        results = []

        def look():
            results[:] = self.order("endpoints", topic=topic)["publishers"]
            return len(results) == 1 and results[0]["node"] != "_NODE_NAME_UNKNOWN_"

        assert eventually(look), f"publishers of {topic}: {results}"
        return results[0]

    def message(self, topic, matching=lambda message: True, timeout=TIMEOUT):
        """Return the next message of a topic that it subscribed to, for which `matching` holds."""
        deadline, last = time.monotonic() + timeout, None
        while True:
            try:
                last = self._messages[topic].get(timeout=max(deadline - time.monotonic(), 0))
            except Empty:
                raise AssertionError(f"no such message on {topic}; the last one was {last}") from None
            if matching(last):
                return last

    def hears(self, topic, tell):
        """Return the next message of a topic, for which `tell` lets another one be published again and again.

        What was published before the two ends had found each other is gone, and nothing tells when they have.
        """
        received = []

        def look():
            tell()
            received.extend(self.waiting(topic))
            return bool(received)

        assert eventually(look), f"no message on {topic}"
        return received[0]

    def waiting(self, topic):
        """Take what has come on a topic."""
        messages = []
        with contextlib.suppress(Empty):
            while True:
                messages.append(self._messages[topic].get_nowait())
        return messages

    def begin(self):
        """Begin anew: forget what it subscribed to, published and called, and what has come."""
        self.order("begin")
        self._messages.clear()

    def kill(self):
        """End it as a crash does."""
        self._process.kill()

    def close(self):
        with contextlib.suppress(BrokenPipeError):  # it has ended without reading a request
            self._process.stdin.close()
        try:
            self._process.wait(TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for thread in self._threads:
            thread.join()
        self._process.stdout.close()
        self._process.stderr.close()


def stamp_of(message):
    """Return the time in the header of a message, in Unix seconds, as it is in the fake robot."""
    stamp = message["header"]["stamp"]
    return round(stamp["sec"] + stamp["nanosec"] / 1e9, 2)


URDF = "<robot name='fake'><link name='base'/></robot>"
CONTROLLERS = [
    {"name": "joint_state_broadcaster", "type": "joint_state_broadcaster/JointStateBroadcaster", "state": "active",
     "joints": ["left", "right"], "interface": None, "claimed_interfaces": [], "required_command_interfaces": [],
     "required_state_interfaces": ["*"], "topic": None, "publishes": ["joint_states", "dynamic_joint_states"],
     "frame_id": "base_link", "tells": "joint_states", "is_broadcaster": True, "rejected": 0},
    {"name": "forward", "type": "forward_command_controller/ForwardCommandController", "state": "active",
     "joints": ["left", "right"], "interface": "velocity", "claimed_interfaces": ["left/velocity", "right/velocity"],
     "required_command_interfaces": ["left/velocity", "right/velocity"], "required_state_interfaces": [],
     "topic": "commands", "is_broadcaster": False, "rejected": 0},
    {"name": "base", "type": "diff_drive_controller/DiffDriveController", "state": "inactive",
     "joints": ["left", "right"], "interface": "velocity", "claimed_interfaces": [],
     "required_command_interfaces": ["left/velocity", "right/velocity"], "required_state_interfaces": [],
     "topic": "cmd_vel", "tells": "odometry", "is_broadcaster": False, "rejected": 0},
]  # fmt: skip


class FakeRobot:
    """The API of a runtime, on a thread of its own: answers, pushes its state at 100 Hz, remembers what it was told.

    Its joint state broadcasters publish each time, a microsecond later; `pushed` counts the states, `samples` are what
    other controllers tell.
    """

    def __init__(self, name="fake"):
        self.reactor, self.raised, self.collected = Reactor(), [], []
        self.listed = {}  # state of each controller in the last answer
        self.reactor.on_error = self.raised.append
        self.controllers = json.loads(json.dumps(CONTROLLERS))
        self.joints = {"right": {"position": 2.0, "velocity": 20.0, "effort": None, "command": None},
                       "left": {"position": 1.0, "velocity": 10.0, "effort": None, "command": None}}  # fmt: skip
        self.nodes = {"left_drive": node(3, "left"), "right_drive": node(2, "right")}
        self.time, self.more, self.refusals, self.answers = 1_700_000_000.25, {}, {}, {}
        self._watching, self.urdf = [], URDF
        self.samples, self.pushed = {}, 0
        self.process_data, self.watching_process_data, self.layout = {}, False, {"buses": {}}
        self.bus_nodes, self.holds, self._held = [], (), []
        self._server = json_server(
            self.reactor, socket_path("robot", name), self._greet, self._on_message, self._on_close
        )
        self._name, self._thread = name, threading.Thread(target=self.reactor.run)

    def __enter__(self):
        self._thread.start()
        self.reactor.call_threadsafe(self._push)
        return self

    def __exit__(self, *_):
        self.leave()
        self.reactor.call_threadsafe(self.reactor.stop)
        self._thread.join(60)
        self.reactor.close()
        assert self.raised == []

    def leave(self):
        """End the API, as a runtime that is shut down."""
        self.on_loop(self._server.close)

    def on_loop(self, function):
        done = threading.Event()
        self.reactor.call_threadsafe(lambda: (function(), done.set()))
        assert done.wait(60)

    def event(self, **event):
        """Push an event."""
        self.on_loop(
            lambda: [
                say(connection, {"event": {"node": None, "level": "info", **event}}) for connection in self._watching
            ]
        )

    def switch(self, **states):
        """Change the states of controllers by name."""
        for controller in self.controllers:
            controller["state"] = states.get(controller["name"], controller["state"])

    def commands(self, method="command"):
        """Return the parameters of the commands that have come."""
        return [_plain(message["params"]) for message in list(self.collected) if message["method"] == method]

    def state(self):
        return {
            "time": self.time,
            "state": "running",
            "cycle": {"period_s": 0.02, "count": 1, "missed": 0},
            "joints": {name: {"name": name, **joint} for name, joint in self.joints.items()},
            "nodes": {name: {"name": name, **fields} for name, fields in self.nodes.items()},
            "controllers": {controller["name"]: controller["state"] for controller in self.controllers},
            "samples": {**self._joint_states(), **self.samples},
            **self.more,
        }

    def _list_controllers(self):
        self.listed = {controller["name"]: controller["state"] for controller in self.controllers}
        return self.controllers

    def _joint_states(self):
        self.pushed += 1
        time = self.time + self.pushed / 1e6
        result = {}
        for controller in self.controllers:
            if controller["state"] == "active" and controller.get("publishes"):
                joints = {name: self.joints[name] for name in controller["joints"] if name in self.joints}
                reported = {name: _values(joint) for name, joint in joints.items()}
                result[controller["name"]] = {
                    "kind": "joint_states",
                    "time": time,
                    "names": list(reported),
                    "joints": reported,
                }
        return result

    def _greet(self, connection):
        say(connection, {"hello": {"robot": self._name, "version": "0", "protocol": 2, "pid": os.getpid()}})

    def _on_close(self, connection):
        if connection in self._watching:
            self._watching.remove(connection)

    def _on_message(self, connection, message):
        method = message["method"]
        self.collected.append(message)
        if method == "subscribe":
            self._subscribe(connection, message["params"])
        if message["params"].get("action") in self.holds or method in self.holds:
            self._held.append((connection, message))
        elif "id" in message and method in self.refusals:
            say(connection, {"id": message["id"], "error": self.refusals[method]})
        elif "id" in message:
            say(connection, {"id": message["id"], **self._outcome(method, message["params"])})

    def _subscribe(self, connection, params):
        if connection not in self._watching:
            self._watching.append(connection)
        self.watching_process_data = params.get("pdos", False)
        if self.watching_process_data:
            say(connection, {"pdos": {"time": self.time, "nodes": _encoded(self.process_data)}})

    def tell_process_data(self, **nodes):
        """Push what has changed: lists of [index, subindex, hex] by node."""
        message = {"pdos": {"time": self.time, "nodes": _encoded(nodes)}}
        self.on_loop(lambda: [say(connection, message) for connection in self._watching])

    def release(self):
        """Answer what was held back: the actions and methods that `holds` names."""
        self.holds = ()
        while self._held:
            self.release_one({})

    def release_one(self, result):
        """Answer what was held back first; more of it is held back."""
        connection, message = self._held.pop(0)
        self.on_loop(lambda: say(connection, {"id": message["id"], "result": result}))

    def _outcome(self, method, params):
        try:
            return {"result": self._answer(method, params)}
        except LookupError as error:
            return {"error": {"kind": "ControlError", "message": error.args[0]}}

    def _answer(self, method, params):
        if method in self.answers:
            answer = self.answers[method]
            return _wired(answer(_plain(params)) if callable(answer) else answer)
        known = {
            "status": lambda: {**self.state(), "robot": self._name, "events": []},
            "controllers": self._list_controllers,
            "description": lambda: {"urdf": self.urdf},
            "nodes": lambda: {"buses": {}, "nodes": self.bus_nodes},
            "layout": lambda: _laid_out(self.layout),
            "hardware": list,
            "controller_types": list,
        }
        return known.get(method, dict)()

    def _push(self):
        for connection in self._watching:
            say(connection, {"state": self.state()})
        self.reactor.call_later(10_000_000, self._push)


def _values(joint):
    """Return the state interfaces of a joint by name."""
    return {**{kind: joint.get(kind) for kind in ("position", "velocity", "effort")}, **joint.get("others", {})}


def _laid_out(layout):
    """Return a layout with what a test does not say."""
    entry = {"data_type": "UNSIGNED32", "bits": 32, "subindex": 0}
    defaults = {"cob_id": 0x200, "number": 1}
    return {
        "buses": {
            name: {
                "channel": "local:x",
                "bitrate": 1_000_000,
                **bus,
                "nodes": [
                    {
                        "node_id": 3,
                        **node,
                        "pdos": [
                            {**defaults, **pdo, "objects": [{**entry, **one} for one in pdo["objects"]]}
                            for pdo in node["pdos"]
                        ],
                    }
                    for node in bus["nodes"]
                ],
            }
            for name, bus in layout["buses"].items()
        }
    }


def _plain(params):
    """Return parameters without those that say nothing, with data in hexadecimal."""
    text = {key: value for key, value in params.items() if value is not None and (key, value) != ("block", False)}
    return {**text, "data": b64decode(text["data"]).hex()} if "data" in text else text


def _wired(answer):
    """Return an answer whose data are given in hexadecimal as the API has it."""
    if isinstance(answer, dict) and "data" in answer:
        return {**answer, "data": b64encode(bytes.fromhex(answer["data"])).decode()}
    return answer


def _encoded(nodes):
    """Return process data, given in hexadecimal, as the API has it."""
    return {
        name: [[index, subindex, b64encode(bytes.fromhex(data)).decode()] for index, subindex, data in objects]
        for name, objects in nodes.items()
    }


def node(node_id, joint):
    """Return a healthy node as the API tells it."""
    axis = {
        "joint": joint,
        "cia402_state": "OPERATION_ENABLED",
        "statusword": 0x1637,
        "mode": "PROFILE_VELOCITY",
        "error": None,
    }
    return {
        "bus": "can",
        "node_id": node_id,
        "nmt_state": "OPERATIONAL",
        "ready": True,
        "age_s": 0.01,
        "error": None,
        "axes": [axis],
    }


@contextlib.contextmanager
def bridge(number, *arguments, name="fake", **more):
    """Run a bridge as somebody does by hand; yields the process."""
    process = subprocess.Popen(
        [sys.executable, "-m", "canopen_control.ros.bridge", "--name", name, *arguments],
        env=ros_environment(number, **more),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    go_first(process.pid)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.communicate(timeout=TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


def eventually(condition, seconds=TIMEOUT):
    """Wait for other processes; returns at once when the condition holds."""
    return host.eventually(condition, seconds)


def in_thread(function):
    """Do something that waits, in a thread of its own."""
    thread = threading.Thread(target=function)
    thread.start()
    return thread
