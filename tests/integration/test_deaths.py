"""Each process of a robot is killed in turn: the wheels stop, the death is reported, and no process survives."""

import os
import shlex
import signal
import time

import pytest
from support.host import eventually
from support.localbus import hub_status
from support.processes import GONE_S, cycles_pass, seconds_until
from support.robots import copy_robby

from canopen_control.bus.channel import open_port
from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError
from canopen_control.rpc.messages.robot import CommandController, GetStatus

pytestmark = pytest.mark.timed

LEFT, RIGHT = 3, 2
NODES = (LEFT, RIGHT)
SPEED = 10 / 0.003926990816987242  # microsteps/s at 10 rad/s
RAMP_S = SPEED / 16000  # by 0x6084 and 0x6085
CONSUMER_S = 0.5  # 0x1016: five heartbeats of 100 ms
SLACK_S = 0.25  # of a busy machine


@pytest.fixture
def turning(stage, probe):
    """Return what starts a robot and turns its wheels: program, and the drives' own probes."""

    def start(name, *options, apart=False, config="robby"):
        if apart:
            for node_id in NODES:
                stage.drive(name, node_id)
            options = (*options, "--no-drives")
        robot = stage.start("run", config, "--as", name, "--can", f"local:{name}", *options)
        robot.until(f"{name} runs")
        stage.start("command", "robby_forward_controller", 10, 10, "--name", name)
        probes = [probe(name, node_id) for node_id in NODES]
        assert eventually(lambda: all(abs(item.speed) == pytest.approx(SPEED, rel=0.01) for item in probes))
        return robot, probes

    return start


def command_again(stage, name):
    """The command before has ended with the stop, in words; nothing moves before there is another one."""
    ended = next(program for program in stage.programs if program.arguments[0] == "command")
    assert ended.wait() == 1
    assert "not enabled and will not move" in ended.err
    stage.start("command", "robby_forward_controller", 10, 10, "--name", name)


def standing(probes):
    return all(abs(probe.speed) < 1 for probe in probes)


def on_the_bus(name):
    """Return the labels of the hub's members; none while there is no hub."""
    try:
        return {member.label for member in hub_status(name).members}
    except CanopenError:
        return set()


def position(probe):
    return probe.state.axes[0].plant.position


def events(client):
    return [event.text for event in client.ask(GetStatus()).events]


def test_when_the_runtime_is_killed_the_drives_stop_by_their_own_consumer(stage, turning):
    robot, probes = turning("killed", apart=True)
    robot.end(signal.SIGKILL)
    took = seconds_until(lambda: standing(probes), 5)
    assert CONSUMER_S - 0.1 <= took <= CONSUMER_S + RAMP_S + SLACK_S
    for probe in probes:
        assert probe.power == "FAULT"
        assert probe.state.errors == [0x8130]


def test_a_hung_runtime_appears_dead_to_the_drives(stage, turning):
    robot, probes = turning("hung")
    os.kill(robot.pid, signal.SIGSTOP)
    try:
        took = seconds_until(lambda: standing(probes), 5)
    finally:
        os.kill(robot.pid, signal.SIGCONT)
    assert took <= CONSUMER_S + RAMP_S + SLACK_S
    assert all(probe.power == "FAULT" for probe in probes)
    with RobotClient.connect("hung") as client:
        ready = lambda status: all(node.ready for node in status.nodes.values())  # noqa: E731
        states = lambda: (client.ask(GetStatus()).state, ready(client.ask(GetStatus())))  # noqa: E731
        assert eventually(lambda: sum("booting it again" in text for text in events(client)) == 2)
        assert eventually(lambda: states() == ("fault", True))  # booted, and their faults are still to be reset
        assert client.ask(GetStatus()).cycle.missed > 10
    assert standing(probes)
    assert stage.call("axis", "enable", "all").wait() == 1
    assert stage.call("axis", "fault-reset", "all").wait() == 0
    assert standing(probes)
    assert stage.call("axis", "enable", "all").wait() == 0
    assert standing(probes)
    command_again(stage, "hung")
    assert eventually(lambda: not standing(probes))
    assert robot.end() == 0, robot


def test_when_the_hub_is_killed_the_run_ends_with_one_sentence(stage, turning):
    robot, _ = turning("nohub")
    os.kill(hub_status("nohub").pid, signal.SIGKILL)
    assert robot.wait() == 1
    assert robot.err.startswith("canopen-control: bus local:nohub")
    assert robot.err.count("\n") == 1
    assert "Traceback" not in robot.out
    stage.nobody_is_left(GONE_S)


