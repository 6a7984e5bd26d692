"""An axis' process data, found by the profile's indices."""

import math
from types import SimpleNamespace

import pytest
from support.generic import write_generic
from support.robots import Bench

from canopen_control.cia402.drive_goal import DriveGoal
from canopen_control.cia402.units import Scale
from canopen_control.errors import SdoAbort, SdoTimeout
from canopen_control.hardware.axis import (
    BLIND_STOP_NS,
    GRACE_NS,
    POLL_NS,
    AxisObjectLimits,
    AxisStatus,
    ModeBySdo,
    StatuswordBySdo,
)
from canopen_control.hardware.axis_statechart import AxisPhase

MS = 1_000_000


class Node:
    """Takes SDO requests and lets the test answer them."""

    ready, node_id, name, holds_load, moves_axes = True, 2, "pan_drive", False, False

    def __init__(self):
        self.reads, self.writes, self.stopped_at = [], [], None

    def stop_as_last_resort(self, now):
        self.stopped_at = now

    def read(self, index, subindex, done):
        self.reads.append((index, subindex, done))

    def write(self, index, subindex, data, done=None):
        self.writes.append((index, data))
        self.written = done

    def answer(self, data, error=None):
        self.reads.pop(0)[2](SimpleNamespace(error=error, data=data))


def make_axis(*, mode=True, display=True, reacts=True):
    pdo = SimpleNamespace(stamp=0, overdue=False, values=(0x27, 9))

    def entry(position):
        return SimpleNamespace(pdo=pdo, position=position, value=pdo.values[position])

    return SimpleNamespace(
        node=Node(),
        index=lambda index: index,
        has=lambda _index: reacts,
        statusword=entry(0),
        display=entry(1) if display else None,
        mode=object() if mode else None,
        pdo=pdo,
    )


@pytest.mark.sources
def test_while_the_tpdo_comes_it_is_the_tpdos():
    axis = make_axis()
    status = AxisStatus(axis, SimpleNamespace(mode=9))
    status.update(0)
    assert (status.word, status.display) == (0x27, 9)
    assert axis.node.reads == []


@pytest.mark.sources
def test_a_requested_mode_that_no_pdo_carries_goes_by_sdo():
    axis = make_axis(mode=False)
    status = AxisStatus(axis, SimpleNamespace(mode_request=SimpleNamespace(sent=8)))
    status.update(0)
    assert axis.node.writes == [(0x6060, b"\x08")]
    assert status.display == 9, "the one that the TPDO shows"


@pytest.mark.sources
def test_before_the_first_frame_and_without_the_node_nothing_is_known():
    axis = make_axis()
    status = AxisStatus(axis, SimpleNamespace(mode=9, goal=DriveGoal.ENABLED))
    axis.pdo.stamp = -1
    status.update(0)
    assert (status.word, status.display) == (None, None)
    assert axis.node.reads == []
    assert status.blind_word(0) == 0
    axis.pdo.stamp, axis.node.ready = 5, False
    status.update(0)
    assert status.word is None


@pytest.mark.sources
@pytest.mark.parametrize(
    ("goal", "overdue"), [(DriveGoal.DISABLED, False), (DriveGoal.QUICK_STOPPED, False), (DriveGoal.ENABLED, True)]
)
def test_one_that_never_came_is_asked_for_by_sdo_where_an_end_waits_for_it(goal, overdue):
    axis = make_axis()
    axis.pdo.stamp, axis.pdo.overdue = -1, overdue
    status = AxisStatus(axis, SimpleNamespace(mode=9, goal=goal))
    status.update(0)
    assert status.word is None
    axis.node.answer(b"\x50\x02")
    status.update(MS)
    assert status.word == 0x0250


@pytest.mark.sources
def test_one_that_the_node_refuses_to_report_is_invisible_until_its_tpdo_comes():
    axis = make_axis()
    axis.pdo.stamp = -1
    status = AxisStatus(axis, SimpleNamespace(mode=9, goal=DriveGoal.DISABLED))
    status.update(0)
    axis.node.answer(b"", error=SdoTimeout(5, 0x6041, 0, 0.5))
    status.update(POLL_NS)
    assert not status.invisible
    axis.node.answer(b"", error=SdoAbort(5, 0x6041, 0, 0x060A0023, ""))
    status.update(2 * POLL_NS)
    assert status.invisible
    axis.pdo.stamp = 1
    status.update(3 * POLL_NS)
    assert not status.invisible


