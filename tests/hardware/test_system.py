"""The hardware component: claims of interfaces, and the effect of a failed joint on the others."""

import contextlib
from types import SimpleNamespace

import pytest
from support.generic import write_generic, write_two_axes
from support.robots import LEFT, RIGHT, Bench, copy_robby

from canopen_control.cia301.nmt import NmtState
from canopen_control.cia402.state import State
from canopen_control.errors import ControlError, DriveError, NotEnabled, RobotConfigError, UnknownInterface
from canopen_control.hardware.axis_statechart import Action, AxisPhase
from canopen_control.hardware.interfaces import LifecycleState, ReturnType
from canopen_control.hardware.system import Recovery


def make(count=2):
    group = SimpleNamespace(joints=[])
    for number in range(count):
        joint = SimpleNamespace(
            joint=f"joint_{number}",
            node=SimpleNamespace(name=f"drive_{number}", ready=True),
            parameters=SimpleNamespace(loaded=True),
            machine=SimpleNamespace(fault=False, reached=True),
            state=object(),
            at_standstill=True,
            resume=True,
            statechart=SimpleNamespace(state=AxisPhase.DISABLED),
            group=group,
            enabled=0,
            enable_requested=False,
            stopped=False,
        )
        joint.stop = lambda now, joint=joint: setattr(joint, "stopped", True)
        joint.enable = lambda joint=joint: vars(joint).update(enabled=joint.enabled + 1, enable_requested=True)
        group.joints.append(joint)
    events = []
    return Recovery(group.joints, events.append), group.joints, events


@pytest.mark.sources  # stand-ins for joints
def test_all_that_wait_are_enabled_together_and_once():
    recovery, joints, events = make()
    recovery.step(0)
    recovery.step(0)
    assert [joint.enabled for joint in joints] == [1, 1]
    assert len(events) == 1
    assert "joint_0, joint_1" in events[0].text


def unready(joint):
    joint.node.ready = False


def unloaded(joint):
    joint.parameters.loaded = False


def faulted(joint):
    joint.machine.fault = True


def moving(joint):
    joint.at_standstill = False


def stopping(joint):
    joint.statechart.state = AxisPhase.RAMPING_DOWN


@pytest.mark.sources  # stand-ins for joints
@pytest.mark.parametrize("hinder", [unready, unloaded, faulted, moving, stopping])
def test_one_that_cannot_go_keeps_all(hinder):
    recovery, joints, events = make()
    hinder(joints[1])
    recovery.step(0)
    assert [joint.enabled for joint in joints] == [0, 0]
    assert events == []


@pytest.mark.sources  # stand-ins for joints
def test_a_reader_that_does_not_wait_is_not_woken():
    recovery, joints, _ = make()
    joints[1].resume = False
    unready(joints[1])
    recovery.step(0)
    assert [joint.enabled for joint in joints] == [1, 0]


@pytest.mark.sources  # stand-ins for joints
def test_a_drive_that_refuses_keeps_the_others_of_its_group_off():
    recovery, joints, events = make()

    def refuse():
        raise DriveError("no")

    joints[1].enable = refuse
    recovery.step(0)
    assert joints[0].stopped
    assert [event.kind for event in events] == ["recovered", "not_enabled", "not_enabled"]
    assert "joint_0 stay disabled because joint_1 (drive_1) cannot be enabled" in events[-1].text


@pytest.mark.sources  # stand-ins for joints
def test_a_drive_that_refuses_is_reported():
    recovery, joints, events = make(1)

    def refuse():
        raise DriveError("no")

    joints[0].enable = refuse
    recovery.step(0)
    assert [event.kind for event in events] == ["recovered", "not_enabled"]
    assert not joints[0].resume


DEVICE = '<param name="device_name">${side}_drive</param>'
VELOCITIES = ["left_wheel_joint/velocity", "right_wheel_joint/velocity"]


@pytest.fixture
def robby():
    bench = Bench("system")
    yield bench
    bench.close()


