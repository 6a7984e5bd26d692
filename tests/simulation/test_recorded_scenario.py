from dataclasses import replace

import pytest
from support.simulated import BASE, FORWARD, MS, S, setup_of

from canopen_control.errors import ConfigError
from canopen_control.frame import CanFrame
from canopen_control.rpc.messages import robot as messages
from canopen_control.rpc.messages.robot import ROBOT, RequestSeen
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.rpc.messages.state import RobotEvent
from canopen_control.rpc.messages.trajectory import SetTrajectory, TrajectoryData
from canopen_control.rpc.wire import Raw, text_of
from canopen_control.simulation.recorded_scenario import BusHistory, RecordedRobot, scenario_of_recording

BEGIN_OF_RECORDED_FAULTS = 1_700_000_000 * S
END = 8 * S
SYNC, NMT = CanFrame(0x80), 0x000


def steady(can_id, data, period, until=END, without=()):
    """Frames of a period in ms, but in the times of `without` in s."""
    times = range(0, until, period * MS)
    quiet = [(round(low * S), round(high * S)) for low, high in without]
    return [
        (BEGIN_OF_RECORDED_FAULTS + at, CanFrame(can_id, data))
        for at in times
        if not any(low <= at < high for low, high in quiet)
    ]


def healthy(*, node=None, master=(), without=()):
    """A bus of the master and nodes 2 and 3; node 2 has gaps."""
    frames = steady(0x80, b"", 20, without=master)
    for value in (2, 3):
        quiet = without if value == 2 else ()
        frames += steady(0x180 + value, b"\x37\x06", 20, without=quiet)
        frames += steady(0x700 + value, b"\x05", 100, without=node if value == 2 and node else quiet)
    return frames


def acts_of_of_recorded_faults(frames, *more, resets=()):
    there = sorted(
        [*frames, *((BEGIN_OF_RECORDED_FAULTS + round(at * S), frame) for at, frame in more)], key=lambda each: each[0]
    )
    return list(BusHistory(setup_of().bus, there, [BEGIN_OF_RECORDED_FAULTS + round(at * S) for at in resets]).acts())


def shown(acts):
    return [
        (
            act.kind,
            act.target,
            act.name,
            round((act.at_ns - BEGIN_OF_RECORDED_FAULTS) / S, 1),
            act.for_ns and round(act.for_ns / S, 1),
        )
        for act in acts
    ]


def test_where_nothing_goes_wrong_nothing_happens():
    assert acts_of_of_recorded_faults(healthy()) == []


@pytest.mark.parametrize(
    ("missing", "more", "act"),
    [
        ({"without": [(2, 4)]}, [], ("cut", "2", "", 2.0, 2.0)),
        ({"without": [(5, 9)]}, [], ("cut", "2", "", 5.0, None)),
        ({"without": [(2, 4.01)]}, [(4.0, CanFrame(0x702, b"\0"))], ("power", "2", "", 2.0, 2.0)),
        ({"node": [(2, 4)]}, [], ("fault", "2", "heartbeat_lost", 1.9, 2.1)),
    ],
    ids=["silent: cut", "to the end: cut for good", "boots after it: without supply", "heartbeats alone"],
)
def test_what_is_missing_names_its_cause(missing, more, act):
    assert shown(acts_of_of_recorded_faults(healthy(**missing), *more)) == [act]


def test_a_boot_in_between_is_a_reset_of_its_own_unless_the_master_requested_it():
    boot = (3.0, CanFrame(0x702, b"\0"))
    assert shown(acts_of_of_recorded_faults(healthy(), boot)) == [("fault", "2", "spontaneous_reset", 3.0, None)]
    assert acts_of_of_recorded_faults(healthy(), (2.9, CanFrame(NMT, b"\x82\x02")), boot) == []


@pytest.mark.parametrize(
    ("code", "fault", "lasts"),
    [(0x2320, "short_circuit", 1.9), (0x8611, "following_error", 1.9), (0x7500, "drive_fault", 1.9),
     (0x5000, "device_error", 2.0)],
)  # fmt: skip
def test_an_emergency_is_a_fault_that_shows_it_and_ends_before_its_reset(code, fault, lasts):
    reported = [(at, CanFrame(0x82, value.to_bytes(2, "little") + bytes(6))) for at, value in ((3.0, code), (5.0, 0))]
    [act] = acts_of_of_recorded_faults(healthy(), *reported, resets=[2.0, 4.99])
    assert (act.kind, act.target, act.name) == ("fault", "2", fault)
    assert act.at_ns - BEGIN_OF_RECORDED_FAULTS == 3 * S
    assert act.for_ns == pytest.approx(lasts * S, abs=0.1 * S)


def test_an_emergency_about_the_bus_is_a_consequence():
    assert acts_of_of_recorded_faults(healthy(), (3.0, CanFrame(0x82, b"\x30\x81" + bytes(6)))) == []


