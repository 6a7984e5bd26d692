from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.control import DIFF_DRIVE, FORWARD, Hardware, S, add, manager, same, vectors
from support.properties import examples

from canopen_control.controllers.base import ControllerState, DriveGeometry
from canopen_control.controllers.diff_drive import Odometry, wheel_velocities
from canopen_control.controllers.limiters import SLOW_STOP
from canopen_control.errors import ControlError, RobotConfigError
from canopen_control.hardware.interfaces import ReturnType
from canopen_control.rpc.messages.parameters import ParameterValue


@pytest.mark.parametrize("case", vectors("odometry_rolling_upstream"), ids=lambda case: case["name"])
def test_it_follows_the_wheels_as_upstream_does(case):
    odometry = Odometry(case["sep"], case["rl"], case["rr"], case["window"])
    odometry.begin(0.0, 0.0, 0)
    now, result = 0, None
    for verb, *values in case["steps"]:
        if verb == "set":
            odometry.set_pose(*values)
            continue
        left, right, dt = values
        now += round(dt * S)
        steps = {"vel": odometry.update_velocity, "pos": odometry.update_position, "open": odometry.update_open_loop}
        result = steps[verb](left, right, now)
    for name, expected in case["expect"].items():
        results = result if name == "ret" else getattr(odometry, name)
        assert results == expected or same(results, expected, 1e-5), name


def drive(odometry: Odometry, path: list[tuple[float, float, int]], dt: float = 0.02) -> None:
    """Drive (m/s, rad/s, steps) with wheels that follow their commands exactly."""
    now, left, right = 0, 3.0, -5.0
    odometry.update_position(left, right, now)
    for linear, angular, steps in path:
        speed_left, speed_right = wheel_velocities(linear, angular, 0.24, 0.035, 0.035)
        for _ in range(steps):
            now += round(dt * S)
            left, right = left + speed_left * dt, right + speed_right * dt
            odometry.update_position(left, right, now)


@given(st.floats(0.05, 2.0), st.integers(3, 400), st.sampled_from([1, -1]), st.booleans())
@settings(max_examples=examples(40))
def test_a_circle_ends_where_it_began(radius, steps, sense, backward):
    odometry = Odometry(0.24, 0.035, 0.035)
    turn = sense * 2 * math.pi / (steps * 0.02)
    drive(odometry, [(-radius * abs(turn) if backward else radius * abs(turn), turn, steps)])
    assert math.hypot(odometry.x, odometry.y) < 1e-9
    assert same(odometry.heading, sense * 2 * math.pi)


@pytest.mark.rest
def test_the_heading_survives_a_million_steps():
    odometry = Odometry(0.24, 0.035, 0.035, 1)
    odometry.begin(0.0, 0.0, 0)
    for step in range(1, 1_000_001):
        odometry.update_open_loop(0.1, 0.01 if step % 2 else -0.01, step * 1_000_000)
    assert abs(odometry.heading) < 1e-9
    assert same(odometry.x, 100.0, 1e-6)


def test_after_a_stop_the_next_sample_is_where_it_continues_from():
    odometry = Odometry(1.0, 1.0, 1.0)
    odometry.update_position(0.0, 0.0, 0)
    odometry.update_position(1.0, 1.0, S)
    odometry.stop()
    odometry.update_position(50.0, 50.0, 2 * S)
    odometry.update_position(51.0, 51.0, 3 * S)
    assert odometry.x == 2.0


def test_velocities_are_means_over_the_window_fewer_until_it_is_full():
    odometry = Odometry(1.0, 1.0, 1.0, 2)
    odometry.begin(0.0, 0.0, 0)
    results = []
    for step, speed in enumerate((1.0, 3.0, 5.0), 1):
        odometry.update_velocity(speed, speed, step * S)
        results.append(odometry.linear)
    assert results == [1.0, 2.0, 4.0]
    odometry.set_pose(1.0, 2.0, 3.0)
    odometry.update_velocity(7.0, 7.0, 4 * S)
    assert odometry.linear == 7.0


