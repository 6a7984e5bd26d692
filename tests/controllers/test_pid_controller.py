import gc
import math
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import Hardware, S, add, manager, put

from canopen_control.controllers.base import Controller, ControllerState
from canopen_control.errors import ControlError, NotEnabled, RobotConfigError, UnknownInterface
from canopen_control.rpc.messages.parameters import ParameterValue
from canopen_control.urdf.joint_element import Joint, UrdfLimits

MS = 1_000_000
TYPE = "pid_controller/PidController"
JTC = "joint_trajectory_controller/JointTrajectoryController"
JOINTS = ["a", "b"]


class Robot:
    """Two joints that take one quantity and measure position and velocity, under PIDs."""

    def __init__(self, kind="velocity", interfaces=("position",), gains=None, **params):
        states = tuple(f"{joint}/{name}" for name in ("position", "velocity") for joint in JOINTS)
        self.hardware = Hardware(*(f"{joint}/{kind}" for joint in JOINTS), states=states)
        for interface in self.hardware.state_interfaces:
            interface.value = 0.0
        self.manager = manager(self.hardware)
        inputs = {f"gains__{joint}__{key}": value for joint in JOINTS for key, value in (gains or {"p": 2.0}).items()}
        self.pid = add(
            self.manager,
            "pid",
            TYPE,
            dof_names=JOINTS,
            command_interface=kind,
            reference_and_state_interfaces=list(interfaces),
            **inputs,
            **params,
        )
        self.now = S

    def start(self, *names):
        self.manager.switch(names or ["pid"], now=self.now)
        return self

    def cycle(self, count=1, follow=None):
        for _ in range(count):
            self.now += 10 * MS
            self.manager.update(self.now, 0.01)
            if follow is not None:
                follow()
        return self.hardware.values()

    def enable(self, joint, enabled=True):
        next(interface for interface in self.hardware.command_interfaces if interface.joint == joint).enabled = enabled

    def command(self, *values):
        self.manager.command("pid", values, self.now, source="a test")

    def state(self, name):
        return next(interface for interface in self.hardware.state_interfaces if interface.name == name)


def test_the_first_reference_is_where_the_joints_are():
    robot = Robot()
    robot.state("a/position").value = 0.5
    assert robot.start().cycle() == [0.0, 0.0]
    assert [dof.reference for dof in robot.pid.sample(0).dofs] == [0.5, 0.0]


def test_without_a_first_reference_the_targets_are_0_until_there_is_one():
    robot = Robot(set_current_state_as_first_setpoint=False).start()
    robot.state("a/position").value = 0.5
    assert robot.cycle() == [0.0, 0.0]
    assert robot.pid.sample(0).dofs[0].reference is None
    robot.command(1.0, 1.0)
    assert robot.cycle() == [pytest.approx(1.0), pytest.approx(2.0)]


def test_it_claims_reads_and_exports_as_upstream_does():
    robot = Robot("effort", ("position", "velocity"), reference_and_state_dof_names=["x", "y"])
    assert robot.pid.command_interface_names() == ["a/effort", "b/effort"]
    assert robot.pid.state_interface_names() == ["x/position", "y/position", "x/velocity", "y/velocity"]
    names = [interface.name for interface in robot.pid.reference_interfaces()]
    assert names == ["pid/x/position", "pid/y/position", "pid/x/velocity", "pid/y/velocity"]


def test_it_is_listed_with_what_another_controller_may_command_once_it_is_configured():
    robot = Robot("effort", ("position", "velocity"), reference_and_state_dof_names=["x", "y"])
    assert robot.manager.list()[0].reference_interfaces == tuple(
        interface.name for interface in robot.pid.reference_interfaces()
    )
    robot.pid.state = ControllerState.UNCONFIGURED
    assert robot.manager.list()[0].reference_interfaces == ()


def test_without_the_derivative_in_the_message_it_is_that_of_the_errors():
    robot = Robot("effort", ("position", "velocity"), {"d": 3.0}).start()
    robot.cycle()
    robot.command(0.1, 0.0)
    assert robot.cycle()[0] == pytest.approx(3.0 * 0.1 / 0.01)


@pytest.mark.parametrize(("interfaces", "forward"), [(("velocity",), 4.0), (("position", "velocity"), 1.0)])
def test_what_leads_is_the_reference_or_its_derivative(interfaces, forward):
    robot = Robot("effort", interfaces, {"feedforward_gain": 2.0}, enable_feedforward=True).start()
    robot.command(*([2.0, 2.0, 0.5, 0.5][: 2 * len(interfaces)]))
    assert robot.cycle() == [forward, forward]
    robot.pid.set_feed_forward(False)
    assert robot.cycle() == [0.0, 0.0]


