from dataclasses import replace

import pytest
from support.simulated import MS, S, setup_of

from canopen_control.bus.frame_router import DropRule
from canopen_control.frame import CanFrame, pack_records
from canopen_control.runtime.setup import BUS_NAME
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.robot_under_test import MASTER, RobotUnderTest
from canopen_control.simulation.simulation_run import SimulationRun
from canopen_control.simulation.wire_invariants import WireInvariants
from canopen_control.simulation.wire_view import WireView
from canopen_control.virtual.scenario import ScenarioEvent


class Judged:
    """Rules of a wire that hear what they are given; the robot is not started."""

    def __init__(self, bus=None):
        bus = bus or setup_of().bus
        self.robot = RobotUnderTest(setup_of(), 1)
        self.wire = self.robot.wires[BUS_NAME]
        self.collected = []
        self.rules = WireInvariants(
            self.robot, self.wire, WireView(bus), lambda rule, text: self.collected.append(rule)
        )
        self.now = self.robot.now_ns + 10 * S

    def hear(self, can_id, data=b"", *, after=0, label=MASTER):
        self.now += after
        self.rules.hear(self.now, label, pack_records([CanFrame(can_id, data)]))


def replace_in_master(**keys):
    bus = setup_of().bus
    return replace(bus, master=replace(bus.master, **keys))


@pytest.fixture
def judged():
    created = Judged()
    yield created
    created.robot.close()


def test_a_sync_and_a_heartbeat_in_time_are_not_news_late_ones_are(judged):
    for _ in range(20):
        judged.hear(0x080, after=20 * MS)
    assert judged.collected == []
    judged.hear(0x080, after=40 * MS)
    assert judged.collected == ["late"]
    judged.hear(0x701, b"\x05")
    judged.hear(0x701, b"\x05", after=200 * MS)
    assert judged.collected == ["late"] * 2


def test_the_heartbeat_is_judged_by_its_default_if_bus_yml_is_silent():
    created = Judged(replace_in_master(heartbeat_producer=0))
    try:
        created.hear(0x701, b"\x05")
        created.hear(0x701, b"\x05", after=100 * MS)
        assert created.collected == []
        created.hear(0x701, b"\x05", after=200 * MS)
        assert created.collected == ["late"]
    finally:
        created.robot.close()


def test_a_port_that_cannot_send_is_not_late(judged):
    judged.hear(0x080)
    judged.wire.cut.add(MASTER)
    judged.rules.on_sample(judged.now)
    judged.wire.cut.clear()
    judged.hear(0x080, after=500 * MS)
    assert judged.collected == []


READ, ANSWER, ABORT = b"\x40\x41\x60\x00\0\0\0\0", b"\x4b\x41\x60\x00\0\0\0\0", b"\x80\x41\x60\x00\0\0\4\5"
BLOCK, SEGMENT = b"\xc6\x41\x60\x00\0\0\0\0", b"\x60\0\0\0\0\0\0\0"


@pytest.mark.parametrize("between", [(0x583, ANSWER, "drive 3"), (0x603, ABORT, MASTER), None])
def test_a_request_waits_for_the_answer_an_abort_or_the_time_out(judged, between):
    judged.hear(0x603, READ)
    if between is not None:
        judged.hear(between[0], between[1], after=MS, label=between[2])
    judged.hear(0x603, READ, after=MS if between else 200 * MS)
    assert judged.collected == []


def test_a_request_before_the_answer_is_reported(judged):
    judged.hear(0x603, READ)
    judged.hear(0x602, READ, after=MS)
    assert judged.collected == []
    judged.hear(0x603, READ, after=MS)
    assert judged.collected == ["sdo_overlap"]


def test_a_request_after_an_abort_that_may_be_lost_is_not_reported(judged):
    judged.wire.lost.append(DropRule("", every=2))
    judged.hear(0x603, READ)
    judged.rules.on_sample(judged.now)
    judged.wire.lost.clear()
    judged.hear(0x603, READ, after=MS)
    assert judged.collected == []


def test_blocks_are_not_requests(judged):
    judged.hear(0x603, BLOCK)
    for number in range(1, 5):
        judged.hear(0x603, bytes((number,)) + bytes(7), after=MS)
    assert judged.collected == []


def test_a_bus_beyond_its_budget_is_reported(judged):
    judged.rules.on_sample(judged.now)
    judged.wire._wire.bits += 500_000
    judged.rules.on_sample(judged.now + S)
    assert judged.collected == ["bus_budget"]
    judged.rules.on_sample(judged.now + 2 * S)
    assert judged.collected == ["bus_budget"]


@pytest.mark.rest
def test_the_seed_whose_abort_was_lost_breaks_nothing():
    acts = (
        ScenarioEvent(600 * MS, "command", "forklift_base_controller", values=(0.286, -0.41), for_ns=1278 * MS),
        ScenarioEvent(5549 * MS, "command", "forklift_base_controller", values=(0.381, 0.626), for_ns=740 * MS),
        ScenarioEvent(7070 * MS, "lose", values=(2.0,), for_ns=718_333_333),
    )
    run = SimulationRun(setup_of("forklift"), 1101, acts, motions=motions_of(setup_of("forklift")))
    run.run(8 * S)
    run.close()
    assert run.breaches == ()


def test_the_seed_of_a_strangers_short_frames_breaks_nothing():
    acts = (
        ScenarioEvent(614 * MS, "frame", values=(388.0, 8.0, 76.0, 49.0, 78.0)),
        ScenarioEvent(778 * MS, "frame", values=(515.0, 52.0, 241.0, 244.0, 71.0, 102.0, 62.0)),
    )
    run = SimulationRun(setup_of("forklift"), 76, acts, motions=motions_of(setup_of("forklift")))
    run.run(3 * S)
    run.close()
    assert run.breaches == ()
