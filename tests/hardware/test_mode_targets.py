"""The target of each mode under a controller, its limits and its stop."""

import math
from types import SimpleNamespace

import pytest
from support.observers import Observer
from support.servos import DECELERATION, command

from canopen_control.cia402.modes import TARGET_OBJECTS, OperationMode
from canopen_control.cia402.units import PositionUnwrapper, Scale
from canopen_control.hardware.axis import AxisObjectLimits
from canopen_control.hardware.mode_targets import TARGET_CLASSES, ModeTarget, stop_slope

K = 65536 / math.tau  # counts per rad, and per rad/s
LIMIT = 0.8  # rad/s


@pytest.mark.parametrize(("key", "mode"), [("", 9), ("velocity_mode: 3", 3), ("velocity_mode: 2", 2)])
def test_velocity_by_csv_else_pv_else_vl(servo, key, mode):
    robby = servo("velocity", key)
    command(robby, "velocity", 2.0, 1000)
    assert robby.drives[2].get(0x6061) == mode
    assert robby.joint(2).states["velocity"].value == pytest.approx(2.0, rel=0.02)
    command(robby, "velocity", -1.0, 1000)
    assert robby.joint(2).states["velocity"].value == pytest.approx(-1.0, rel=0.06)  # VL counts whole rpm


@pytest.mark.parametrize(("key", "mode"), [("", 10), ("effort_mode: 4", 4)])
def test_effort_by_cst_else_tq(servo, key, mode):
    robby = servo("effort", key)
    command(robby, "effort", 100.0, 300)
    assert robby.drives[2].get(0x6061) == mode
    assert robby.drives[2].get(0x6071) == 100
    assert robby.joint(2).states["effort"].value == pytest.approx(0.1)
    robby.robot.stop(lambda _error: None)
    robby.run(30)
    assert robby.drives[2].get(0x6071) == 0


@pytest.mark.parametrize(
    ("controller", "key"),
    [("velocity", ""), ("velocity", "velocity_mode: 3"), ("position", ""), ("position", "position_mode: 7")],
)
def test_a_stop_is_a_ramp_in_every_mode(servo, controller, key):
    """In CSV, CSP and IP the master makes it: the drive would stop as fast as it can."""
    robby = servo(controller, key)
    value = 0.0
    for _ in range(100):
        value = value + 0.02 if controller == "position" else 2.0
        command(robby, controller, value, 10)
    fast = abs(robby.speed(2))
    assert fast == pytest.approx(2.0 * 65536 / math.tau, rel=0.03)
    begin = robby.reactor.now()
    robby.robot.stop(lambda _error: None)
    steps, last = [], fast
    while not robby.standing(2):
        robby.run(10)
        steps.append(last - abs(robby.speed(2)))
        last = abs(robby.speed(2))
    took = (robby.reactor.now() - begin) / 1e9
    assert took == pytest.approx(2.0 / DECELERATION, abs=0.05)
    assert max(steps) <= 262144 * 0.01 * 1.6, "no jump"
    assert not robby.found("fault")
    robby.disabled_after()


@pytest.mark.rest
@pytest.mark.parametrize(("key", "mode"), [("", 8), ("position_mode: 1", 1), ("position_mode: 7", 7)])
def test_position_by_csp_else_pp_else_ip(servo, key, mode):
    robby = servo("position", key)
    value = 0.0
    for step in range(300):  # a slow path: IP has no ramp of its own
        value = min(0.5, step * 0.002)
        command(robby, "position", value, 10)
    robby.run(500)
    assert robby.drives[2].get(0x6061) == mode
    assert robby.joint(2).states["position"].value == pytest.approx(0.5, abs=0.001)
    assert not robby.found("fault")


@pytest.mark.rest
def test_a_position_jump_in_csp_is_made_with_the_largest_velocity(servo):
    robby = servo("position", sdo="- {index: 0x607F, sub_index: 0, value: 20000}")
    fastest = []
    robby.robot.observers.append(Observer(after_cycle=lambda _now: fastest.append(abs(robby.speed(2)))))
    command(robby, "position", 5.0, 4000)
    assert robby.joint(2).states["position"].value == pytest.approx(5.0, abs=0.01)
    assert max(fastest) <= 20500


def test_without_a_command_an_enabled_axis_stays_where_it_is(servo):
    robby = servo("position")
    before = robby.drives[2].get(0x6064)
    robby.run(500)
    assert robby.drives[2].get(0x6064) == before
    assert robby.joint(2).enabled


@pytest.mark.rest
def test_a_pace_below_a_count_in_a_cycle_is_kept_too(servo):
    robby = servo("position", velocity=0.002)  # 20.9 counts per s
    first = robby.joint(2).axis.output(0x607A).value
    command(robby, "position", 50.0, 5000)
    assert robby.joint(2).axis.output(0x607A).value - first == pytest.approx(5 * 0.002 * K, abs=2)


