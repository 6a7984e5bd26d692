import pytest
from support.simulated import BASE, FORWARD, MS, S, setup_of

from canopen_control.errors import ConfigError
from canopen_control.frame import CanFrame
from canopen_control.rpc.messages import robot as messages
from canopen_control.rpc.messages.robot import ROBOT, Asked
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.rpc.messages.state import RobotEvent
from canopen_control.rpc.messages.trajectory import SetTrajectory, TrajectoryData
from canopen_control.rpc.wire import Raw, text_of
from canopen_control.simulation.recorded_scenario import RecordedRobot, scenario_of_recording

BEGIN = 1_700_000_000
FRAMES = [(BEGIN * S + at * 20 * MS, "can", CanFrame(0x80)) for at in range(400)]
STARTED = RobotEvent(time=BEGIN + 0.02, kind="note", node=None, level="info", text="starts")


def asked(at, request):
    return Asked(BEGIN + at, ROBOT.of(type(request)).name, Raw(text_of(request)))


def acts_of(*requests, robot="robby", events=(STARTED,), **more):
    found = scenario_of_recording(RecordedRobot(FRAMES, events, requests, **more), setup_of(robot))
    return [(act.at_ns / S, act.kind, act.target, act.name, act.values, act.for_ns) for act in found.acts]


def command(at, *values):
    return asked(at, messages.CommandController(controller=FORWARD, values=list(values)))


def test_equal_commands_that_follow_each_other_are_one_that_lasts():
    said = [command(1 + 0.1 * number, 5, 4) for number in range(5)] + [command(1.5, 1, 1), command(3, 1, 1)]
    assert acts_of(*said) == [
        (1.0, "command", FORWARD, "", (5.0, 4.0), 450 * MS),
        (1.5, "command", FORWARD, "", (1.0, 1.0), None),
        (3.0, "command", FORWARD, "", (1.0, 1.0), None),
    ]


@pytest.mark.parametrize(
    ("request_", "what"),
    [
        (messages.TwistController(controller=BASE, linear=0.3, angular=0.2), ("command", BASE, "", (0.3, 0.2))),
        (messages.Stop(), ("stop", "", "", ())),
        (messages.Stop(latch=True), ("latch", "", "", ())),
        (messages.Release(), ("release", "", "", ())),
        (messages.AxisRequest(action="enable", node="all"), ("axis", "", "enable", ())),
        (messages.AxisRequest(action="fault-reset", node=3), ("axis", "3", "fault-reset", ())),
        (messages.SwitchControllers(activate=(BASE,), deactivate=(FORWARD,)), ("activate", BASE, "", ())),
        (messages.SwitchControllers(deactivate=(FORWARD,)), ("deactivate", FORWARD, "", ())),
    ],
)
def test_what_a_client_asks_for_is_asked_for_again(request_, what):
    assert acts_of(asked(2, request_)) == [(2.0, *what, None)]


@pytest.mark.parametrize("other", [messages.Tell(kind="x", text="y"), messages.AxisRequest(action="home", node="all")])
def test_what_a_scenario_cannot_do_is_left_out(other):
    assert acts_of(asked(2, other)) == []
    assert acts_of(Asked(BEGIN + 2, "of_another_version", Raw(b"{}")), Asked(BEGIN + 2, "stop", Raw(b'{"x": 1}'))) == []


def test_the_points_of_a_trajectory_come_in_the_controllers_order():
    setup = setup_of("arm6")
    name = "arm_controller" if "arm_controller" in setup.controllers.controllers else next(
        each for each, config in setup.controllers.controllers.items() if "trajectory" in config.type
    )  # fmt: skip
    joints = [f"joint_{number}" for number in range(1, 7)]
    points = [TrajectoryPoint(positions=[0.1 * n for n in range(6)], time_from_start=1.0 + at) for at in (0, 1)]
    said = TrajectoryData(points=points[:1]), SetTrajectory(
        controller=name, joints=joints[::-1], points=points[1:]
    )  # fmt: skip
    recorded = RecordedRobot(
        [(at, "can", frame) for at, _, frame in FRAMES], [STARTED], [asked(2, each) for each in said]
    )
    [act] = scenario_of_recording(recorded, setup).acts
    assert (act.kind, act.target, act.times) == ("trajectory", name, (1.0, 2.0))
    assert len(act.values) == 12
    assert act.values[:6] in ((0.0, 0.1, 0.2, 0.30000000000000004, 0.4, 0.5), tuple(0.1 * n for n in range(5, -1, -1)))


def test_a_recording_that_begins_later_than_its_robot_goes_on_after_a_boot():
    long_ago = RobotEvent(time=BEGIN - 600, kind="note", node=None, level="info", text="starts")
    found = acts_of(command(2, 1, 1), events=[long_ago], active=[BASE, "joint_state_broadcaster", "nobody"])
    assert [(at, kind, target) for at, kind, target, *_ in found] == [
        (0.7, "activate", BASE), (3.0, "command", FORWARD),
    ]  # fmt: skip


def test_it_ends_with_its_robot():
    ended = RobotEvent(time=BEGIN + 5, kind="stopping", node=None, level="info", text="stopping")
    found = scenario_of_recording(RecordedRobot(FRAMES, [STARTED, ended], [command(6, 1, 1)]), setup_of())
    assert (found.acts, found.duration_ns) == ((), 5 * S)


def test_what_is_no_recording_of_the_robot_is_told():
    other = [(BEGIN, "front", CanFrame(0x80))]
    with pytest.raises(ConfigError, match="the recording holds front, the robot has the buses can"):
        scenario_of_recording(RecordedRobot(other), setup_of())
    with pytest.raises(ConfigError, match="the recording holds no frame"):
        scenario_of_recording(RecordedRobot([]), setup_of())