def test_a_master_that_is_silent_is_stalled_and_killed_where_it_boots_nodes_again():
    assert shown(acts_of_of_recorded_faults(healthy(master=[(2, 4)]))) == [("stall", "master", "", 2.0, 2.0)]
    assert shown(acts_of_of_recorded_faults(healthy(master=[(2, 4)]), (4.1, CanFrame(NMT, b"\x81\x00")))) == [
        ("kill", "", "", 2.0, 2.0)
    ]


def test_a_master_without_sync_is_silent_without_its_heartbeat_of_the_default_period():
    bus = setup_of().bus
    quiet = replace(bus, master=replace(bus.master, sync_period=0, heartbeat_producer=0))
    [act] = BusHistory(quiet, sorted(healthy(master=[(2, 4)]), key=lambda each: each[0]), []).acts()
    assert (act.kind, act.target) == ("stall", "master")


def test_commands_that_no_boot_gives_are_a_strangers():
    [act] = acts_of_of_recorded_faults(healthy(), (3.0, CanFrame(NMT, b"\x80\x03")))
    assert (act.kind, act.values) == ("frame", (0.0, 128.0, 3.0))


def test_a_recording_of_nothing_has_nothing():
    assert acts_of_of_recorded_faults([]) == []


BEGIN = 1_700_000_000
FRAMES = [(BEGIN * S + at * 20 * MS, "can", CanFrame(0x80)) for at in range(400)]
STARTED = RobotEvent(time=BEGIN + 0.02, kind="note", node=None, level="info", text="starts")


def asked(at, request):
    return RequestSeen(BEGIN + at, ROBOT.of(type(request)).name, Raw(text_of(request)))


def acts_of(*requests, robot="robby", events=(STARTED,), **more):
    result = scenario_of_recording(RecordedRobot(FRAMES, events, requests, **more), setup_of(robot))
    return [(act.at_ns / S, act.kind, act.target, act.name, act.values, act.for_ns) for act in result.acts]


def command(at, *values):
    return asked(at, messages.CommandController(controller=FORWARD, values=list(values)))


def test_equal_commands_that_follow_each_other_are_one_that_lasts():
    text = [command(1 + 0.1 * number, 5, 4) for number in range(5)] + [command(1.5, 1, 1), command(3, 1, 1)]
    assert acts_of(*text) == [
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


@pytest.mark.parametrize(
    "other", [messages.PublishEvent(kind="x", text="y"), messages.AxisRequest(action="home", node="all")]
)
def test_what_a_scenario_cannot_do_is_left_out(other):
    assert acts_of(asked(2, other)) == []
    assert (
        acts_of(
            RequestSeen(BEGIN + 2, "of_another_version", Raw(b"{}")), RequestSeen(BEGIN + 2, "stop", Raw(b'{"x": 1}'))
        )
        == []
    )


def test_the_points_of_a_trajectory_come_in_the_controllers_order():
    setup = setup_of("arm6")
    name = "arm_controller" if "arm_controller" in setup.controllers.controllers else next(
        each for each, config in setup.controllers.controllers.items() if "trajectory" in config.type
    )  # fmt: skip
    joints = [f"joint_{number}" for number in range(1, 7)]
    points = [TrajectoryPoint(positions=[0.1 * n for n in range(6)], time_from_start=1.0 + at) for at in (0, 1)]
    text = TrajectoryData(points=points[:1]), SetTrajectory(
        controller=name, joints=joints[::-1], points=points[1:]
    )  # fmt: skip
    recorded = RecordedRobot(
        [(at, "can", frame) for at, _, frame in FRAMES], [STARTED], [asked(2, item) for item in text]
    )
    [act] = scenario_of_recording(recorded, setup).acts
    assert (act.kind, act.target, act.times) == ("trajectory", name, (1.0, 2.0))
    assert len(act.values) == 12
    assert act.values[:6] in ((0.0, 0.1, 0.2, 0.30000000000000004, 0.4, 0.5), tuple(0.1 * n for n in range(5, -1, -1)))


def test_a_recording_that_begins_later_than_its_robot_continues_after_a_boot():
    long_ago = RobotEvent(time=BEGIN - 600, kind="note", node=None, level="info", text="starts")
    result = acts_of(command(2, 1, 1), events=[long_ago], active=[BASE, "joint_state_broadcaster", "nobody"])
    assert [(at, kind, target) for at, kind, target, *_ in result] == [
        (0.7, "activate", BASE), (3.0, "command", FORWARD),
    ]  # fmt: skip


def test_it_ends_with_its_robot():
    ended = RobotEvent(time=BEGIN + 5, kind="stopping", node=None, level="info", text="stopping")
    result = scenario_of_recording(RecordedRobot(FRAMES, [STARTED, ended], [command(6, 1, 1)]), setup_of())
    assert (result.acts, result.duration_ns) == ((), 5 * S)


def test_what_is_not_a_recording_of_the_robot_is_reported():
    other = [(BEGIN, "front", CanFrame(0x80))]
    with pytest.raises(ConfigError, match="the recording has frames of front, but the robot has the buses can"):
        scenario_of_recording(RecordedRobot(other), setup_of())
    with pytest.raises(ConfigError, match="the recording has frames of no bus"):
        scenario_of_recording(RecordedRobot([]), setup_of())