@pytest.mark.sources
def test_when_it_stays_away_the_last_one_holds_for_a_while_then_the_sdos_then_none():
    axis = make_axis()
    source = StatuswordBySdo(axis)
    assert source.word(0x27, 0) == 0x27
    assert [read[0] for read in axis.node.reads] == [0x6041]
    axis.node.answer(b"\x33\x02")
    assert source.word(0x27, 10 * MS) == 0x0233
    assert source.word(0x27, POLL_NS) == 0x0233
    assert len(axis.node.reads) == 1, "asked again"
    axis.node.answer(b"", error="timeout")
    assert source.word(0x27, GRACE_NS + 2 * MS) is None
    source.end()
    assert source.word(0x27, GRACE_NS + 3 * MS) == 0x27


@pytest.mark.sources
def test_a_drive_without_feedback_is_commanded_to_quick_stop_and_then_to_disable_voltage():
    axis = make_axis()
    status = AxisStatus(axis, SimpleNamespace(mode=9))
    axis.pdo.overdue = True
    assert status.blind_word(0) == 0x02
    assert status.blind_word(BLIND_STOP_NS - 1) == 0x02
    assert status.blind_word(BLIND_STOP_NS) == 0
    status.restart()
    status.node_lost(5 * BLIND_STOP_NS)
    assert status.blind_word(5 * BLIND_STOP_NS) == 0x02


@pytest.mark.sources
def test_a_master_without_feedback_does_not_disable_the_voltage_of_a_load_that_would_fall():
    axis = make_axis()
    status = AxisStatus(axis, SimpleNamespace(mode=9), holds_load=True)
    axis.pdo.overdue = True
    assert status.blind_word(0) == status.blind_word(100 * BLIND_STOP_NS) == 0x02


@pytest.mark.sources
@pytest.mark.parametrize(
    ("remote", "holds_load", "sent"), [(True, False, True), (True, True, False), (False, False, False)]
)
def test_nmt_stop_is_the_last_resort_for_a_drive_without_a_load_that_is_under_the_control_of_the_bus(
    remote, holds_load, sent
):
    axis = make_axis()
    status = AxisStatus(axis, SimpleNamespace(mode=9, remote=remote), holds_load=holds_load)
    for phase, word in ((AxisPhase.FORCED_QUICK_STOP, b"\2\0"), (AxisPhase.VOLTAGE_DISABLED, b"\0\0")):
        assert "NMT" not in status.force_stop(phase, MS)
        assert axis.node.writes[-1] == (0x6040, word)
        assert axis.node.stopped_at is None
    assert ("NMT stop was sent" in status.force_stop(AxisPhase.STOP_FAILED, 2 * MS)) is sent
    assert axis.node.stopped_at == (2 * MS if sent else None)


@pytest.mark.sources
@pytest.mark.parametrize(
    ("reacts", "end"), [(True, "as its 0x6007 says"), (False, "no object of the drive defines its reaction")]
)
def test_the_report_of_nmt_stop_names_the_object_with_the_reaction_only_if_the_drive_has_it(reacts, end):
    status = AxisStatus(make_axis(reacts=reacts), SimpleNamespace(mode=9, remote=True))
    assert status.force_stop(AxisPhase.STOP_FAILED, MS).endswith(end)


@pytest.mark.sources
def test_a_mode_without_pdos_is_written_once_and_asked_for_until_it_shows():
    axis = make_axis(mode=False, display=False)
    mode = ModeBySdo(axis)
    mode.step(None, 0)
    assert axis.node.writes == axis.node.reads == []
    mode.step(-1, 0)
    mode.step(-1, MS)
    assert axis.node.writes == [(0x6060, b"\xff")]
    axis.node.answer(b"\x00")
    mode.step(-1, 2 * MS)
    assert axis.node.reads == [], "not at once again"
    mode.step(-1, POLL_NS)
    axis.node.answer(b"\xff")
    assert mode.display == -1
    mode.step(-1, 9 * POLL_NS)
    assert axis.node.reads == []
    mode.forget()
    assert mode.display is None


