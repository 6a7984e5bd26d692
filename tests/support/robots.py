"""A whole robot in one process on the memory bus, in simulated time: exact to the nanosecond, no sleeps."""

import contextlib
import dataclasses
import functools
import shutil
from pathlib import Path

from support.observers import Observer

from canopen_control.bus.channel import open_port
from canopen_control.bus.memory import MemoryBus
from canopen_control.data_files import data_names, data_path
from canopen_control.errors import NotEnabled
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.od.eds import read_eds
from canopen_control.runtime.core import RobotCore, RobotState
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeHost

MS = 1_000_000
LEFT, RIGHT = 3, 2
FORWARD = "robby_forward_controller"


def dictionary_of(path):
    """Return what an EDS says, read once for all benches: each device takes a copy of its own."""
    return _dictionary(str(path), Path(path).stat().st_mtime_ns)


@functools.cache
def _dictionary(path, _changed):
    return read_eds(path).od


def setup_of(config, channel, **how):
    """Return a robot as its files describe it on a bus; a bundled one is read once for all benches."""
    if config not in data_names("config"):
        return read_robot(find_robot(config), can=[channel], **how)
    words = {key: tuple(value) if isinstance(value, list) else value for key, value in how.items()}
    setup = _bundled(config, tuple(sorted(words.items())))
    return dataclasses.replace(setup, channels=dict.fromkeys(setup.channels, channel))


@functools.cache
def _bundled(config, how):
    return read_robot(find_robot(config), can=["memory:bench"], **dict(how))


class Bench:
    """Robby, its drives and its bus under a manual clock; `robot` is the core, `drives` the devices by node-ID."""

    scale = 1.0  # factor by which its times are longer than those of the test
    jitter = 0.0  # fraction by which a cycle may be longer or shorter than the others

    def __init__(self, name, *, config="robby", drives=(LEFT, RIGHT), faults=(), **how):
        self.channel = f"memory:{name}"
        self.reactor = Reactor(ManualClock(1_000_000_000))
        self.errors = []
        self.reactor.on_error = self.errors.append
        self.bus = MemoryBus.get(name)
        self.setup = setup_of(str(config), self.channel, **how)
        self.drives, self.hosts, self.ports, self.robot = {}, {}, {}, None
        try:
            self.robot = RobotCore(self.setup, self.reactor)
        except BaseException:
            self.close()
            raise
        for node_id in drives:
            self.power_on(node_id, faults)
        self.events = []
        self.robot.observers.append(Observer(event=self.events.append))

    def power_on(self, node_id, faults=()):
        node = next(candidate for candidate in self.setup.bus.nodes.values() if candidate.node_id == node_id)
        port = open_port(self.channel, label=f"drive {node_id}")
        device = make_device(dictionary_of(self.setup.bus.eds_paths[node.name]), node_id, faults)
        self.drives[node_id], self.ports[node_id] = device, port
        self.hosts[node_id] = NodeHost(self.reactor, port, [device])

    def power_off(self, node_id):
        self.hosts.pop(node_id).close()
        self.ports.pop(node_id).close()
        del self.drives[node_id]

    def run(self, ms):
        """Let simulated milliseconds pass."""
        self.reactor.run_for(round(ms * MS))
        assert self.errors == [], self.errors

    def until(self, condition, ms=5000):
        """Let time pass until `condition`; fail after `ms`, else return how many it took."""
        begin = self.reactor.now()
        while not condition():
            assert self.reactor.now() - begin < ms * MS, (
                f"not within {ms} ms: {[event.text for event in self.events[-6:]]}"
            )
            self.run(1)
        return (self.reactor.now() - begin) / MS

    def start(self):
        """Boot and run; returns how many ms it took."""
        self.robot.start()
        return self.until(lambda: self.robot.state in (RobotState.RUNNING, RobotState.DISABLED))

    def command(self, *values, source="test"):
        self.robot.command(FORWARD, list(values), source)

    def hold(self, *values, ms):
        """Command again every 100 ms, as a publisher does."""
        for _ in range(round(ms / 100)):
            self.publish(*values)
            self.run(100)

    def publish(self, *values):
        """Command without minding whether the drives are enabled."""
        with contextlib.suppress(NotEnabled):
            self.command(*values)

    def texts(self, kind):
        return [event.text for event in self.events if event.kind == kind]

    def joint(self, node_id):
        return next(joint for joint in self.robot.joints.values() if joint.node.node_id == node_id)

    def velocity(self, node_id):
        return self.joint(node_id).states["velocity"].value

    def speed(self, node_id):
        """What the drive itself does, in its own units: 0x606C of the device, not what the master says of it."""
        self.drives[node_id].advance_drives(self.reactor.now())
        return self.drives[node_id].get(0x606C)

    def close(self):
        if self.robot is not None:
            self.robot.close()
        for node_id in list(self.hosts):
            self.power_off(node_id)
        self.reactor.close()


#: edits of a bus.yml for robots and drives on a machine that is busy for seconds
PATIENT = {"heartbeat_multiplier: 5": "heartbeat_multiplier: 100"}
PATIENT_ROBBY = {**PATIENT, "missed_syncs: 10": "missed_syncs: 500"}


def copy_robby(folder, **edits):
    """Copy robby's files to `folder`, each `old: new` of `bus`, `controllers`, `description` replaced in its file."""
    names = {"bus": "bus.yml", "controllers": "ros2_controllers.yaml", "description": "robby.urdf.xacro"}
    target = folder / "robby"
    shutil.copytree(data_path("config", "robby"), target)
    for which, changes in edits.items():
        path = target / names[which]
        text = path.read_text()
        for old, new in changes.items():
            assert old in text, old
            text = text.replace(old, new)
        path.write_text(text)
    return target


def split_robby(folder, **edits):
    """Copy robby as `copy_robby` does and give its right drive a bus of its own, named `right`."""
    config = copy_robby(folder, **edits)
    head, nodes = (config / "bus.yml").read_text().split("nodes:\n")
    left, right = nodes.split("  right_drive:\n")
    (config / "bus.yml").write_text(f"{head}nodes:\n{left}")
    (config / "bus_right.yml").write_text(f"{head}nodes:\n  right_drive:\n{right}")
    return config
