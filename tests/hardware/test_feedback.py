"""States of a joint: continuous, plausible, nan where nothing is known."""

import math
import re
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import makers
from support.makers import drive

from canopen_control.cia301.pdo import MappedObject
from canopen_control.cia402.units import PositionUnwrapper, Scale, wrap_int32
from canopen_control.hardware.axis import AxisObjectLimits
from canopen_control.hardware.feedback import Feedback, unit_mismatch
from canopen_control.master.cycle import ProcessImage
from canopen_control.od.model import DataType
from canopen_control.urdf.joint_element import InterfaceInfo
from canopen_control.urdf.ros2_control import ControlJoint
from canopen_control.virtual.virtual_drive import VirtualDrive

pytestmark = pytest.mark.sources  # stand-ins for an axis or a joint

COUNTS = 1000.0  # per radian
CYCLE = 20_000_000
MS = 1_000_000


def make(*, velocity=True, extras=()):
    image = ProcessImage()
    objects = [MappedObject(0x6064, 0, 32, DataType.INTEGER32)]
    if velocity:
        objects.append(MappedObject(0x606C, 0, 32, DataType.INTEGER32))
    pdo = image.add_tpdo(2, 0x182, objects, 1)
    axis = SimpleNamespace(
        scale=Scale(COUNTS, 1 / COUNTS, COUNTS, 1 / COUNTS),
        unwrap=PositionUnwrapper(),
        limits=AxisObjectLimits(),
        turn=COUNTS * math.tau,
        position=image.input(2, 0x6064),
        velocity=image.input(2, 0x606C),
        effort=None,
        statusword=image.input(2, 0x6064),
        digital_inputs=None,
        error_code=None,
        node=SimpleNamespace(nmt_state=None, fault=None),
    )
    description = ControlJoint("joint", state_interfaces={name: InterfaceInfo(name) for name in extras})
    feedback = Feedback(description, axis)
    feedback.put = lambda now, *values: pdo.receive(pdo.codec.pack(values).ljust(8, b"\0"), pdo.codec.length, now)
    return feedback, axis


def test_values_that_come_again_are_taken_again_once_the_node_is_back():
    feedback, axis = make()
    feedback.put(0, 1000, 500)
    feedback.read(0)
    feedback.node_lost()
    feedback.node_ready()
    feedback.read(CYCLE)
    assert math.isnan(feedback.states["position"].value)
    pdo = axis.position.pdo
    pdo.stamp, pdo.count = 2 * CYCLE, pdo.count + 1  # as a read of the port with the frames of the one before
    feedback.read(2 * CYCLE)
    assert [feedback.states[name].value for name in ("position", "velocity")] == [1.0, 0.5]


def test_a_new_scale_counts_for_values_that_come_again():
    feedback, axis = make()
    for now in (0, CYCLE):
        feedback.put(now, 1000, 0)
        feedback.read(now)
    axis.scale = Scale(2 * COUNTS, 0.5 / COUNTS, COUNTS, 1 / COUNTS)
    feedback.refresh_scale()
    feedback.read(CYCLE)
    assert feedback.states["position"].value == 0.5


def test_values_are_nan_before_the_first_frame_and_without_the_node():
    feedback, _ = make()
    feedback.read(0)
    assert all(math.isnan(state.value) for state in feedback.states.values())
    feedback.put(0, 1000, 0)
    feedback.read(0)
    assert feedback.states["position"].value == 1.0
    feedback.node_lost()
    assert all(math.isnan(state.value) for state in feedback.states.values())


@given(st.lists(st.integers(-1400, 1400), min_size=1, max_size=60), st.integers(-(1 << 31), (1 << 31) - 1))
def test_plausible_steps_add_up_wherever_the_counter_wraps(steps, start):
    feedback, _ = make()
    feedback.put(0, start, 0)
    feedback.read(0)
    first, raw = feedback.states["position"].value, start
    for number, step in enumerate(steps, 1):
        raw = wrap_int32(raw + step)
        feedback.put(number * CYCLE, raw, step * 50)
        assert feedback.read(number * CYCLE) == 0
    assert feedback.states["position"].value == pytest.approx(first + sum(steps) / COUNTS, abs=1e-6)