def test_the_interfaces_are_those_of_the_description_and_the_pdos(robby):
    system = robby.robot.systems[0]
    assert [interface.name for interface in system.command_interfaces] == VELOCITIES
    assert {interface.name for interface in system.state_interfaces} == {
        f"{side}_wheel_joint/{what}" for side in ("left", "right") for what in ("position", "velocity")
    }


def test_a_verb_of_the_lifecycle_that_does_not_fit_the_state_does_nothing(robby):
    system = robby.robot.systems[0]
    assert system.state is LifecycleState.UNCONFIGURED
    for verb, state in (
        (system.activate, LifecycleState.UNCONFIGURED),
        (system.configure, LifecycleState.INACTIVE),
        (system.activate, LifecycleState.ACTIVE),
        (system.configure, LifecycleState.ACTIVE),
        (system.deactivate, LifecycleState.INACTIVE),
        (system.cleanup, LifecycleState.UNCONFIGURED),
        (system.shutdown, LifecycleState.FINALIZED),
        (system.configure, LifecycleState.FINALIZED),
        (system.activate, LifecycleState.FINALIZED),
    ):
        verb()
        assert system.state is state
    assert system.read(0, 0.02) is ReturnType.OK


def test_deactivating_stops_what_no_controller_moves(robby):
    robby.start()
    robby.hold(10.0, 10.0, ms=500)
    robby.robot.systems[0].deactivate()
    assert [robby.joint(side).statechart.state for side in (LEFT, RIGHT)] == [AxisPhase.RAMPING_DOWN] * 2
    robby.run(2000)
    assert (robby.speed(LEFT), robby.speed(RIGHT)) == (0, 0)
    assert not robby.joint(LEFT).machine.enabled


def test_an_unknown_interface_cannot_be_claimed(robby):
    with pytest.raises(UnknownInterface, match="left_wheel_joint/velocity"):
        robby.robot.systems[0].prepare_command_mode_switch(["left_wheel/velocity"], [])


def test_a_joint_that_is_commanded_cannot_be_claimed_again(robby):
    robby.start()
    with pytest.raises(ControlError, match="deactivate"):
        robby.robot.systems[0].prepare_command_mode_switch(VELOCITIES, [])


def test_releasing_the_interfaces_ramps_down_and_disables(robby):
    robby.start()
    robby.hold(10.0, 10.0, ms=500)
    robby.robot.switch([], ["robby_forward_controller"], strict=True)
    assert all(joint.statechart.state is AxisPhase.RAMPING_DOWN for joint in robby.robot.joints.values())
    robby.until(lambda: robby.robot.systems[0].stopped)
    assert robby.speed(LEFT) == robby.speed(RIGHT) == 0
    robby.robot.switch(["robby_forward_controller"], [], strict=True)
    robby.until(lambda: all(joint.enabled for joint in robby.robot.joints.values()))


def test_a_drive_whose_node_is_gone_cannot_be_enabled(robby):
    robby.start()
    robby.power_off(LEFT)
    robby.until(lambda: not robby.joint(LEFT).node.ready)
    with pytest.raises(ControlError, match=r"^node 3 \(left_drive\) is not operational: no heartbeat for"):
        robby.robot.systems[0].enable([robby.joint(LEFT)])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("${side}_drive", "${side}_driv", "did you mean 'left_drive'"),
        (DEVICE, "", "device_name"),
        (DEVICE, '<param name="node_id">77</param>', "node_id 77"),
    ],
)
def test_a_joint_without_its_drive_is_an_error_that_names_both(tmp_path, old, new, words):
    config = copy_robby(tmp_path, description={old: new})
    with pytest.raises(RobotConfigError, match=words):
        Bench("system2", config=config)


def test_a_joint_may_name_its_drive_by_node_id(tmp_path):
    by_id = '<param name="node_id">${3 if side == "left" else 2}</param>'
    config = copy_robby(tmp_path, description={DEVICE: by_id})
    bench = Bench("system3", config=config)
    assert bench.joint(LEFT).node.name == "left_drive"
    bench.close()


