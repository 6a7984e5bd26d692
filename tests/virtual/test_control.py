from __future__ import annotations

import json
import os
from types import SimpleNamespace

import msgspec
import pytest
from support.virtualbench import S, servo

from canopen_control.bus.memory import MemoryBus
from canopen_control.frame import CanFrame, frames_of, pack_records
from canopen_control.host.lineclient import LineClient
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import socket_path
from canopen_control.host.timer import ManualClock
from canopen_control.rpc.messages.declare import PROTOCOL
from canopen_control.rpc.messages.drive import BasePose, WorldShape, WorldState
from canopen_control.version import __version__
from canopen_control.virtual.control import NodeControl
from canopen_control.virtual.fault_table import FAULTS
from canopen_control.virtual.node_host import NodeHost
from canopen_control.virtual.plant import IndependentPlants, LoadedPlant
from canopen_control.virtual.shaft import DiffBase, WheelPlant


class Controlled:
    """A node with its control socket, and a bare connection to it."""

    def __init__(self, world=None, **kwargs):
        self.bus = MemoryBus("control")
        self.reactor = Reactor(ManualClock(S))
        self.listener = self.bus.open("listener")
        self.port = self.bus.open("drive")
        self.node = servo(**kwargs)
        self.host = NodeHost(self.reactor, self.port, [self.node])
        self.control = NodeControl(self.host, self.node, world)
        self.reactor.run_for(0)
        self.client = LineClient(socket_path("drive", "control-5"))
        self.hello = self.receive()

    def receive(self):
        self.reactor.run_for(0)
        return json.loads(self.client.receive(1.0))

    def send(self, **message):
        self.client.send(json.dumps(message).encode() + b"\n")

    def call(self, method, **params):
        self.send(id=1, method=method, params=params)
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
    created = []

    def make(**kwargs):
        created.append(Controlled(**kwargs))
        return created[-1]

    yield make
    for item in created:
        item.close()


def test_it_reports_its_identity(controlled):
    assert controlled().hello == {
        "hello": {
            "node_id": 5,
            "name": "servo",
            "channel": "memory:control",
            "version": __version__,
            "protocol": PROTOCOL,
            "pid": os.getpid(),
        }
    }


def test_it_lists_all_faults_with_what_a_good_master_makes_of_them(controlled):
    listed = controlled().call("faults")
    assert [item["name"] for item in listed] == [
        name for name, each in FAULTS.items() if each.acts not in ("input", "output", "program")
    ]
    assert all(set(item) == {"name", "row", "acts", "does", "reaction", "once", "on"} for item in listed)
    assert all(item["does"] and item["reaction"] for item in listed)


def test_it_switches_faults_and_the_wire_shows_it_at_once(controlled):
    c = controlled()
    assert c.call("fault", name="drive_fault") == {"active": ["drive_fault"]}
    frames = list(frames_of(c.listener.receive()))
    assert CanFrame(0x085, bytes.fromhex("1043090000000000")) in frames
    assert next(item for item in c.call("faults") if item["name"] == "drive_fault")["on"]
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
    assert c.call("plant", numbers={"external": -50, "stalled": True}) == {}
    plant = c.node.drives[0].mover.plant
    assert (plant.external, plant.stalled) == (-50.0, True)


def test_numbers_of_a_motor_inside_a_wheel_are_reached_too(controlled):
    c = controlled(plant=lambda axis: WheelPlant(LoadedPlant(), DiffBase(0.4), 0, 0.001))
    assert c.call("plant", numbers={"external": -50}) == {}
    assert c.node.drives[0].mover.plant.inner.external == -50.0


def test_a_single_node_reports_no_world(controlled):
    assert "world" not in controlled().call("state")


def test_what_the_axes_do_together_is_reported(controlled):
    world = SimpleNamespace(describe=lambda: WorldState(BasePose(1.5, 0.0, 0.25, 7), {"spring": 2.0}))
    reported = {"base": {"x": 1.5, "y": 0.0, "heading": 0.25, "time_ns": 7}, "others": {"spring": 2.0}}
    assert controlled(world=world).call("state")["world"] == reported


