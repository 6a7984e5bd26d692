"""The library's Robot: one that runs in this process, and a running one; the same methods for both."""

import threading

import pytest
from support.host import eventually
from support.liverobot import live_robot
from support.lockstep import lockstep
from support.mockrobot import running

from canopen_control import JointReading, Robot
from canopen_control.client import RobotClient, find_robots
from canopen_control.errors import BusError, CanopenError, ConfigError, ControlError, RemoteProtocolError, UnknownName
from canopen_control.rpc.messages.robot import PublishEvent

FORWARD = "robby_forward_controller"
BASE = "robby_base_controller"
LEFT = "left_wheel_joint"


@pytest.fixture(scope="module")
def robby(tmp_path_factory):
    """A robot on virtual drives that runs elsewhere, as far as `attach` can tell."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("lib")
        folder.chmod(0o700)
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        with live_robot("library", real_time=True):
            yield folder


@pytest.fixture
def robot(robby, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(robby))
    with Robot.attach("library") as robot:
        yield robot
        robot.release()
        robot.switch(activate=[FORWARD], deactivate=[name for name in (BASE,) if name in robot.controllers()])
        robot.axis("enable")


def velocity(robot):
    return robot.joints()[LEFT].velocity or 0.0


# -- its own robot


def test_a_script_commands_a_robot_on_virtual_drives():
    with Robot.from_config("robby", can="memory:script") as robot:
        robot.command(FORWARD, [10.0, 10.0])
        assert eventually(lambda: velocity(robot) > 9.9)
        robot.stop()
        assert abs(velocity(robot)) < 0.1
        robot.axis("enable", "left_drive")
    assert find_robots() == []


def test_arguments_reach_the_description():
    with pytest.raises(ConfigError, match="no argument 'use_mok'"):
        Robot.from_config("robby", mock=True, xacro={"use_mok": "true"})


def test_errors_come_to_the_caller_as_what_they_are():
    with Robot.from_config("robby", mock=True) as robot:
        with pytest.raises(UnknownName, match="no controller 'nobody'"):
            robot.command("nobody", [1.0])
        with pytest.raises(ControlError, match="expects 2 values"):
            robot.command(FORWARD, [1.0])
        with pytest.raises(ControlError):
            robot.axis("enable", "nobody")
        assert robot.state() == "running"


def test_a_robot_that_cannot_start_raises_why_and_leaves_nothing():
    with lockstep():
        robot = Robot.from_config("robby", can="memory:nobody", drives=False)
        with pytest.raises(CanopenError, match=r"left_drive.*right_drive"):
            robot.start()
    assert find_robots() == []
    with pytest.raises(BusError, match="robot robby is not running"):
        robot.status()


def test_an_interrupt_during_the_start_ends_the_robot(private_folders, monkeypatch):
    robot = Robot.from_config("robby", mock=True)

    def interrupted():
        assert find_robots() == ["robby"]
        raise KeyboardInterrupt

    monkeypatch.setattr(robot, "_client", interrupted)
    with pytest.raises(KeyboardInterrupt), robot:
        pass
    assert find_robots() == []


def test_starting_and_ending_twice_does_nothing():
    robot = Robot.from_config("robby", mock=True)
    robot.start()
    robot.start()
    robot.shutdown()
    robot.shutdown()
    with pytest.raises(BusError):
        robot.command(FORWARD, [1.0, 1.0])


# -- a running one


def test_leaving_a_robot_that_runs_elsewhere_does_not_stop_it(private_folders):
    with running("elsewhere") as own:
        with Robot.attach() as robot:
            assert robot.name == "elsewhere"
            assert robot.joints().keys() == own.joints().keys()
        with pytest.raises(BusError, match="was closed"):
            robot.joints()
        assert own.state() == "running"


def test_shutdown_ends_it_wherever_it_runs(private_folders):
    with running("elsewhere"):
        robot = Robot.attach("elsewhere")
        robot.shutdown()
        robot.shutdown()
        assert eventually(lambda: find_robots() == [])


def test_without_a_robot_there_is_nothing_to_attach_to(private_folders):
    with pytest.raises(ConfigError, match="no robot is running"):
        Robot.attach()
    with pytest.raises(ConfigError, match="no robot 'robby'"):
        Robot.attach("robby")


@pytest.mark.rest
def test_readings_have_types_and_si_units(robot):
    robot.command(FORWARD, [10.0, 5.0])
    assert eventually(lambda: velocity(robot) > 9.9)
    joint = robot.joints()[LEFT]
    assert isinstance(joint, JointReading)
    assert (joint.name, joint.command) == (LEFT, 10.0)
    node = robot.nodes()["left_drive"]
    assert (node.node_id, node.nmt_state, node.ready, node.error) == (3, "OPERATIONAL", True, None)
    (axis,) = node.axes
    assert (axis.joint, axis.state, axis.mode) == (LEFT, "OPERATION_ENABLED", "PV")
    controller = robot.controllers()[FORWARD]
    assert (controller.state, controller.claims) == ("active", (f"{LEFT}/velocity", "right_wheel_joint/velocity"))
    robot.stop()


def test_a_base_is_driven_by_a_twist_after_a_switch_that_loads_it(robot):
    with pytest.raises(ControlError):
        robot.twist(FORWARD, 0.1, 0.0)
    robot.switch(activate=[BASE], deactivate=[FORWARD])
    robot.switch(activate=[FORWARD], deactivate=[BASE])
    robot.switch(activate=[BASE], deactivate=[FORWARD])
    robot.axis("enable")
    robot.twist(BASE, 0.1, 0.0)
    assert eventually(lambda: velocity(robot) > 0.5)
    robot.stop()


def test_a_latched_stop_refuses_until_it_is_released(robot):
    robot.stop(latch=True)
    with pytest.raises(ControlError, match="STOP"):
        robot.axis("enable")
    robot.release()
    robot.axis("enable")


def test_objects_are_read_and_written_by_their_names_and_types(robot):
    word = robot.sdo_read("left_drive", "Statusword")
    assert isinstance(word, int)
    assert word & 0x6F == 0x27
    assert robot.sdo_read(3, 0x1018, 1) == robot.sdo_read("left_drive", "0x1018:01")
    name = robot.sdo_read(3, 0x1008)
    assert isinstance(name, str)
    assert name.encode() == robot.sdo_upload(3, 0x1008).rstrip(b"\0")
    before = robot.sdo_read(3, "Profile acceleration")
    robot.sdo_write(3, "Profile acceleration", 1234)
    assert robot.sdo_read(3, "Profile acceleration") == 1234
    robot.sdo_write(3, "Profile acceleration", before)


def test_what_is_wrong_with_an_object_is_a_sentence_of_its_kind(robot):
    with pytest.raises(UnknownName, match=r"no node 'middle_drive'; available: left_drive \(3\), right_drive \(2\)"):
        robot.sdo_read("middle_drive", 0x1000)
    with pytest.raises(ConfigError, match="no object 'Statuswort' in the EDS; did you mean 0x6041:00 Statusword"):
        robot.sdo_read(3, "Statuswort")
    with pytest.raises(ConfigError, match=r"0x6083:00 .*: "):
        robot.sdo_write(3, "Profile acceleration", -1)
    with pytest.raises(ConfigError, match="not in the EDS, so its value must be bytes"):
        robot.sdo_write(3, 0x5EEE, 1)
    with pytest.raises(RemoteProtocolError, match="abort 0x06020000") as caught:
        robot.sdo_read(3, 0x5EEE)
    assert caught.value.node_id == 3
    with pytest.raises(ConfigError, match="400001 bytes are more than"):
        robot.sdo_download(3, 0x1008, 0, bytes(400_001))


def test_events_are_pushed_at_once_to_every_subscriber(robot):
    first, second = robot.events(timeout=5.0), robot.events(timeout=0.1)
    with RobotClient.connect("library") as client, first, second:
        client.ask(PublishEvent(kind="greeting", text="hello"))
        event = next(event for event in first if event.kind == "greeting")
        assert (event.text, event.level, event.node) == ("hello", "info", None)
        assert "greeting" in [event.kind for event in second]
    assert list(first) == []


@pytest.mark.rest
def test_many_threads_may_use_one_robot(robot):
    wrong = []

    def read():
        wrong.extend(1 for _ in range(20) if robot.sdo_read(3, 0x1000) != robot.sdo_read(3, "Device type"))

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert wrong == []


def test_homing_and_enabling_are_waited_for_as_long_as_the_robot_needs(robot, monkeypatch):
    times = {}

    def ask(_client, request, timeout=None):
        times[request.action] = timeout

    with monkeypatch.context() as patch:
        patch.setattr(RobotClient, "ask", ask)
        for action in ("home", "enable", "disable"):
            robot.axis(action)
    assert times["home"] == times["enable"] == 3600.0, "a homing that goes on must not seem to have failed"
    assert times["disable"] < 60.0