def test_the_axes_of_one_device_are_joints_of_their_own(tmp_path):
    bench = Bench("twoaxes", config=write_two_axes(tmp_path), drives=(2,), controllers=["velocity"])
    bench.start()
    for _ in range(100):
        bench.robot.command("velocity", [1.0, -2.0], "test")
        bench.run(10)
    assert len(bench.drives[2].drives) == 2
    one, two = (joint.states["velocity"].value for joint in bench.robot.joints.values())
    assert (one, two) == (pytest.approx(1.0, rel=0.01), pytest.approx(-2.0, rel=0.01))
    assert bench.drives[2].get(0x68FF) == -20861
    bench.drives[2].drives[1].fault(0x4310, bench.reactor.now())
    bench.hosts[2].wake(bench.drives[2])
    bench.until(lambda: bench.texts("stop"))
    bench.until(lambda: all(joint.state is not State.OPERATION_ENABLED for joint in bench.robot.joints.values()))
    bench.close()


def test_one_axis_of_a_device_is_disabled_and_the_other_continues(tmp_path):
    bench = Bench("oneaxis", config=write_two_axes(tmp_path), drives=(2,), controllers=["velocity"])
    bench.start()
    answers, (one, two) = [], bench.robot.joints.values()
    bench.robot.axis(Action.DISABLE, "drive_one", answers.append, joint="two")
    bench.until(lambda: answers)
    assert (answers, one.enabled, two.enabled) == ([None], True, False)
    with pytest.raises(ControlError, match="drive_one has no joint 'three'; available: one, two"):
        bench.robot.axis(Action.DISABLE, "drive_one", answers.append, joint="three")
    bench.close()


@pytest.mark.sources
@pytest.mark.parametrize("other", ["follows", "is disabled"])
def test_nmt_stop_of_an_axis_that_obeys_nothing_spares_the_other_axis_of_the_device(tmp_path, other):
    bench = Bench("lastresort", config=write_two_axes(tmp_path), drives=(2,), controllers=["velocity"])
    bench.start()
    device, node = bench.drives[2], bench.robot.nodes["drive_one"]
    device.drives[1].power.obey = lambda _command, _now: None
    name = {"joint": "two"} if other == "follows" else {}
    bench.robot.axis(Action.DISABLE, "drive_one", lambda _error: None, **name)
    for _ in range(150):
        with contextlib.suppress(NotEnabled):
            bench.robot.command("velocity", [1.0, 1.0], "test")
        bench.run(100)
    text = bench.texts("stop_overdue")[-1]
    if other == "follows":
        assert device.get(0x606C) == pytest.approx(10430, rel=0.01)
        assert node.nmt_state is NmtState.OPERATIONAL
        assert text.endswith(": canopen-control nmt stop drive_one")
    else:
        assert node.nmt_state is NmtState.STOPPED
        assert "NMT stop was sent" in text
    bench.close()


def test_an_axis_that_no_device_can_have_is_an_error(tmp_path):
    config = write_generic(tmp_path)
    path = config / "generic.urdf"
    path.write_text(path.read_text().replace("drive_two</param>", "drive_two</param><param name='channel'>9</param>"))
    with pytest.raises(RobotConfigError, match="axis '9'"):
        Bench("noaxis", config=config, drives=(2,))


def test_a_fault_reset_enables_nothing_nor_does_the_end_of_a_fault(robby):
    robby.start()
    device = robby.drives[LEFT]
    device.drives[0].fault(0x4310, robby.reactor.now())
    robby.until(lambda: robby.joint(LEFT).machine.fault and not robby.joint(RIGHT).enabled)
    robby.robot.axis(Action.FAULT_RESET, "all", lambda _error: None)
    robby.until(lambda: not robby.joint(LEFT).machine.fault)
    robby.run(1000)
    assert not any(joint.enable_requested or joint.resume or joint.enabled for joint in robby.robot.joints.values())
    robby.robot.axis(Action.ENABLE, "all", lambda _error: None)
    robby.until(lambda: all(joint.enabled for joint in robby.robot.joints.values()))
