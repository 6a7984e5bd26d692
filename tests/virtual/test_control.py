from __future__ import annotations

import os
from types import SimpleNamespace

import pytest
from support.virtualbench import S, servo

from canopen_control.bus.memory import MemoryBus
from canopen_control.frame import CanFrame, frames_of, pack_records
from canopen_control.host.lineclient import LineClient
from canopen_control.host.reactor import ManualClock, Reactor
from canopen_control.virtual.control import NodeControl, control_path
from canopen_control.virtual.diffbase import DiffBase
from canopen_control.virtual.faults import FAULTS
from canopen_control.virtual.nodehost import NodeHost
from canopen_control.virtual.plant import LoadedPlant
from canopen_control.virtual.wheel import WheelPlant


class Controlled:
    """A node with its control socket, and a client of it."""

    def __init__(self, **kwargs):
        self.bus = MemoryBus("control")
        self.reactor = Reactor(ManualClock(S))
        self.listener = self.bus.open("listener")
        self.port = self.bus.open("drive")
        self.node = servo(**kwargs)
        self.host = NodeHost(self.reactor, self.port, [self.node])
        self.control = NodeControl(self.host, self.node)
        self.reactor.run_for(0)
        self.client = LineClient(control_path(self.port.channel, 5))
        self.hello = self.receive()

    def receive(self):
        self.reactor.run_for(0)
        return self.client.receive(1.0)

    def call(self, method, **params):
        self.client.send({"id": 1, "method": method, "params": params})
        answer = self.receive()
        while "event" in answer:
            answer = self.receive()
        assert answer["id"] == 1
        return answer.get("result", answer.get("error"))

    def close(self):
        self.client.close()
        self.control.close()
        self.host.close()
        self.port.close()
        self.listener.close()
        self.reactor.close()


@pytest.fixture
def controlled():
    made = []

    def make(**kwargs):
        made.append(Controlled(**kwargs))
        return made[-1]

    yield make
    for each in made:
        each.close()


def test_the_socket_is_named_after_bus_and_node():
    assert control_path("local:robby", 3).name == "drive-robby-3.sock"
    assert control_path("vcan0", 12).name == "drive-vcan0-12.sock"
    assert control_path("pcan:PCAN_USBBUS1@500000", 1).name == "drive-pcan_PCAN_USBBUS1_500000-1.sock"


def test_it_says_who_it_is(controlled):
    hello = {"node_id": 5, "name": "servo", "channel": "memory:control", "pid": os.getpid()}
    assert controlled().hello == {"hello": hello}


def test_it_lists_all_faults_with_what_a_good_master_makes_of_them(controlled):
    listed = controlled().call("faults")
    assert [each["name"] for each in listed] == list(FAULTS)
    assert all(set(each) == {"name", "row", "acts", "does", "reaction", "once", "on"} for each in listed)


def test_it_switches_faults_and_the_wire_shows_it_at_once(controlled):
    c = controlled()
    assert c.call("fault", name="drive_fault") == {"active": ["drive_fault"]}
    frames = list(frames_of(c.listener.receive()))
    assert CanFrame(0x085, bytes.fromhex("1043090000000000")) in frames
    assert next(each for each in c.call("faults") if each["name"] == "drive_fault")["on"]
    assert c.call("fault", name="drive_fault", on=False) == {"active": []}


def test_it_shows_the_state_and_the_plant(controlled):
    c = controlled()
    c.listener.send(pack_records([CanFrame(0, b"\x01\x05")]))
    c.reactor.run_for(0)
    state = c.call("state")
    assert (state["node_id"], state["nmt_state"], state["faults"], state["errors"]) == (5, "OPERATIONAL", [], [])
    axis = state["axes"][0]
    assert (axis["state"], axis["mode"], axis["position"]) == ("SWITCH_ON_DISABLED", "NONE", 0)
    assert axis["plant"] == {"position": 0.0, "velocity": 0.0, "torque": 0.0}


def test_inputs_and_the_plant_can_be_set(controlled):
    c = controlled(plant=lambda axis: LoadedPlant())
    assert c.call("inputs", value=0x10008) == {}
    assert c.node.get(0x60FD) == 0x10008
    assert c.call("plant", external=-50, stalled=1) == {}
    plant = c.node.drives[0].mover.plant
    assert (plant.external, plant.stalled) == (-50.0, True)


def test_numbers_of_a_motor_inside_a_wheel_are_reached_too(controlled):
    c = controlled(plant=lambda axis: WheelPlant(LoadedPlant(), DiffBase(0.4), 0, 0.001))
    assert c.call("plant", external=-50) == {}
    assert c.node.drives[0].mover.plant.inner.external == -50.0


def test_the_world_is_part_of_the_state(controlled):
    c = controlled()
    assert "world" not in c.call("state")
    c.control._world = SimpleNamespace(describe=lambda: {"base": {"x": 1.5}})
    assert c.call("state")["world"] == {"base": {"x": 1.5}}


@pytest.mark.parametrize(
    ("method", "params", "words"),
    [
        ("nonsense", {}, "no method"),
        ("fault", {"name": "nonsense"}, "no fault"),
        ("fault", {"name": "silent", "on": "yes"}, "true or false"),
        ("inputs", {"value": -1}, "32 bits"),
        ("inputs", {"value": 1, "axis": 4}, "axis"),
        ("plant", {"axis": 4}, "no such axis"),
        ("plant", {"_STEP_NS": 1}, "no number"),
        ("plant", {"position": "far"}, "no number"),
    ],
)
def test_what_it_cannot_do_is_an_error_in_words(controlled, method, params, words):
    answer = controlled().call(method, **params)
    assert answer["kind"] == "ConfigError"
    assert words in answer["message"]


def test_events_are_pushed_and_notifications_are_not_answered(controlled):
    c = controlled()
    c.control.push("NMT OPERATIONAL")
    assert c.receive() == {"event": "NMT OPERATIONAL"}
    c.client.send({"method": "fault", "params": {"name": "warning"}})
    assert c.call("state")["faults"] == ["warning"]