def test_a_world_in_which_things_may_happen_reports_this(controlled):
    class Lively(IndependentPlants):
        def act(self, what):
            pass

    assert controlled(world=Lively()).call("world") == {"changeable": True}


def test_the_true_pose_of_the_base_is_reported_by_itself(controlled):
    pose = BasePose(1.5, 0.5, 0.25, 7, z=0.1, pitch=-0.2)
    reported = controlled(world=SimpleNamespace(describe=lambda: WorldState(pose))).call("world")
    assert reported == {"base": {"x": 1.5, "y": 0.5, "heading": 0.25, "time_ns": 7, "z": 0.1, "pitch": -0.2}}
    assert msgspec.convert(reported, WorldState).base == pose


def test_what_is_in_a_world_is_reported_with_where_there_is_such_a_thing(controlled):
    box = WorldShape(name="box 0", kind="box", size=(1.0, 2.0, 3.0), position=(0.5, 0.0, 1.5), moves=True)

    class Furnished(IndependentPlants):
        def shapes(self):
            return (box,)

    (reported,) = controlled(world=Furnished()).call("shapes")
    assert msgspec.convert(reported, WorldShape) == box


def test_a_world_without_things_reports_of_none(controlled):
    assert controlled(world=IndependentPlants()).call("shapes") == []


def test_a_node_that_moves_no_base_has_no_true_pose(controlled):
    assert controlled().call("world") == {}


@pytest.mark.parametrize(
    ("method", "params", "kind", "words"),
    [
        (
            "nonsense",
            {},
            "LocalProtocolError",
            "no method 'nonsense'; available: faults, fault, quirks, quirk, state, inputs, signals",
        ),
        ("fault", {}, "LocalProtocolError", "fault: Object missing required field `name`"),
        ("fault", {"name": "silent", "on": "yes"}, "LocalProtocolError", "Expected `bool`, got `str` - at `$.on`"),
        ("inputs", {"value": -1}, "LocalProtocolError", "`$.value`"),
        ("plant", {"numbers": {"position": "far"}}, "LocalProtocolError", "`$.numbers[...]`"),
        ("fault", {"name": "nonsense"}, "ConfigError", "no fault 'nonsense'"),
        ("inputs", {"value": 1, "axis": 4}, "ConfigError", "the node has no axis 4; it has: 0"),
        ("plant", {"numbers": {}, "axis": 4}, "ConfigError", "the node has no axis 4"),
        ("plant", {"numbers": {"_STEP_NS": 1}}, "ConfigError", "not a number"),
        ("plant", {"numbers": {"follow": 1}}, "ConfigError", "not a number"),
    ],
)
def test_what_it_cannot_do_is_an_error_in_words(controlled, method, params, kind, words):
    answer = controlled(plant=lambda axis: LoadedPlant()).call(method, **params)
    assert answer["kind"] == kind
    assert words in answer["message"]


def test_of_several_numbers_none_is_set_where_one_is_wrong(controlled):
    c = controlled(plant=lambda axis: LoadedPlant())
    assert "colour" in c.call("plant", numbers={"external": -50, "colour": 1})["message"]
    assert c.node.drives[0].mover.plant.external == 0.0


def test_events_are_pushed_and_notifications_are_not_answered(controlled):
    c = controlled()
    c.control.push("NMT OPERATIONAL")
    assert c.receive() == {"event": {"text": "NMT OPERATIONAL"}}
    c.send(method="fault", params={"name": "warning"})
    assert c.call("state")["faults"] == ["warning"]


def test_the_quality_of_set_points_is_reported_and_begun_again(controlled):
    c = controlled()
    assert c.call("state")["axes"][0]["set_points"] is None
    meter = c.node.drives[0].meter
    meter.used, meter.missed = True, 3
    assert c.call("state")["axes"][0]["set_points"] == {"missed": 3}
    assert c.call("restart_quality", axis=0) == {}
    assert c.call("state")["axes"][0]["set_points"] == {}