def test_an_angle_goes_the_short_way_round():
    robot = Robot(gains={"p": 1.0, "angle_wraparound": True}).start()
    robot.state("a/position").value = 3.0
    robot.command(-3.0, 0.0)
    assert robot.cycle()[0] == pytest.approx(2 * math.pi - 6.0)


def test_a_drive_that_does_not_follow_loses_its_reference_and_is_held_where_it_is_afterwards():
    robot = Robot("effort", gains={"p": 1.0, "i": 1.0}, command_timeout=0.0).start()
    robot.command(1.0, 1.0)
    robot.cycle(50)
    robot.enable("b", False)
    assert robot.cycle(10) == [0.0, 0.0]
    with pytest.raises(NotEnabled):
        robot.command(1.0, 1.0)
    robot.state("b/position").value = -0.4
    robot.enable("b")
    assert robot.cycle(10) == [0.0, 0.0]
    assert [dof.reference for dof in robot.pid.sample(0).dofs] == [0.0, -0.4]


def test_a_state_that_is_unknown_makes_the_target_0():
    robot = Robot().start()
    robot.command(1.0, 1.0)
    robot.cycle()
    robot.state("a/position").value = math.nan
    assert robot.cycle() == [0.0, 2.0]


def test_a_velocity_reference_that_is_not_renewed_ends_and_a_position_stays():
    robot = Robot("effort", ("velocity",)).start()
    robot.command(1.0, 1.0)
    assert robot.cycle(199) == [2.0, 2.0]
    assert robot.cycle(3) == [0.0, 0.0]
    assert "no reference for 2.0" in robot.manager.events()[-1].text
    robot = Robot("effort").start()
    robot.command(1.0, 1.0)
    assert robot.cycle(1000) == [2.0, 2.0]


@pytest.mark.parametrize("values", [[1.0], [1.0, math.nan], [1.0, 1.0, 1.0]])
def test_a_reference_that_is_none_is_refused(values):
    robot = Robot().start()
    with pytest.raises(ControlError, match="expects"):
        robot.command(*values)
    assert robot.cycle() == [0.0, 0.0]


def test_a_target_position_ends_with_its_client_even_if_it_is_0():
    robot = Robot("effort").start()
    robot.cycle()
    robot.state("a/position").value = 0.3
    robot.manager.command("pid", [0.0, 0.0], robot.now, source="a test", holder=robot)
    assert robot.cycle()[0] == pytest.approx(-0.6)
    robot.manager.running.client_disconnected(robot)
    assert robot.cycle() == [0.0, 0.0]
    assert [dof.reference for dof in robot.pid.sample(0).dofs] == [0.3, 0.0]


def test_a_reference_beyond_the_limits_of_the_joint_is_refused_with_its_name():
    robot = Robot("effort", ("position", "velocity"))
    robot.pid.description = {"a": Joint("a", "revolute", "", "", limits=UrdfLimits(-0.5, 1.5, 2.0, 3.0))}
    robot.manager.configure("pid")
    robot.start().command(1.5, 9.0, -2.0, 9.0)
    robot.cycle()
    for reported, *values in (
        ("-0.5 to 1.5 .* for a/position, got 1.6", 1.6, 0.0),
        ("for a/position, got -0.6", -0.6, 0.0),
        ("-2 to 2 .* for a/velocity, got 2.1", 0.0, 0.0, 2.1, 0.0),
        ("for a/velocity, got -2.1", 0.0, 0.0, -2.1, 0.0),
    ):
        with pytest.raises(ControlError, match=reported):
            robot.command(*values)
    assert [dof.reference for dof in robot.pid.sample(0).dofs] == [1.5, 9.0]


def test_it_commands_no_positions():
    with pytest.raises(RobotConfigError, match="command_interface: position keeps its target"):
        Robot("position")


class Reader(Controller):
    """Reads what the PIDs export."""

    names = ("pid/a/position", "pid/b/position", "pid/a/velocity")

    def state_interface_names(self):
        return list(self.names)

    def on_activate(self, commands, states, now):
        super().on_activate(commands, states, now)
        self.first = [state.value for state in states]