def test_when_the_hub_is_killed_before_the_boot_has_ended_the_run_ends_with_one_sentence(stage):
    robot = stage.start("run", "robby", "--can", "local:young", "--no-flight-recorder")
    assert eventually(lambda: {"drive 2", "drive 3", "master"} <= on_the_bus("young"))  # else `run` starts another hub
    os.kill(hub_status("young").pid, signal.SIGKILL)
    assert robot.wait() == 1
    assert robot.err.startswith("canopen-control: bus local:young")
    assert robot.err.count("\n") == 1
    stage.nobody_is_left(GONE_S)


def test_when_a_drive_dies_before_the_boot_has_ended_the_run_ends_and_names_it(stage, tmp_path):
    config = copy_robby(tmp_path, bus={"  sync_period: 20000": "  boot_time: 2500\n  sync_period: 20000"})
    robot = stage.start("run", config, "--can", "local:stillborn", "--no-flight-recorder")
    assert eventually(lambda: len(stage.survivors()) == 4)
    os.kill(stage.pid_of("drive --node-id 2"), signal.SIGKILL)
    assert robot.wait() == 1
    assert robot.err.startswith("canopen-control: node 2 (right_drive)")
    assert robot.err.count("\n") == 1
    assert "process drive-right_drive" in robot.out
    stage.nobody_is_left(GONE_S)


@pytest.mark.ros
def test_when_the_ros_bridge_is_killed_the_robot_runs_on_and_reports_this(stage, probe):
    robot = stage.robby("noros", "--ros")
    bridge = stage.pid_of("canopen_control.ros.bridge")
    with RobotClient.connect("noros") as client:
        client.ask(CommandController(controller="robby_forward_controller", values=[10, 10], source="test"))
        os.kill(bridge, signal.SIGKILL)
        assert eventually(lambda: any(f"(pid {bridge}) was ended by signal 9" in text for text in events(client)))
        assert client.ask(GetStatus()).state == "running"
        wheel = probe("noros", LEFT)
        assert wheel.power == "OPERATION_ENABLED"
        assert eventually(lambda: wheel.speed == 0)  # no client commands any more
    assert robot.end() == 0, robot
    stage.nobody_is_left(GONE_S)


@pytest.mark.ros
def test_a_ros_bridge_does_not_survive_its_robot(stage):
    robot = stage.robby("widowed", "--ros")
    assert stage.pid_of("canopen_control.ros.bridge")
    robot.end(signal.SIGKILL)
    stage.nobody_is_left(GONE_S)


@pytest.mark.parametrize(("node", "other"), [("left_drive", "right_drive"), ("right_drive", "left_drive")])
def test_when_a_drive_is_killed_the_robot_stops_and_names_it_and_runs_on(stage, turning, node, other):
    robot, probes = turning("drive")
    victim, rest = probes if node == "left_drive" else probes[::-1]
    pid = victim.hello.pid
    os.kill(pid, signal.SIGKILL)
    took = seconds_until(lambda: abs(rest.speed) < 1, 5)
    assert took <= CONSUMER_S + RAMP_S + SLACK_S
    with RobotClient.connect("drive") as client:
        assert eventually(lambda: not client.ask(GetStatus()).nodes[node].ready)
        status = client.ask(GetStatus())
        assert status.state == "fault"
        assert f"node {victim.hello.node_id} ({node})" in status.nodes[node].error
        assert status.nodes[other].nmt_state == "OPERATIONAL"
        assert any(f"process drive-{node} (pid {pid}) was ended by signal 9" in text for text in events(client))
        assert any(f"({node})" in text and "no heartbeat" in text for text in events(client))
    assert eventually(lambda: rest.power == "SWITCH_ON_DISABLED")
    assert robot.running
    assert robot.end() == 1, robot
    assert robot.err.startswith(f"canopen-control: could not confirm that {node} is disabled")


def test_the_advice_after_the_death_of_a_drive_works_word_by_word(stage, turning):
    _, probes = turning("advised")
    os.kill(probes[0].hello.pid, signal.SIGKILL)
    with RobotClient.connect("advised") as client:
        reported = lambda: client.ask(GetStatus()).hint or ""  # noqa: E731
        assert eventually(lambda: "start left_drive again in another terminal: " in reported())
        start, enable = reported().partition("terminal: ")[2].split("; then ")
        assert any(text.endswith(f"; start it again: {start}") for text in events(client))
        stage.start(*shlex.split(start)[1:])
        assert eventually(lambda: client.ask(GetStatus()).nodes["left_drive"].ready)
        assert client.ask(GetStatus()).missing_programs == {}
        assert stage.call(*shlex.split(enable)[1:]).wait() == 0
        assert (client.ask(GetStatus()).state, reported()) == ("running", "")
    command_again(stage, "advised")
    assert eventually(lambda: abs(probes[1].speed) > 1)


