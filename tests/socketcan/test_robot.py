"""The robot, its two drives and a listener, each a separate process, on a vcan of a real kernel."""

import itertools

import pytest
from support.guest import LEFT, NMT, RIGHT, SYNC, CandumpLine, ip, scaled
from support.host import eventually
from support.processes import seconds_until

from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import GetStatus

pytestmark = pytest.mark.socketcan
NODES = (LEFT, RIGHT)
TIMEOUT_S = scaled(10)


def steady(listener, node_id, seconds):
    """Return the speeds of the last `seconds` before the wheel slowed down."""
    speeds = listener.speeds(node_id)
    turning = [(when, speed) for when, speed in speeds if speed > 9.0]
    end = turning[-1][0] - scaled(0.1)
    return [speed for when, speed in turning if end - seconds < when < end]


def test_two_drives_and_the_robot_turn_both_wheels_at_ten_rad_per_second(stage, robby, vcan, listen):
    hears = listen(vcan)
    robot = stage.start("run", robby, "--as", "wheels", "--can", vcan, "--for", 8)
    robot.until("wheels runs")
    command = stage.start("command", "robby_forward_controller", 10, 10, "--for", 4, "--name", "wheels")
    assert eventually(lambda: hears.is_at(10.0), TIMEOUT_S)
    assert command.wait() == 0, command
    assert eventually(lambda: hears.is_at(0.0), TIMEOUT_S)
    assert robot.wait() == 0, robot
    assert robot.err == ""
    for node_id in NODES:
        held = steady(hears, node_id, 1.5)
        assert len(held) >= 0.8 * 1.5 / scaled(0.02)
        assert all(abs(speed - 10.0) <= 0.1 for speed in held), held
        assert hears.speeds(node_id)[-1][1] == 0.0
    assert {identifier for _, identifier, _ in hears.frames if identifier > 0x7FF} == set(), "standard frames only"
    times = [when for when, _ in hears.of(SYNC)]
    gaps = [after - before for before, after in itertools.pairwise(times)]
    assert sorted(gaps)[len(gaps) // 2] == pytest.approx(scaled(0.02), rel=0.1)


def test_the_base_controller_turns_the_wheels_by_a_twist(stage, robby, vcan, listen):
    hears = listen(vcan, 0x280 + LEFT, 0x280 + RIGHT)
    robot = stage.start("run", robby, "--as", "base", "--can", vcan, "--controller", "robby_base_controller")
    robot.until("base runs")
    stage.start("twist", "robby_base_controller", 0.35, 0, "--name", "base")
    assert eventually(lambda: hears.is_at(10.0), TIMEOUT_S), "0.35 m/s on wheels of 0.035 m"
    assert robot.end() == 0, robot
    assert hears.speeds(LEFT)[-1][1] == hears.speeds(RIGHT)[-1][1] == 0.0


def test_the_drives_are_processes_independent_of_the_master(stage, robby, vcan, listen):
    hears = listen(vcan, 0x280 + LEFT, 0x280 + RIGHT)
    for node_id in NODES:
        drive = stage.start("drive", "--node-id", node_id, "--eds", "TMCM-1270.eds", "--can", vcan)
        drive.until(f"drive {node_id} (TMCM-1270) ready on {vcan}")
    robot = stage.start("run", robby, "--as", "apart", "--can", vcan, "--no-drives")
    robot.until("apart runs")
    stage.start("command", "robby_forward_controller", 10, 10, "--name", "apart")
    assert eventually(lambda: hears.is_at(10.0), TIMEOUT_S)
    assert stage.call("stop", "--name", "apart").wait() == 0
    assert hears.is_at(0.0)
    again = stage.call("drive", "--node-id", LEFT, "--eds", "TMCM-1270.eds", "--can", vcan)
    assert again.wait() == 1
    assert f"node-ID {LEFT} already answers on {vcan}" in again.err
    assert robot.end() == 0, robot


def test_candump_receives_standard_frames(stage, robby, vcan, tool):
    dump = tool("candump", "-L", vcan)
    robot = stage.start("run", robby, "--as", "dumped", "--can", vcan, "--for", 2)
    assert robot.wait() == 0, robot
    dump.terminate()
    lines = [CandumpLine(line) for line in dump.communicate(timeout=20)[0].splitlines()]
    assert all(line.interface == vcan and len(line.identifier) == 3 for line in lines)
    identifiers = {line.identifier for line in lines}
    assert identifiers >= {"000", "080", "182", "183", "282", "283", "582", "583", "602", "603", "701", "702", "703"}
    assert [line.data for line in lines if line.identifier == "000"][-1].startswith("82")
    assert sum(line.identifier == "080" for line in lines) >= 2 / scaled(0.02)


def test_noise_at_full_rate_does_no_harm(stage, robby, vcan, listen, tool):
    hears = listen(vcan, 0x280 + LEFT, 0x280 + RIGHT, SYNC, NMT)
    robot = stage.start("run", robby, "--as", "noise", "--can", vcan)
    robot.until("noise runs")
    stage.start("command", "robby_forward_controller", 10, 10, "--name", "noise")
    assert eventually(lambda: hears.is_at(10.0), TIMEOUT_S)
    before = received(vcan)
    noises = [
        tool("cangen", vcan, "-g", "0", "-i", "-e"),  # any 29-bit identifier, any length
        tool("cangen", vcan, "-g", "0", "-i", "-I", "7AA", "-L", "8"),
    ]
    since = len(hears.frames)
    assert not eventually(lambda: not hears.is_at(10.0), scaled(1.0)), "the wheels do not notice"
    assert all(noise.poll() is None for noise in noises)
    assert received(vcan) - before > 2000  # whatever the speed of the machine: 33 times the robot's own frames
    assert len(hears.frames) - since > 0.5 * 3 * scaled(1.0) / scaled(0.02)
    for noise in noises:
        noise.terminate()
    with RobotClient.connect("noise") as client:
        status = client.ask(GetStatus())
    assert status.state == "running", status
    assert {node.nmt_state for node in status.nodes.values()} == {"OPERATIONAL"}
    assert robot.end() == 0, robot


def received(interface):
    with open(f"/sys/class/net/{interface}/statistics/rx_packets") as file:
        return int(file.read())


class Watch:
    """A robot as its clients see it."""

    def __init__(self, client):
        self._client = client

    @property
    def status(self):
        return self._client.ask(GetStatus())

    def collected(self, text):
        return any(text in event.text for event in self.status.events)

    def ready(self):
        return [node.ready for node in self.status.nodes.values()]


def moves_again(stage, name, hears):
    """The drives missed the master's heartbeat and stopped by themselves: a fault, which is reset, then enabled."""
    assert hears.is_at(0.0), "although somebody commands 10 rad/s"
    for action in ("fault-reset", "enable"):
        assert stage.call("axis", action, "all", "--name", name).wait() == 0
    assert hears.is_at(0.0), "a command from before is forgotten"
    stage.start("command", "robby_forward_controller", 10, 10, "--name", name)
    return eventually(lambda: hears.is_at(10.0), TIMEOUT_S)


def test_an_interface_that_goes_down_stops_the_robot_and_up_brings_it_back(stage, robby, vcan, listen):
    hears = listen(vcan, 0x280 + LEFT, 0x280 + RIGHT)
    robot = stage.start("run", robby, "--as", "downs", "--can", vcan)
    robot.until("downs runs")
    command = stage.start("command", "robby_forward_controller", 10, 10, "--name", "downs")
    assert eventually(lambda: hears.is_at(10.0), TIMEOUT_S)
    with RobotClient.connect("downs") as client:
        watch = Watch(client)
        ip("link", "set", vcan, "down")
        assert seconds_until(lambda: watch.collected(f"bus {vcan}: the interface is down"), 5) < 1.0
        assert eventually(lambda: not any(watch.ready()), scaled(2))
        assert watch.status.state == "fault"
        ip("link", "set", vcan, "up")
        assert eventually(lambda: all(watch.ready()), scaled(10)), watch.status
        assert watch.collected(f"bus {vcan}: up again")
    assert moves_again(stage, "downs", hears)
    assert command.wait() == 1  # its drives were off
    assert robot.end() == 0, robot


def test_an_interface_that_is_removed_and_made_again_is_found_again(stage, robby, vcan, listen):
    for node_id in NODES:
        stage.start("drive", "--node-id", node_id, "--eds", "TMCM-1270.eds", "--can", vcan).until("ready on")
    robot = stage.start("run", robby, "--as", "gone", "--can", vcan, "--no-drives")
    robot.until("gone runs")
    stage.start("command", "robby_forward_controller", 10, 10, "--name", "gone")
    with RobotClient.connect("gone") as client:
        watch = Watch(client)
        ip("link", "del", vcan)
        assert seconds_until(lambda: watch.collected(f"bus {vcan}: the interface was removed"), 5) < 1.0
        assert eventually(lambda: not any(watch.ready()), scaled(2))
        assert watch.status.state == "fault"
        assert stage.call("bus", "up", vcan).wait() == 0
        hears = listen(vcan, 0x280 + LEFT, 0x280 + RIGHT)
        assert eventually(lambda: all(watch.ready()), scaled(10)), watch.status
    assert moves_again(stage, "gone", hears)
    assert robot.end() == 0, robot


def test_a_missing_and_a_down_interface_are_named_with_what_to_type(stage, robby, vcan):
    missing = stage.call("run", robby, "--can", "vcan99")
    assert (missing.wait(), "create it: canopen-control bus up vcan99" in missing.err) == (2, True), missing
    ip("link", "set", vcan, "down")
    down = stage.call("run", robby, "--can", vcan)
    assert (down.wait(), f"bring it up: canopen-control bus up {vcan}" in down.err) == (2, True), down