@given(st.integers(-(1 << 30), 1 << 30).filter(lambda jump: abs(jump) > 10_000))
def test_a_step_that_no_motor_makes_is_a_jump_and_no_motion(jump):
    feedback, _ = make()
    feedback.put(0, 0, 100)
    feedback.read(0)
    feedback.put(CYCLE, jump, 100)
    assert feedback.read(CYCLE) == jump
    feedback.unit_mismatch_of_jump(math.nan)  # no velocity was sent: raises nothing
    assert feedback.states["position"].value == 0.0
    feedback.put(2 * CYCLE, jump + 500, 100)
    assert feedback.read(2 * CYCLE) == 0
    assert feedback.states["position"].value == 0.5


def test_the_faster_it_turns_the_more_is_plausible():
    feedback, _ = make()
    feedback.put(0, 0, 2_000_000)
    feedback.read(0)
    feedback.put(CYCLE, 40_000, 2_000_000)
    assert feedback.read(CYCLE) == 0


def test_without_a_velocity_the_drives_largest_one_is_the_measure():
    feedback, axis = make(velocity=False)
    feedback.put(0, 0)
    feedback.read(0)
    feedback.put(CYCLE, 1_000_000)
    assert feedback.read(CYCLE) == 0, "nothing is known of it"
    axis.limits.velocity = 10_000
    feedback.put(2 * CYCLE, 2_000_000)
    assert feedback.read(2 * CYCLE) == 1_000_000


def test_a_node_that_is_back_continues_where_the_joint_was():
    feedback, _ = make()
    feedback.put(0, 5000, 0)
    feedback.read(0)
    feedback.node_ready()
    feedback.put(CYCLE, -1_000_000, 0)
    assert feedback.read(CYCLE) == 0
    assert feedback.states["position"].value == 5.0
    feedback.restart()
    feedback.put(2 * CYCLE, 0, 0)
    feedback.read(2 * CYCLE)
    assert feedback.states["position"].value == 0.0, "homed: its own count"


def test_standing_is_by_velocity_else_by_a_position_that_does_not_change():
    feedback, _ = make()
    feedback.put(0, 0, 40)
    feedback.read(0)
    assert feedback.at_standstill
    feedback.put(CYCLE, 1, 60)
    feedback.read(CYCLE)
    assert not feedback.at_standstill
    feedback, _ = make(velocity=False)
    for number in range(3):
        feedback.put(number * CYCLE, number)
        feedback.read(number * CYCLE)
        assert not feedback.at_standstill
    for number in range(3, 9):
        feedback.put(number * CYCLE, 2)
        feedback.read(number * CYCLE)
    assert feedback.at_standstill