def test_wheels_that_stand_leave_the_pose_and_the_next_step_is_measured_from_the_last_time():
    odometry = Odometry(0.24, 0.035, 0.035, 3)
    drive(odometry, [(0.5, 0.2, 10), (0.0, 0.0, 10)])
    pose, now = (odometry.x, odometry.y, odometry.heading), 2 * S
    angles = odometry._left / 0.035, odometry._right / 0.035
    odometry.begin(*angles, now)
    for _ in range(20):
        now += S // 50
        assert odometry.update_position(*angles, now)
    assert (odometry.x, odometry.y, odometry.heading) == pose
    assert (odometry.linear, odometry.angular) == (0.0, 0.0)
    odometry.update_position(angles[0] + 1.0, angles[1] + 1.0, now + S // 50)
    assert odometry.linear == pytest.approx(0.035 * 50 / 3)


def test_a_step_too_short_to_measure_is_put_off_to_the_next():
    odometry = Odometry(1.0, 1.0, 1.0)
    odometry.update_position(0.0, 0.0, 0)
    assert not odometry.update_position(0.5, 0.5, 50_000)
    assert odometry.update_position(1.0, 1.0, S)
    assert odometry.x == 1.0


WHEELS = {"left_wheel_names": ["l"], "right_wheel_names": ["r"], "wheel_separation": 0.24, "wheel_radius": 0.035}


def robot(**params: Any):
    """Return hardware, manager and a configured diff drive."""
    hardware = Hardware(
        "l/velocity", "r/velocity", states=("l/position", "r/position", "l/velocity", "r/velocity"), name="base"
    )
    for interface in hardware.state_interfaces:
        interface.value = 0.0
    control = manager(hardware)
    return hardware, control, add(control, "base", DIFF_DRIVE, **{**WHEELS, **params})


@pytest.mark.parametrize("case", vectors("wheel_kinematics"), ids=lambda case: case["name"])
def test_a_twist_becomes_wheel_speeds(case):
    left, right = wheel_velocities(
        case["linear"],
        case["angular"],
        case["wheel_separation"] * case["wheel_separation_multiplier"],
        case["wheel_radius"] * case["left_wheel_radius_multiplier"],
        case["wheel_radius"] * case["right_wheel_radius_multiplier"],
    )
    assert same(left, case["expect_left"], 1e-12)
    assert same(right, case["expect_right"], 1e-12)


class Scenario:
    """Plays one case: the wheels' old angles and the time start where upstream's uninitialised odometry has them."""

    def __init__(self, params: dict[str, Any]) -> None:
        self.hardware, self.control, self.base = robot(**params)
        self.now = 0
        self.period = 0.01
        self.followed = (0.0, 0.0, 0)
        self.published = 0

    def activate(self) -> None:
        self.control.switch(["base"], now=self.now)
        for interface in self.hardware.command_interfaces:
            interface.value = interface.value if self.now == 0 else 0.0
        self.base.odometry.begin(*self.followed)

    def deactivate(self, now: int) -> None:
        self.now = now
        self.control.switch(deactivate=["base"], now=now)

    def cmd(self, now: int, stamp: int, linear: float, angular: float) -> str:
        if self.base.state is not ControllerState.ACTIVE:
            expected = "ignored_inactive"
        else:
            expected = "refused" if not math.isfinite(linear + angular) else "ignored_old"
        try:
            self.control.command("base", [linear, angular], now, stamp)
        except ControlError:
            return expected
        return "accepted"

    def update(self, time: int, period: float, left: float | None, right: float | None, repeat: int = 1, step=None):
        step = 0 if step is None else step
        result, before = ReturnType.OK, 0
        for index in range(repeat):
            self.now = time + index * step
            if left is not None and right is not None:
                self.hardware.set("l/position", left)
                self.hardware.set("r/position", right)
            before = self.base.publications
            result = self.base.update(self.now, period)
            if self.base.publications and left is not None and right is not None:
                self.followed = (left, right, self.now)
        return result, self.base.publications > before


CASES = {case["name"]: case for case in vectors("diff_drive_scenarios_jazzy")}
DEVIATES = "NaN/inf command keeps the previous reference"


@pytest.mark.parametrize("name", [name for name in CASES if name != DEVIATES])
def test_it_behaves_as_upstream_does(name):
    case = CASES[name]
    play = Scenario(case["params"])
    for (verb, *values), expect in zip(case["steps"], case["expect"], strict=True):
        result = getattr(play, verb)(*values)
        if expect is None:
            continue
        if "result" in expect:
            assert result == expect["result"]
        if "ret" in expect:
            assert result[0].name == expect["ret"]
            assert result[1] is expect["published"]
        for wheel, value in zip(("left", "right"), play.hardware.values(), strict=True):
            if wheel in expect:
                assert math.isnan(value) if expect[wheel] is None else same(value, expect[wheel]), wheel
        if "cmd_vel_out" in expect:
            assert all(same(a, b) for a, b in zip(play.base.limited, expect["cmd_vel_out"], strict=True))
        if "odom" in expect:
            odometry = play.base.odometry
            pose = (odometry.x, odometry.y, odometry.heading, odometry.linear, odometry.angular)
            assert all(same(a, b) for a, b in zip(pose, expect["odom"], strict=True)), pose


def test_a_twist_that_is_not_finite_is_refused_and_does_not_refresh_the_timeout():
    case = CASES[DEVIATES]  # upstream keeps driving and restarts the timeout with the stamp of the bad command
    play = Scenario(case["params"])
    play.activate()
    play.cmd(*case["steps"][1][1:])
    play.update(*case["steps"][2][1:])
    assert play.cmd(*case["steps"][3][1:]) == "refused"
    play.update(1000 * S + 500_000_000, 0.01, 0.0, 0.0)
    assert play.hardware.values() == [1.0, 1.0]
    play.update(1000 * S + 501_000_000, 0.01, 0.0, 0.0)
    assert play.hardware.values() == [0.0, 0.0]
    assert play.base.rejected == 1


def test_the_pose_does_not_jump_by_the_angles_the_wheels_have_at_start():
    hardware, control, base = robot()
    hardware.set("l/position", 40.0)
    hardware.set("r/position", -70.0)
    control.switch(["base"], now=1_700_000_000 * S)
    for step in range(1, 100):
        control.update(1_700_000_000 * S + step * S // 100, 0.01)
    assert base.publications > 0
    odometry = base.odometry
    assert (odometry.x, odometry.y, odometry.heading, odometry.linear) == (0.0, 0.0, 0.0, 0.0)


def test_open_loop_does_not_integrate_the_age_of_the_universe():
    _, control, base = robot(open_loop=True, cmd_vel_timeout=0.0)
    control.switch(["base"], now=1_700_000_000 * S)
    control.command("base", [0.5, 0.0], 1_700_000_000 * S)
    for step in range(1, 102):
        control.update(1_700_000_000 * S + step * S // 100, 0.01)
    assert same(base.odometry.x, 0.5)


def test_a_timeout_is_reported_once_and_the_next_twist_drives_on():
    hardware, control, _ = robot()
    control.switch(["base"], now=0)
    control.events()
    control.command("base", [0.35, 0.0], 0)
    for step in range(1, 100):
        control.update(step * S // 100, 0.01)
    reported = [event for event in control.events() if event.kind == "command_timeout"]
    assert len(reported) == 1
    assert "no twist for 0.51 s" in reported[0].text
    control.command("base", [0.35, 0.0], S)
    control.update(S, 0.01)
    assert hardware.values() == [pytest.approx(10.0), pytest.approx(10.0)]


def test_a_stamp_from_the_future_does_not_put_the_timeout_off():
    hardware, control, _ = robot()
    control.switch(["base"], now=0)
    control.command("base", [0.35, 0.0], 0, 3600 * S)
    control.update(S // 100, 0.01)
    assert hardware.values() == [pytest.approx(10.0), pytest.approx(10.0)]
    control.update(S, 0.01)
    assert hardware.values() == [0.0, 0.0]


@pytest.mark.parametrize("values", [[1.0], [1.0, 2.0, 3.0], [math.nan, 0.0], [0.0, -math.inf], [True, 0.0], []])
def test_a_bad_twist_is_refused_and_counted(values):
    _, control, base = robot()
    control.switch(["base"], now=0)
    with pytest.raises(ControlError, match="expects"):
        control.command("base", values, 0)
    assert base.rejected == 1


def test_every_wheel_of_a_side_turns_and_their_mean_is_followed():
    names = [f"{side}{index}" for side in "lr" for index in range(2)]
    hardware = Hardware(*(f"{name}/velocity" for name in names), states=tuple(f"{name}/velocity" for name in names))
    control = manager(hardware)
    params = {**WHEELS, "left_wheel_names": names[:2], "right_wheel_names": names[2:], "position_feedback": False}
    base = add(control, "base", DIFF_DRIVE, **params)
    control.switch(["base"], now=0)
    control.command("base", [0.35, 0.0], 0)
    for state, value in zip(hardware.state_interfaces, (9.0, 11.0, 8.0, 12.0), strict=True):
        state.value = value
    control.update(0, 0.01)
    control.update(S // 10, 0.1)
    assert hardware.values() == [pytest.approx(10.0)] * 4
    assert same(base.odometry.x, 0.035)


def test_another_controller_drives_it_by_its_references():
    hardware, control, base = robot(linear__x__max_velocity=0.5)
    add(control, "linear", FORWARD, joints=["base/linear"], interface_name="velocity")
    add(control, "angular", FORWARD, joints=["base/angular"], interface_name="velocity")
    with pytest.raises(ControlError, match="activate linear and base together"):
        control.switch(["linear"])
    control.switch(["linear", "angular", "base"], now=0)
    assert control.active.index("base") == 2
    with pytest.raises(ControlError, match="is commanded by linear"):
        control.command("base", [1.0, 0.0], 0)
    control.command("linear", [0.35], 0)
    control.command("angular", [0.0], 0)
    control.update(S // 100, 0.01)
    assert hardware.values() == [pytest.approx(10.0)] * 2
    with pytest.raises(ControlError, match="deactivate linear and base together"):
        control.switch(deactivate=["base"])
    control.switch(deactivate=["linear", "angular"])
    control.update(S // 50, 0.01)  # within the timeout of 0.5 s: the commanding client has left, so it stops at once
    assert hardware.values() == [0.0, 0.0]
    control.command("base", [0.35, 0.0], S // 50)
    control.update(S // 25, 0.01)
    assert hardware.values() == [pytest.approx(10.0)] * 2
    assert base.chained is False
    control.switch(["linear", "angular"])  # and the new client has not sent a command yet
    control.update(S // 20, 0.01)
    assert hardware.values() == [0.0, 0.0]


@pytest.mark.parametrize("case", vectors("diff_drive_lifecycle")[7:10], ids=lambda case: case["name"])
def test_it_needs_the_interfaces_that_upstream_needs(case):
    _, _, base = robot(**case["params"])
    assert base.command_interface_names() == case["expect_command"]
    assert base.state_interface_names() == case["expect_state"]


def test_its_references_have_upstreams_names():
    case = vectors("diff_drive_lifecycle")[10]
    control = manager(Hardware("l/velocity", "r/velocity"))
    base = add(control, case["controller"], DIFF_DRIVE, **WHEELS)
    assert [interface.name for interface in base.reference_interfaces()] == case["expect_reference"]


@pytest.mark.parametrize(
    "limits",
    [
        {"max_acceleration": 0.5, "max_deceleration": 0.0},
        {"max_acceleration": 0.5, "max_deceleration_reverse": 0.0},
        {"max_acceleration": 0.0},
    ],
)
def test_a_deceleration_limit_of_zero_is_refused_since_the_base_would_never_brake(limits):
    with pytest.raises(RobotConfigError, match=r"base: linear\.x: a deceleration limit is 0, so the base would never"):
        robot(**{f"linear__x__{key}": value for key, value in limits.items()})


def test_a_jerk_limit_of_zero_is_reported_to_freeze_the_robot():
    _, control, _ = robot(linear__x__max_jerk=0.0)
    assert [event.text for event in control.events() if event.kind == "parameter"] == [
        "base: linear.x.max_jerk is 0, which keeps the speed constant; remove it"
    ]


@pytest.mark.parametrize(
    ("limits", "texts"),
    [
        ({"max_velocity": 1.0, "max_acceleration": 0.5}, []),
        ({"max_velocity": 1.0, "max_acceleration": 0.5, "max_deceleration": -0.01}, [("100", "")]),
        ({"max_velocity": 1.0, "max_acceleration": 0.5, "max_deceleration_reverse": 0.02}, [("50", "_reverse")]),
        ({"max_acceleration": 0.05}, [("20", "")]),
    ],
)
def test_a_deceleration_limit_with_which_a_stop_takes_long_is_reported(limits, texts):
    _, control, _ = robot(**{f"linear__x__{key}": value for key, value in limits.items()})
    assert [event.text for event in control.events() if event.kind == SLOW_STOP] == [
        f"base: linear.x needs {seconds} s to stop from its velocity limit; raise the magnitude of "
        f"linear.x.max_deceleration{reverse}"
        for seconds, reverse in texts
    ]


def test_frames_carry_the_prefix_and_the_pose_can_be_set():
    _, control, base = robot(odom_frame_id="odom", base_frame_id="base_link", tf_frame_prefix="r1")
    assert base.frame_ids("/ns") == ("r1/odom", "r1/base_link")
    with pytest.raises(ControlError, match="base is inactive"):
        base.set_odometry(1.0, 2.0, 3.0)
    control.switch(["base"], now=0)
    base.set_odometry(1.0, 2.0, 3.0)
    assert (base.odometry.x, base.odometry.y, base.odometry.heading) == (1.0, 2.0, 3.0)
    with pytest.raises(ControlError, match="three finite numbers"):
        base.set_odometry(1.0, math.nan, 3.0)
    assert base.sample(0) is None
    control.command("base", [0.0, 0.0], 0)
    control.update(S // 100, 0.01)
    sample = base.sample(5 * S)
    assert (sample.frame_id, sample.child_frame_id, sample.x) == ("r1/odom", "r1/base_link", 1.0)
    assert (sample.time, sample.limited) == (5.01, None)


def test_it_reports_what_it_assumes_of_its_wheels_before_the_calibration():
    jerk = {"linear__x__max_jerk": 0.0}
    _, _, base = robot(wheel_separation_multiplier=2.0, left_wheel_radius_multiplier=3.0, tf_frame_prefix="r1", **jerk)
    inputs = base.params
    assert base.wheel_base() == DriveGeometry(
        inputs.left,
        inputs.right,
        inputs.wheel_separation,
        inputs.wheel_radius,
        "r1/odom",
        "r1/base_link",
        True,
        ("linear.x",),
    )


def publications(rate, seconds=2.0):
    """Return the samples that two observers see in a cycle of 10 ms, the other one only in every third cycle."""
    _, control, base = robot(publish_rate=rate, cmd_vel_timeout=0.0, publish_limited_velocity=True)
    control.switch(["base"], now=0)
    control.command("base", [0.5, 0.0], 0)
    observed, other = [], []
    for step in range(1, round(seconds * 100) + 1):
        control.update(step * S // 100, 0.01)
        observed.append(control.running.samples(7 * S)["base"])
        if step % 3 == 0:
            other.append(base.sample(7 * S))
    return observed, other


def test_the_list_reports_how_often_it_publishes():
    _, control, base = robot(publish_rate=20.0)
    assert (control.list()[0].tells, control.list()[0].publish_rate) == ("odometry", 20.0)
    base.publish_rate = 1000.0
    assert control.list()[0].publish_rate == 100.0
    base.update_rate = 40
    assert control.list()[0].publish_rate == 40.0


@pytest.mark.parametrize(("rate", "every"), [(100.0, 1), (50.0, 2), (20.0, 5), (1000.0, 1), (0.6, 167)])
def test_its_sample_is_that_of_the_last_publication_at_publish_rate(rate, every):
    observed, other = publications(rate)
    stamps = list(dict.fromkeys(item.time for item in observed))
    steps = [round((later - earlier) * 100) for earlier, later in pairwise(stamps)]
    assert set(steps) <= {every, every + 1}
    assert len(stamps) == pytest.approx(2.0 * min(rate, 100.0), abs=1)
    assert (stamps[0], observed[0].limited) == (7.01, (0.5, 0.0))
    by_stamp = {item.time: item for item in observed}
    assert all(item == by_stamp[item.time] for item in (*observed, *other)), "a stamp has one content"


def test_limits_and_timeout_that_are_set_act_in_the_next_update():
    hardware, control, base = robot(cmd_vel_timeout=0.5)
    control.switch(["base"], now=S)
    control.command("base", [1.0, 0.0], S)
    control.update(2 * S, 1.0)
    assert hardware.values() == [pytest.approx(0.0)] * 2, "it is over"
    control.set_parameters("base", [_double("cmd_vel_timeout", 3.0), _double("linear.x.max_velocity", 0.07)])
    control.command("base", [1.0, 0.0], 2 * S)
    control.update(4 * S, 2.0)
    assert hardware.values() == [pytest.approx(2.0)] * 2, "0.07 m/s, and 2 s are not too old"
    with pytest.raises(RobotConfigError, match=r"linear\.x\.min_velocity: 1\.0 is out of range"):
        control.set_parameters("base", [_double("cmd_vel_timeout", 9.0), _double("linear.x.min_velocity", 1.0)])
    assert (base.params.cmd_vel_timeout, base.command_timeout.limit_ns) == (3.0, 3 * S)
    assert [event.text for event in control.events() if "cmd_vel_timeout" in event.text] == [
        "base: cmd_vel_timeout is 3.0, linear.x.max_velocity is 0.07"
    ]


def test_multipliers_of_the_wheels_are_set_at_rest_and_the_pose_stays():
    hardware, control, base = robot(left_wheel_radius_multiplier=1.1)
    control.switch(["base"], now=0)
    left, right = hardware.state_interfaces[:2]
    left.value = right.value = 10.0
    control.command("base", [0.0, 0.0], S // 100)
    control.update(S // 50, 0.02)
    left.value, right.value = 10.0, 11.0
    control.update(2 * S // 50, 0.02)
    before = (base.odometry.x, base.odometry.y, base.odometry.heading)
    wheels = {"wheel_separation_multiplier": 2.0, "left_wheel_radius_multiplier": 0.9}
    control.set_parameters("base", [_double(name, value) for name, value in wheels.items()])
    control.update(3 * S // 50, 0.02)
    assert (base.odometry.x, base.odometry.y, base.odometry.heading) == pytest.approx(before)
    left.value = 11.0
    control.update(4 * S // 50, 0.02)
    assert base.odometry.heading - before[2] == pytest.approx(-0.035 * 0.9 / 0.48)
    control.command("base", [0.0, 0.5], 4 * S // 50)
    control.update(5 * S // 50, 0.02)
    assert [interface.value for interface in hardware.command_interfaces] == pytest.approx(
        [-0.12 / 0.0315, 0.12 / 0.035]
    )
    with pytest.raises(RobotConfigError, match="base is moving; set the wheel multipliers at standstill"):
        control.set_parameters("base", [_double("wheel_separation_multiplier", 1.0)])
    control.set_parameters("base", [_double("cmd_vel_timeout", 1.0)])
    with pytest.raises(RobotConfigError, match="wheel_separation_multiplier is 0; give a factor above 0"):
        control.set_parameters("base", [_double("wheel_separation_multiplier", 0.0)])


def _double(name, value):
    return ParameterValue(name=name, kind="double", value=value)