def read(robot):
    """A controller beside the PIDs that reads what they export."""
    robot.reader = put(robot.manager, Reader("reader"))
    robot.state("a/position").value, robot.state("b/position").value = 0.5, 0.25
    return robot


def test_others_read_what_is_measured_under_the_names_of_the_references():
    robot = read(Robot("effort", ("position", "velocity"))).start("reader", "pid")
    assert robot.reader.first == [0.5, 0.25, 0.0], "the PIDs are started first"
    robot.state("a/position").value, robot.state("a/velocity").value = 0.75, -1.0
    robot.enable("b", False)
    robot.cycle()
    assert [item.value for item in robot.reader.states] == [0.75, 0.25, -1.0]
    assert {*Reader.names} < {item.name for item in robot.pid.exported_states()}
    assert robot.manager.list()[0].exported_state_interfaces[0] == "pid/a/position"


def test_it_is_not_published_while_inactive():
    robot = read(Robot("effort", ("position", "velocity")))
    reported = "reader reads pid/a/position, whose controller would not be active; {} reader and pid together"
    with pytest.raises(ControlError, match=reported.format("activate")):
        robot.start("reader")
    states = robot.start("pid", "reader").reader.states
    with pytest.raises(ControlError, match=reported.format("deactivate")):
        robot.manager.switch((), ["pid"])
    robot.manager.switch((), ["reader", "pid"])
    assert all(math.isnan(state.value) for state in states)
    robot.manager.unload("pid")
    with pytest.raises(UnknownInterface):
        robot.start("reader")


def chained(kind, interfaces, jtc_interfaces, **params):
    """A trajectory controller whose commands are the references of the PIDs."""
    robot = Robot(kind, interfaces, **params)
    add(
        robot.manager,
        "arm",
        JTC,
        joints=JOINTS,
        command_joints=["pid/a", "pid/b"],
        command_interfaces=list(jtc_interfaces),
        state_interfaces=["position", "velocity"],
        allowed_start_tolerance=0.0,
    )
    return robot


def test_it_takes_no_messages_while_another_controller_commands_it():
    robot = chained("velocity", ("position",), ("position",)).start("pid", "arm")
    robot.cycle()
    with pytest.raises(ControlError, match="is commanded by arm"):
        robot.command(1.0, 1.0)


def test_the_chain_stops_as_one_and_what_is_above_is_reported_what_does_not_follow():
    robot = chained("velocity", ("position",), ("position",)).start("pid", "arm")
    robot.cycle(5)
    robot.enable("b", False)
    robot.cycle(2)
    assert [interface.enabled for interface in robot.pid.reference_interfaces()] == [True, False]
    assert robot.hardware.values() == [0.0, 0.0]
    robot.state("b/position").value = 0.3
    robot.enable("b")
    robot.cycle(20)
    assert robot.hardware.values() == [0.0, 0.0]
    assert robot.pid.sample(0).dofs[1].reference == 0.3
    robot.manager.switch((), ["pid", "arm"])
    assert robot.pid.state is ControllerState.INACTIVE


@given(st.lists(st.tuples(st.floats(-2.0, 2.0), st.booleans()), min_size=1, max_size=30))
def test_whatever_appears_and_disappears_targets_are_finite_and_those_that_do_not_follow_have_0(steps):
    robot = Robot("effort", gains={"p": 5.0, "i": 2.0, "d": 0.1, "u_clamp_max": 3.0, "u_clamp_min": -3.0}).start()
    for value, enabled in steps:
        robot.enable("a", enabled)
        robot.state("a/position").value = value
        try:
            robot.command(value, -value)
        except NotEnabled:
            assert not enabled
        result = robot.cycle()
        assert all(abs(item) <= 3.0 for item in result)
        assert enabled or result[0] == 0.0


def test_its_cycles_leave_no_object_behind():
    robot = Robot("effort", ("position", "velocity"), {"p": 1.0, "i": 1.0, "d": 1.0}).start()
    robot.command(1.0, 1.0)
    for _ in range(300):
        robot.pid.update(robot.now, 0.01)
    gc.collect()
    before = sys.getallocatedblocks()
    for _ in range(2000):
        robot.pid.update(robot.now, 0.01)
    assert sys.getallocatedblocks() - before < 20