def cruise(feedback, checks, *, counts, shown=0, start=0):
    """Put positions that change by `counts` in each check of 0.1 s; return the texts about hidden motion."""
    texts = []
    for number in range(start, start + checks):
        for cycle in range(5):
            now = number * 100_000_000 + cycle * CYCLE
            feedback.put(now, number * counts + cycle * counts // 5, shown)
            feedback.read(now)
        feedback.velocity_unit_mismatch(now)
        texts.append(feedback.hidden_motion)
    return texts


def test_a_velocity_of_0_is_no_standstill_while_the_position_changes():
    """Drives without a sensor for the velocity show 0 in 0x606C."""
    feedback, _ = make()
    texts = cruise(feedback, 6, counts=100)  # 1 rad/s
    assert not feedback.at_standstill
    assert [text is not None for text in texts] == [False, False, True, False, False, False]
    assert "remove 0x606C" in texts[2]
    feedback.put(599 * MS, 600, 30)  # a velocity that is noise
    feedback.read(599 * MS)
    assert not feedback.at_standstill
    cruise(feedback, 2, counts=0, start=6)
    assert feedback.at_standstill


def test_the_end_of_a_motion_that_was_shown_is_a_standstill_at_once():
    feedback, _ = make()
    cruise(feedback, 3, counts=100, shown=1000)
    feedback.put(301 * MS, 310, 0)
    feedback.read(301 * MS)
    assert feedback.at_standstill
    feedback.velocity_unit_mismatch(400 * MS)
    assert feedback.at_standstill
    assert feedback.hidden_motion is None


@pytest.mark.parametrize("counts", [1, -2, 5])
def test_a_position_that_creeps_or_flickers_by_a_count_is_a_standstill(counts):
    feedback, _ = make()
    assert cruise(feedback, 6, counts=counts) == [None] * 6
    assert feedback.at_standstill


def test_the_time_of_a_ramp_is_known_from_the_last_velocity():
    feedback, axis = make()
    assert feedback.ramp_ns(7) == 7
    feedback.put(0, 0, 10_000)
    feedback.read(0)
    axis.limits.deceleration = 20_000
    assert feedback.ramp_ns(10**10) == pytest.approx(0.7e9)


def test_further_interfaces_are_those_of_the_description():
    feedback, axis = make(extras=("age", "nmt_state", "error_code", "elsewhere"))
    assert list(feedback.states) == ["position", "velocity", "age", "nmt_state", "error_code"]
    feedback.put(0, 0, 0)
    feedback.read(5_000_000)
    assert feedback.states["age"].value == 0.005
    assert math.isnan(feedback.states["nmt_state"].value)
    axis.node.fault = SimpleNamespace(error_code=0x4310)
    feedback.read(5_000_000)
    assert feedback.states["error_code"].value == 0x4310


@pytest.mark.parametrize("raw", [2500, -2500])
def test_a_velocity_has_the_sign_of_the_motion(raw):
    feedback, _ = make()
    feedback.put(0, 0, raw)
    feedback.read(0)
    assert feedback.states["velocity"].value == raw / COUNTS
    feedback.put(CYCLE, raw // 50, raw)
    feedback.read(CYCLE)
    assert feedback.states["position"].value * raw > 0


def in_rpm(feedback, *, rpm, factor, cycles=40):
    """Turn at `rpm`; the drive tells `rpm * factor` as its velocity. Return whether that was told, and jumps."""
    reported, jumps, position = [], [], 0.0
    for cycle in range(1, cycles + 1):
        now = cycle * CYCLE
        position += rpm / 60.0 * COUNTS * math.tau * CYCLE / 1e9
        feedback.put(now, wrap_int32(round(position)), round(rpm * factor))
        if feedback.read(now):
            jumps.append(feedback.unit_mismatch_of_jump())
        if cycle % 5 == 0:
            reported.append(feedback.velocity_unit_mismatch(now))
    return [[None if item is None else item.text for item in result] for result in (reported, jumps)]


@pytest.mark.parametrize("rpm", [80, -80, 1000])
def test_a_drive_whose_velocities_are_in_rpm_is_recognised_by_its_motion(rpm):
    feedback, _ = make()
    reported, jumps = in_rpm(feedback, rpm=rpm, factor=1)
    assert sum(map(bool, reported)) == 1 or jumps
    assert all("in rpm" in text for text in filter(None, [*reported, *jumps]))
    assert all(jumps)


@pytest.mark.parametrize(
    ("unit", "per_turn", "scale"),
    [
        ("rpm", 60, "9.549297"),
        ("0.1 rpm", 600, "95.49297"),
        ("deg/s", 360, "57.29578"),
        ("0.001 rev/s", 1000, "159.1549"),
    ],
)
def test_a_unit_is_named_with_its_scale(unit, per_turn, scale):
    feedback, _ = make()
    reported, jumps = in_rpm(feedback, rpm=80, factor=per_turn / 60)
    (text,) = filter(None, reported)
    assert not jumps
    assert text.startswith("it turns much faster than its velocity (0x606C) shows, as if its ")
    assert f"velocities were in {unit} instead of counts per second" in text
    assert f"scale_vel_to_dev: {scale}, " in text
    assert ("0x60A9" in text) == unit.endswith("rpm")


def test_counts_that_are_taken_for_rpm_are_named_by_a_motion_that_is_too_slow():
    feedback, axis = make()
    axis.scale = Scale(COUNTS, 1 / COUNTS, 9.549297, 0.1047198)
    reported, _ = in_rpm(feedback, rpm=80, factor=COUNTS * math.tau / 60.0)
    (text,) = filter(None, reported)
    assert "turns much slower than its velocity" in text
    assert not unit_mismatch(axis, 8000.0, 8000, rising=False).faster  # a warning: nothing is faster than it was to be
    assert "velocities were in counts per second instead of another unit" in text
    assert "scale_vel_to_dev: 1000, scale_vel_from_dev: 0.001" in text


def test_a_motor_behind_a_gear_is_recognised_by_its_own_turns():
    feedback, axis = make()
    axis.turn = COUNTS * math.tau / 5  # the motor makes five turns for one of the joint
    reported, _ = in_rpm(feedback, rpm=80, factor=5)
    (text,) = filter(None, reported)
    assert "velocities were in rpm" in text
    assert "scale_vel_to_dev: 47.74648, " in text


@pytest.mark.parametrize("factor", [COUNTS * math.tau / 60.0, COUNTS * math.tau / 60.0 / 2, 30.0])
def test_other_velocities_are_not_unit(factor):
    feedback, _ = make()
    reported, jumps = in_rpm(feedback, rpm=80, factor=factor)
    assert not any(reported)
    assert not any(jumps)


def test_a_position_that_jumps_while_it_stands_is_not_a_unit():
    feedback, _ = make()
    feedback.put(CYCLE, 0, 0)
    feedback.read(CYCLE)
    feedback.put(2 * CYCLE, 1_000_000, 0)
    assert feedback.read(2 * CYCLE) == 1_000_000
    assert not feedback.unit_mismatch_of_jump()


def test_a_drive_in_rpm_is_recognised_while_it_still_gets_faster():
    feedback, _ = make()
    per_cycle = COUNTS * math.tau / 60.0 * CYCLE / 1e9  # counts of one rpm
    position, before, jumps = 0.0, 0, []
    for cycle in range(1, 220):
        rpm = max(0, cycle - 200) * 600
        position += (before + rpm) / 2 * per_cycle
        before = rpm
        feedback.put(cycle * CYCLE, round(position), rpm)
        if feedback.read(cycle * CYCLE):
            jumps.append(feedback.unit_mismatch_of_jump())
    assert jumps
    assert all(jumps)


def _ranged(text, low, high):
    for sub, value in ((1, low), (2, high)):
        text = re.sub(rf"(?ms)(^\[607Bsub{sub}\].*?^DefaultValue=)[^\n]*", rf"\g<1>{value}", text)
    return text


@pytest.mark.parametrize(
    ("low", "high", "span"),
    [
        (0, 655_359, 655_360),
        (-1000, 999, 2000),
        (0, 0, 1 << 32),
        (999, -1000, 1 << 32),
        (-(2**31), 2**31 - 1, 1 << 32),
        (-(2**31) + 1, 2**31 - 1, 1 << 32),
    ],
)
def test_the_range_of_positions_is_that_of_0x607b_if_it_is_one(robot, low, high, span):
    created = robot("pv", edit=lambda text: _ranged(text, low, high))
    assert created.simulated.core.joints["pan"].axis.unwrap.span == span


@pytest.mark.parametrize("stored", [False, True])
def test_a_wheel_whose_drive_wraps_its_position_at_0x607b_continues(robot, monkeypatch, stored):
    """A modulo axis of 10 motor revolutions, within one of the wheel, so that only the range shows a wrap."""
    attach = VirtualDrive._attach

    def wrapped(self):
        attach(self)
        if stored:  # only the drive's memory has the range
            self._store.preset(0x607B, 1, 0)
            self._store.preset(0x607B, 2, 655_359)
        source = self._store.source_of(0x6064, 0)
        self._store.on_read(0x6064, 0, lambda: source() % 655_360)

    monkeypatch.setattr(VirtualDrive, "_attach", wrapped)
    created = robot("pv", edit=lambda text: _ranged(text, 0, 0 if stored else 655_359))
    created.command("vel", 1.0, 1.0, seconds=4)
    created.run(4.0)
    assert created.position("pan") == pytest.approx(drive(created, 2).mover.plant.position / makers.COUNTS, abs=0.03)
    assert created.position("pan") > 3.0
    assert created.state == "running"
