"""The loss of a node that bus.yml requires, and its return."""

import pytest
from support.busalone import IO, AloneBench, write_drives
from support.iomodule import with_io_module

from canopen_control.errors import ControlError
from canopen_control.hardware.axis_statechart import Action
from canopen_control.runtime.core import RobotState


@pytest.fixture
def bench(tmp_path, request):
    benches = []

    def make(io):
        config = write_drives(tmp_path, io=io)
        benches.append(AloneBench(f"needed{abs(hash(request.node.nodeid)) % 10**8}", config=config, drives=(2, 3, IO)))
        benches[-1].start()
        benches[-1].enable()
        benches[-1].mode("PV")
        benches[-1].target(2.0)
        benches[-1].run(1000)
        benches[-1].events.clear()
        return benches[-1]

    yield make
    for each in benches:
        each.close()


@pytest.mark.parametrize("key", ["", "required: false", "mandatory: false"])
def test_one_that_is_not_called_required_is_reported_and_stops_nothing(bench, key):
    robot = bench(key)
    robot.power_off(IO)
    robot.collected("heartbeat_lost")
    robot.target(2.0)
    robot.run(500)
    assert robot.found("stop") == []
    assert robot.at("velocity") == pytest.approx(2.0, rel=0.02)
    assert robot.robot.nodes["io_module"].error is not None
    assert (robot.robot.state is RobotState.FAULT) is (key == "")  # by default the robot waits for it


@pytest.mark.parametrize("key", ["required: true", "mandatory: true"])
def test_one_that_is_required_stops_all_axes_with_their_ramp_and_names_itself(bench, key):
    robot = bench(key)
    robot.power_off(IO)
    event, _ = robot.collected("stop")
    assert "node 5 (io_module), which bus.yml requires, was lost" in event.text
    robot.disabled_after()
    assert robot.found("fault") == []
    assert "is gone" not in str(robot.target(2.0))
    assert robot.robot.state is RobotState.FAULT


def test_nothing_is_enabled_before_it_is_back_and_its_return_enables_nothing(bench):
    robot = bench("required: true")
    robot.power_off(IO)
    robot.collected("stop")
    robot.disabled_after()
    for action in (Action.ENABLE, Action.HOME):
        with pytest.raises(ControlError, match=r"io_module.*; wait for io_module"):
            robot.robot.axis(action, "all", print)
    assert "nothing moves while bus.yml requires node 5 (io_module)" in robot.robot.hint
    assert "nothing was reset" in robot.axis(Action.FAULT_RESET)  # not refused for the absent node: it moves nothing
    robot.robot.switch((), ("drive_two",), strict=True)
    with pytest.raises(ControlError, match="activating drive_two is refused"):
        robot.robot.switch(("drive_two",), (), strict=True)
    robot.power_on(IO)
    robot.until(lambda: robot.robot.nodes["io_module"].ready)
    robot.run(1000)
    assert not robot.powered(2)
    robot.enable()
    assert robot.target(1.0) is None


def test_one_that_restarts_between_two_cycles_stops_them_too(bench):
    robot = bench("required: true")
    assert robot.powered(2)
    robot.power_off(IO)
    robot.power_on(IO)
    robot.collected("restarted")
    robot.collected("stop")
    robot.until(lambda: not robot.powered(2))


@pytest.mark.rest
def test_a_robot_with_drives_under_its_controllers_needs_its_io_module_likewise(tmp_path):
    config = with_io_module(tmp_path)
    bus = config / "bus.yml"
    bus.write_text(bus.read_text().replace("    dcf: io.eds\n", "    dcf: io.eds\n    required: true\n"))
    robot = AloneBench("mixed", config=config, drives=(2, 3, IO))
    robot.start()
    robot.hold(10.0, 10.0, ms=600)
    robot.power_off(IO)
    robot.collected("stop")
    robot.until(lambda: not robot.powered(2) and not robot.powered(3))
    robot.power_on(IO)
    robot.until(lambda: robot.robot.nodes["io_module"].ready)
    robot.hold(10.0, 10.0, ms=300)
    assert robot.velocity(3) == 0.0  # its return enables nothing
    robot.enable()
    robot.hold(10.0, 10.0, ms=600)
    assert robot.velocity(3) > 5.0
    robot.close()