@pytest.mark.sources
def test_a_mode_that_the_drive_refuses_is_written_again_with_the_reason_at_hand():
    """Device states in which 0x6060 is refused (0x08000022) end, and a lost answer says nothing of the drive."""
    axis = make_axis(mode=False, display=False)
    mode = ModeBySdo(axis)
    mode.step(8, 0)
    mode.step(8, 900 * MS)
    assert len(axis.node.writes) == 1, "it waits for the answer"
    axis.node.written(SimpleNamespace(error=SdoAbort(2, 0x6060, 0, 0x08000022, name="pan_drive"), data=b""))
    assert "0x6060:00" in mode.refusal
    assert "0x08000022" in mode.refusal
    assert "pan_drive" not in mode.refusal
    mode.step(8, 901 * MS)
    assert axis.node.writes == [(0x6060, b"\x08")] * 2
    axis.node.written(SimpleNamespace(error=None, data=b""))
    assert mode.refusal == ""
    mode.step(8, 9000 * MS)
    assert len(axis.node.writes) == 2


@pytest.mark.sources
def test_a_mode_that_is_requested_again_is_written_again():
    axis = make_axis(mode=False, display=False)
    mode = ModeBySdo(axis)
    mode.step(8, 0)
    axis.node.written(SimpleNamespace(error=None, data=b""))
    mode.step(None, 3000 * MS)  # it was not shown in time
    mode.step(8, 4000 * MS)
    assert axis.node.writes == [(0x6060, b"\x08")] * 2


@pytest.fixture
def servo(tmp_path):
    bench = Bench("axis", config=write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    bench.start()
    yield bench
    bench.close()


def test_limits_are_applied_in_device_units():
    limits = AxisObjectLimits()
    assert limits.of_velocity(-(1 << 31) + 1) == -(1 << 31) + 1
    limits.take_velocity(100.0, Scale())
    limits.low, limits.high = -5, 7
    limits.torque_positive, limits.torque_negative = 30, 20
    assert [limits.of_velocity(raw) for raw in (-200, -50, 50, 200)] == [-100, -50, 50, 100]
    assert [limits.of_position(raw) for raw in (-9, 0, 9)] == [-5, 0, 7]
    assert [limits.of_torque(raw) for raw in (-99, 0, 99)] == [-20, 0, 30]
    limits.blocked = 1
    assert [limits.of_velocity(raw) for raw in (-50, 50)] == [-50, 0]


@pytest.mark.parametrize(("described", "most"), [(math.inf, 5000.0), (0.5, 500.0), (20.0, 5000.0)])
def test_the_smaller_of_the_drives_and_the_descriptions_velocity_holds_for_steps_of_positions_too(described, most):
    limits, scale = (
        AxisObjectLimits(),
        Scale(vel_to_dev=-1000.0, vel_from_dev=-0.001, pos_to_dev=4000.0, pos_from_dev=1 / 4000),
    )
    limits.described = described
    limits.take_velocity(5000.0, scale)
    assert (limits.most, limits.pace) == (most, 4.0 * most)
    assert (limits.of_velocity(99_999), limits.held) == (most, True)
    limits.held = False
    assert (limits.of_velocity(int(most)), limits.held) == (most, False)


def test_what_is_held_is_standstill_at_a_position(servo):
    axis = servo.joint(2).axis
    axis.hold(1234)
    assert axis.output(0x607A).value == axis.output(0x60C1, 1).value == 1234
    assert axis.output(0x60FF).value == axis.output(0x6071).value == axis.output(0x6042).value == 0


def test_other_targets_stay_with_the_axis_while_one_is_used(servo):
    servo.robot.command("velocity", [1.0, 1.0], "test")
    servo.run(500)
    axis = servo.joint(2).axis
    assert axis.output(0x60FF).value == 10430
    assert axis.output(0x607A).value == pytest.approx(axis.raw_position, abs=1500)
    assert axis.raw_position > 1000


def test_it_is_stale_when_a_tpdo_of_its_feedback_is(servo):
    axis = servo.joint(2).axis
    assert not axis.is_stale
    axis.position.pdo.overdue = True
    assert axis.is_stale
    assert axis.has(0x603F)
    assert not axis.has(0x607B, 77)