def test_gains_that_are_set_act_in_the_next_cycle():
    robot = Robot().start()
    robot.command(1.0, 1.0)
    assert robot.cycle() == [pytest.approx(2.0), pytest.approx(2.0)]
    robot.manager.set_parameters("pid", [ParameterValue(name="gains.b.p", kind="double", value=5.0)])
    assert robot.cycle() == [pytest.approx(2.0), pytest.approx(5.0)]
    with pytest.raises(ControlError, match="'command_interface' cannot be set because it is read-only"):
        robot.manager.set_parameters("pid", [ParameterValue(name="command_interface", kind="string", value="effort")])


# ------------------------------------------------------------------------------------------- states by messages


def external(**params):
    robot = Robot(use_external_measured_states=True, **params).start()
    robot.cycle()
    return robot


def test_measured_states_come_by_messages_and_none_are_claimed():
    robot = external()
    assert robot.pid.state_interface_names() == []
    robot.state("a/position").value = 9.0  # this value is not read
    robot.pid.set_measured_states([0.5, -0.5], robot.now)
    assert robot.cycle() == [0.0, 0.0]  # it holds where they are
    robot.command(1.0, 0.0)
    assert robot.cycle() == [1.0, 1.0]  # p: 2.0
    assert [dof.feedback for dof in robot.pid.sample(0).dofs] == [0.5, -0.5]


def test_without_a_measured_state_no_reference_is_taken_and_nothing_moves():
    robot = external()
    with pytest.raises(ControlError, match="has no measured states; send them first"):
        robot.command(1.0, 1.0)
    assert robot.cycle(5) == [0.0, 0.0]


def test_measured_states_that_stay_away_end_the_reference_and_later_ones_move_nothing():
    robot = external(measured_state_timeout=0.05)
    robot.pid.set_measured_states([0.0, 0.0], robot.now)
    robot.cycle()
    robot.command(1.0, 1.0)
    assert robot.cycle(4) == [2.0, 2.0]
    assert robot.cycle(2) == [0.0, 0.0]
    assert [event.text for event in robot.manager.events() if event.kind == "measured_state_lost"] == [
        "pid: no measured state for 0.05 s, targets are 0; send references again"
    ]
    assert [state.value for state in robot.pid.exported_states()] == pytest.approx([math.nan] * 2, nan_ok=True)
    robot.pid.set_measured_states([0.3, 0.3], robot.now)
    assert robot.cycle() == [0.0, 0.0]
    assert [dof.reference for dof in robot.pid.sample(0).dofs] == [0.3, 0.3]


@pytest.mark.parametrize(
    ("values", "text"), [([1.0], "expects 2 values"), ([1.0, math.nan], "finite"), ([0.0] * 3, "expects 4 values")]
)
def test_measured_states_that_are_not_whole_are_refused(values, text):
    robot = external(interfaces=("position", "velocity"))
    with pytest.raises(ControlError, match=text):
        robot.pid.set_measured_states(values, robot.now)
    robot.pid.set_measured_states([0.0, 0.0, 1.0, 2.0], robot.now)
    robot.cycle()
    assert [dof.feedback_dot for dof in robot.pid.sample(0).dofs] == [1.0, 2.0]


def test_a_controller_measuring_by_interfaces_takes_no_messages():
    with pytest.raises(ControlError, match="set use_external_measured_states to accept messages"):
        Robot().start().pid.set_measured_states([0.0, 0.0], S)


def test_a_controller_above_is_reported_when_measured_states_stay_away_and_holds_once_they_are_back():
    robot = chained("velocity", ("position",), ("position",), use_external_measured_states=True).start("pid", "arm")
    robot.cycle()
    assert [interface.enabled for interface in robot.pid.reference_interfaces()] == [False, False]
    for _ in range(5):
        robot.pid.set_measured_states([0.0, 0.2], robot.now)
        robot.cycle()
    assert [interface.enabled for interface in robot.pid.reference_interfaces()] == [True, True]
    assert robot.hardware.values() == [0.0, -0.4]  # above, the interfaces say 0 of b
    robot.cycle(30)
    assert [interface.enabled for interface in robot.pid.reference_interfaces()] == [False, False]
    assert robot.hardware.values() == [0.0, 0.0]


@pytest.mark.parametrize(("gains", "count"), [({"p": 0.0}, 2), ({"i": 1.0}, 0), ({"feedforward_gain": 1.0}, 0)])
def test_loops_that_always_command_zero_are_reported(gains, count):
    texts = [event.text for event in Robot(gains=gains).manager.new_events if event.kind == "immobile"]
    reported = [f"pid: gains.{joint}.p, i and d are 0, so {joint} does not move; give a gain above 0" for joint in "ab"]
    assert texts == reported[:count]