@pytest.mark.rest
def test_a_target_that_is_slowed_down_is_reported_once_for_each_occasion(servo):
    robby = servo("velocity", velocity=LIMIT)
    command(robby, "velocity", 6.0, 1000)
    for value in (6.1, 6.2, 6.3):
        command(robby, "velocity", value, 300)
    assert len(robby.texts("held_back")) == 2  # of two joints
    assert "the target of one exceeds the velocity limit of the description" in robby.texts("held_back")[0]
    command(robby, "velocity", 0.5, 2000)
    command(robby, "velocity", 6.0, 300)
    assert len(robby.texts("held_back")) == 4


def test_a_velocity_limit_of_zero_is_one_that_is_not_given(servo):
    robby = servo("velocity", velocity=0)
    command(robby, "velocity", 2.0, 1000)
    assert robby.speed(2) == pytest.approx(2.0 * K, rel=0.02)


def axis(deceleration=math.inf):
    return SimpleNamespace(limits=SimpleNamespace(deceleration=deceleration, blocked=0))


class Mode(ModeTarget):
    hold = follow = ramp_down = value_range = None


@pytest.mark.sources
@pytest.mark.parametrize(("reported", "slope"), [(4000.0, 4000.0), (math.inf, 200.0), (0.0, 200.0), (math.nan, 200.0)])
def test_a_drive_that_reports_no_deceleration_is_stopped_in_half_a_second(reported, slope):
    assert stop_slope(axis(reported), 100) == slope


@pytest.mark.sources  # compiled classes have no interpreted subclasses
def test_a_mode_without_limits_or_events_of_its_own_has_none():
    target = Mode(axis(), SimpleNamespace(value=0), SimpleNamespace())
    assert not target.commands_into_limit(1.0)
    assert target.events() == ()


@pytest.mark.sources  # compiled classes take no stand-ins
def test_a_mode_without_its_own_target_cannot_be_made():
    with pytest.raises(TypeError, match="abstract methods follow, hold, ramp_down, value_range"):
        ModeTarget(axis(), SimpleNamespace(value=0), SimpleNamespace())


def test_every_mode_whose_target_is_known_has_its_class():
    assert TARGET_CLASSES.keys() == TARGET_OBJECTS.keys()


@pytest.mark.sources
@pytest.mark.parametrize("mode", [OperationMode.CSP, OperationMode.IP])
def test_a_position_at_every_sync_stays_within_the_software_limits(mode):
    output = SimpleNamespace(value=0)
    output.set = lambda value: setattr(output, "value", value)
    axis = SimpleNamespace(
        limits=AxisObjectLimits(),
        unwrap=PositionUnwrapper(),
        scale=Scale(1000.0, 0.001),
        raw_position=0,
        out_of_range=math.nan,
    )
    axis.unwrap.update(0)
    axis.limits.low, axis.limits.high = -200, 300
    target = TARGET_CLASSES[mode](axis, output, SimpleNamespace())
    for value, end in ((5.0, 300), (-5.0, -200), (0.1, 100)):
        for _ in range(3):
            target.follow(value, 0, 0.02)
        assert output.value == end


@pytest.mark.rest
@pytest.mark.parametrize(
    ("interface", "key", "value"),
    [
        ("velocity", "velocity_mode: 9", 6.0),
        ("velocity", "velocity_mode: 3", 6.0),
        ("velocity", "velocity_mode: 2", 6.0),
        ("position", "position_mode: 8", 50.0),
        ("position", "position_mode: 1", 50.0),
        ("position", "position_mode: 7", 50.0),
        ("effort", "effort_mode: 10", 300.0),
        ("effort", "effort_mode: 4", 300.0),
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_the_velocity_limit_of_the_description_holds_in_every_mode(servo, interface, key, value, sign):
    robby = servo(interface, key, velocity=LIMIT)
    speeds = []
    robby.robot.observers.append(Observer(after_cycle=lambda _now: speeds.append(sign * robby.speed(2) / K)))
    command(robby, interface, sign * value, 3000)
    # a torque is judged by what it did, and TQ takes it away along its slope (0x6087)
    assert max(speeds) < (1.2 if interface == "effort" else 1.03) * LIMIT
    assert max(speeds) > 0.8 * LIMIT


@pytest.mark.parametrize("after", [2.0, 0.1])
@pytest.mark.parametrize("end", ["halt", "stop"])
def test_an_enable_after_a_halt_or_a_stop_does_not_resume_the_old_set_point(robot, end, after):
    """A drive in PP keeps its set-point while the halt bit is set, and continues to it afterwards."""
    created = robot("pp")
    created.command("pos", 2.5, 2.5, seconds=1)
    created.run(1)
    if end == "halt":
        created.do("axis", name="halt")
    else:
        created.stop()
    created.run(after)
    created.enable()
    created.until(lambda: created.state == "running", 5)
    assert created.stopped_within(0.1)
    position = created.position("pan")
    created.run(2)
    assert created.position("pan") == position < 1.5
    created.command("pos", 1.6, 1.6, seconds=3)
    created.run(3)
    assert created.position("pan") == pytest.approx(1.6, abs=0.01)
    assert created.breaches == []
