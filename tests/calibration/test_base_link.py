import math

import pytest
from support.floor import BASE, QUICK, BenchClient, FloorBench
from support.robots import FORWARD

from canopen_control.calibration import base_link
from canopen_control.calibration.base_link import FACTORS, BaseLink, choose_base
from canopen_control.calibration.umbmark import Direction, SquarePath
from canopen_control.errors import ConfigError, ControlError, RemoteError
from canopen_control.rpc.messages.parameters import ParameterReading
from canopen_control.rpc.messages.state import WHEEL_CALIBRATION, ControllerReading


def path(direction=Direction.CCW):
    return SquarePath(0.4, direction, QUICK)


@pytest.mark.rest
def test_it_drives_a_square_and_reports_where_it_ended_by_odometry_and_in_truth(floor):
    bench, client, link = floor("link", track=1.02)
    driven = link.drive(path())
    assert driven.odometry == pytest.approx((0.0, 0.0, math.tau), abs=0.05)
    assert driven.truth[2] == pytest.approx(driven.odometry[2] / 1.02, rel=1e-4)
    assert client.twists[-1] == (0.0, 0.0)
    assert client.rate is None, "nobody reads samples now"
    assert link.true_pose().x == bench.robot.truth.reading.x


@pytest.mark.rest
def test_both_directions_of_an_ideal_robot_mirror_on_the_whole_stack(tmp_path):
    results = []
    for direction in Direction:
        bench = FloorBench(tmp_path, f"mirror{direction.value + 1}")
        bench.start()
        bench.hurry()
        results.append(BaseLink(BenchClient(bench)).drive(path(direction)))
        bench.close()
    ccw, cw = results
    assert (ccw.truth[0], ccw.truth[1]) == pytest.approx((cw.truth[0], -cw.truth[1]), abs=1e-4)  # whole counts


def test_the_wheels_are_reported_with_the_limits_and_can_be_set(floor):
    _, _, link = floor("values")
    values = link.wheel_values()
    assert (values.separation, values.factors) == (0.24, (1.0, 1.0, 1.0))
    assert (values.max_linear, values.angular_ramp) == (1.0, 12.0)
    link.set_factors((1.1, 0.9, 1.2))
    assert link.wheel_values().separation == pytest.approx(0.264)
    assert link.wheel_values().factors == (1.1, 0.9, 1.2)


def test_one_multiplier_for_both_sides_is_refused(floor):
    _, client, link = floor("both")
    both = ParameterReading(name="wheel_radius_multiplier", kind="double", value=1.1)
    client.ask = lambda _request: (both,)
    with pytest.raises(ConfigError, match="which overrides those of both sides"):
        link.wheel_values()


@pytest.mark.parametrize(
    ("do", "words"),
    [
        (lambda bench: bench.robot.latch.hold("the page", 0), "STOP, by the page"),
        (lambda bench: bench.robot.stop(lambda _error: None), "disabled|enable"),
        (lambda bench: bench.power_off(3), "the robot is in fault: a drive is silent"),
        (lambda bench: bench.robot.shutdown("its time is over"), "stopping|takes no|inactive"),
    ],
    ids=["latched stop", "stop", "drive lost", "shutdown"],
)
def test_whatever_stops_the_robot_ends_the_drive_with_a_sentence_and_the_base_stands(floor, do, words):
    bench, client, link = floor("stopped")
    client.on_state = lambda count: do(bench) if count == 60 else None
    with pytest.raises((ControlError, RemoteError), match=words):
        link.drive(path())
    bench.run(1500)
    assert [bench.speed(node_id) for node_id in bench.drives] == pytest.approx([0] * len(bench.drives), abs=1)


def test_a_program_that_was_suspended_does_not_drive_on(floor, monkeypatch):
    _, client, link = floor("suspended")
    now = [0.0]
    monkeypatch.setattr(base_link.time, "monotonic", lambda: now[0])

    def suspend(count):
        now[0] += 5.0 if count == 60 else 0.01

    client.on_state = suspend
    with pytest.raises(ControlError, match=r"no command was sent for 5\.0 s; this program was suspended"):
        link.drive(path())
    assert client.twists[-1] == (0.0, 0.0)


def test_a_robot_that_reports_nothing_ends_it(floor):
    _, client, link = floor("mute")
    client.messages = lambda _timeout=None: iter(())
    with pytest.raises(ControlError, match="has sent nothing for 1 s"):
        link.drive(path())


def test_a_client_that_is_gone_stops_the_base(floor):
    bench, client, link = floor("killed")

    def die(count):
        if count == 60:
            raise SystemExit

    client.on_state = die
    with pytest.raises(SystemExit):
        link.drive(path())
    assert client.twists[-1] == (0.0, 0.0)
    client.answer(client_twist(0.2))
    bench.run(200)
    assert abs(bench.speed(2)) > 100
    bench.robot.client_disconnected(client)
    bench.run(600)
    assert bench.speed(2) == pytest.approx(0, abs=1)


def client_twist(linear):
    from canopen_control.rpc.messages.robot import TwistController

    return TwistController(controller=BASE, linear=linear, angular=0.0, source="calibrate", dead_man=True)


def reading(name, state="active", offers=(WHEEL_CALIBRATION,)):
    return ControllerReading(name=name, type="x/Y", state=state, offers=offers)


def test_the_base_is_the_one_that_is_requested_or_the_only_one():
    others = (reading("arm", offers=()), reading("old", "inactive"))
    assert choose_base((*others, reading("base")), None).name == "base"
    assert choose_base((reading("base"), reading("other")), "other").name == "other"


@pytest.mark.parametrize(
    ("controllers", "expected", "words"),
    [
        ((reading("arm", offers=()),), None, "the robot has no diff drive controller, .* it has: arm"),
        ((reading("base"),), "arm", "'arm' is not a diff drive controller of the robot; it has: base"),
        (
            (reading("base"), reading("other")),
            None,
            "several diff drive controllers are possible: base, other; give --controller",
        ),
        ((reading("base", "inactive"),), None, "base is inactive; activate it: .* --activate base, with --deactivate"),
    ],
)
def test_where_there_is_none_or_a_choice_it_suggests_what_to_do(controllers, expected, words):
    with pytest.raises(ConfigError, match=words):
        choose_base(controllers, expected)


def test_names_are_those_of_the_parameters():
    assert [factor.removesuffix("_multiplier") for factor in FACTORS] == [
        "wheel_separation", "left_wheel_radius", "right_wheel_radius"
    ]  # fmt: skip
    assert FORWARD != BASE