def test_a_frozen_drive_stops_the_robot_and_is_booted_again_when_it_thaws(stage, turning):
    robot, probes = turning("frozen")
    pid = probes[1].hello.pid
    os.kill(pid, signal.SIGSTOP)
    try:
        seconds_until(lambda: abs(probes[0].speed) < 1, 5)
        with RobotClient.connect("frozen") as client:
            assert eventually(lambda: not client.ask(GetStatus()).nodes["right_drive"].ready)
            assert client.ask(GetStatus()).state == "fault"
    finally:
        os.kill(pid, signal.SIGCONT)
    with RobotClient.connect("frozen") as client:
        assert eventually(lambda: any("(right_drive)" in text and "booting it" in text for text in events(client)))
        assert eventually(lambda: client.ask(GetStatus()).nodes["right_drive"].ready)
    seconds_until(lambda: standing(probes), 2)
    # it may have missed our heartbeat as we have missed its: then it is in a fault, else nothing is reset
    assert stage.call("axis", "fault-reset", "all").wait() in (0, 1)
    assert stage.call("axis", "enable", "all").wait() == 0
    command_again(stage, "frozen")
    assert eventually(lambda: all(abs(probe.speed) == pytest.approx(SPEED, rel=0.01) for probe in probes))
    assert robot.end() == 0, robot


@pytest.mark.parametrize(
    ("how", "least", "most", "reported"),
    [([], 0.0, 0.0, "command is gone, so its command has ended"), (["--once"], 1.0, 2.0, "no command for 2.0")],
)
def test_a_client_that_dies_takes_its_command_with_it_unless_it_was_once(stage, probe, how, least, most, reported):
    stage.robby("widow")
    probes = [probe("widow", node_id) for node_id in NODES]
    command = stage.start("command", "robby_forward_controller", 10, 10, "--name", "widow", *how)
    assert eventually(lambda: all(abs(item.speed) > 0.99 * SPEED for item in probes))
    command.end(signal.SIGKILL)
    took = seconds_until(lambda: standing(probes), 5)
    assert least <= took <= most + RAMP_S + SLACK_S  # command_timeout: 2.0
    with RobotClient.connect("widow") as client:
        assert any(reported in text for text in events(client))
        assert client.ask(GetStatus()).state == "running"
        assert all(item.power == "OPERATION_ENABLED" for item in probes)


def test_a_suspended_client_moves_nothing_when_it_is_resumed(stage, turning):
    robot, probes = turning("stopped")
    command = next(program for program in stage.programs if program.arguments[0] == "command")
    command.send(signal.SIGSTOP)
    seconds_until(lambda: standing(probes), 5)  # by command_timeout
    command.send(signal.SIGCONT)
    assert command.wait() == 1
    assert "this program was suspended for" in command.err
    assert command.err.count("\n") == 1
    assert standing(probes)
    assert robot.end() == 0, robot


def test_the_bus_outlives_a_robot_that_is_not_alone_on_it(stage):
    """The hub belongs to nobody: who else is on the bus keeps it."""
    robot = stage.robby("shared")
    port = open_port("local:shared", label="another")
    try:
        robot.end(signal.SIGKILL)
        assert eventually(lambda: [member.label for member in hub_status("shared").members] == ["another"], GONE_S)
        assert stage.robby("shared").end() == 0
    finally:
        port.close()
    stage.nobody_is_left(GONE_S)


def paused(process_id, seconds):
    """Stop a process for a time, as a busy machine does."""
    os.kill(process_id, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(process_id, signal.SIGCONT)


def test_a_runtime_that_was_stopped_for_a_moment_blames_no_drive(stage, turning, tmp_path):
    config = copy_robby(tmp_path, bus={"  missed_syncs: 10": "  # missed_syncs: 10"})
    robot, probes = turning("paused", config=config)
    for _ in range(3):
        paused(robot.pid, 0.3)
        with RobotClient.connect("paused") as client:
            cycles_pass(client, 35)
    with RobotClient.connect("paused") as client:
        kinds = {event.kind for event in client.ask(GetStatus()).events}
    assert kinds.isdisjoint({"pdo_stale", "heartbeat_lost", "duplicate_node", "stop", "node_lost"})
    assert not standing(probes)


def test_a_drive_that_is_stopped_for_longer_stops_the_robot(stage, turning, tmp_path):
    config = copy_robby(tmp_path, bus={"  missed_syncs: 10": "  # missed_syncs: 10"})
    _, probes = turning("stuck", config=config)
    paused(probes[0].hello.pid, 1.0)
    with RobotClient.connect("stuck") as client:
        assert eventually(lambda: any("canopen-control axis enable all" in text for text in events(client)))
    assert eventually(lambda: standing(probes))
