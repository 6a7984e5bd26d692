"""The verbs with a running robot: output of `status`, effects of `stop`, `axis` and a fault."""

import re
import signal

import pytest
from support.commander import Commander
from support.host import eventually
from support.processes import cycles_pass, seconds_until

from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import GetStatus

pytestmark = pytest.mark.timed  # times of stops, and starts of drives that nobody waits for

SPEED = 10 / 0.003926990816987242


class Each:
    """A dict of this shape under every name."""

    def __init__(self, names, shape):
        self.names, self.shape = names, shape


def misfits(value, shape, path="status"):
    """Return where a value has not the keys and types of a shape; further keys are welcome."""
    if isinstance(shape, Each):
        if set(value) != shape.names:
            return [f"{path}: {sorted(value)}"]
        return [line for name in value for line in misfits(value[name], shape.shape, f"{path}.{name}")]
    if isinstance(shape, list):
        return [line for n, each in enumerate(value) for line in misfits(each, shape[0], f"{path}[{n}]")] or (
            [] if value else [f"{path} is empty"]
        )
    if isinstance(shape, dict):
        missing = [f"{path}.{key} is missing" for key in shape if key not in value]
        return missing + [
            line for key in shape if key in value for line in misfits(value[key], shape[key], f"{path}.{key}")
        ]
    return [] if isinstance(value, shape) else [f"{path}: {value!r}"]


@pytest.fixture
def robot(stage, probe):
    """Return robby on `local:verbs`, running, with its drives' probes and a client."""
    program = stage.robby("verbs")
    probes = {node_id: probe("verbs", node_id) for node_id in (3, 2)}
    with RobotClient.connect("verbs") as client:
        yield program, probes, client


@pytest.fixture
def commanding(robot):
    """Command the wheels for the rest of the test, whatever becomes of it."""
    commander = Commander("verbs")
    yield
    commander.end()


def test_status_reports_how_long_each_boot_step_took(stage, robot):
    text = stage.call("status").out
    for name in ("left_drive", "right_drive"):
        line = next(line for line in text.splitlines() if line.startswith(f"boot of {name}"))
        steps = dict(re.findall(r"(\w+) ([\d.]+) ms", line))
        assert list(steps) == ["reset", "identify", "configure", "heartbeat", "start"]
        assert all(float(took) > 0 for took in steps.values())
    assert "OPERATION ENABLED" in text
    assert "running, cycle" in text


def test_status_watch_prints_again_and_again_and_ends_with_the_robot(stage, robot):
    program, _, _ = robot
    watch = stage.start("status", "--watch", "--name", "verbs")
    watch.until("running, cycle")
    assert program.end() == 0, program
    assert watch.wait() in (0, 1)
    assert "Traceback" not in watch.err


def test_stop_ramps_and_disables_and_enable_continues(stage, robot, commanding):
    _, probes, client = robot
    assert eventually(lambda: all(abs(probe.speed) > 0.99 * SPEED for probe in probes.values()))
    stop = stage.call("stop")
    assert (stop.wait(), stop.err) == (0, "")
    assert all(probe.speed == 0 for probe in probes.values())  # it is answered when they stand, not before
    assert all(probe.power != "OPERATION_ENABLED" for probe in probes.values())
    assert client.ask(GetStatus()).state == "disabled"
    cycles_pass(client, 26)
    assert all(probe.speed == 0 for probe in probes.values())  # although a client still commands
    assert stage.call("axis", "enable", "all").wait() == 0
    assert eventually(lambda: all(abs(probe.speed) > 0.99 * SPEED for probe in probes.values()))
    assert stage.call("stop").wait() == 0
    assert stage.call("stop").wait() == 0  # what is reached is not an error


@pytest.mark.parametrize(("node", "mine"), [("left_drive", {3}), ("2", {2}), ("all", {3, 2})])
def test_axis_verbs_take_a_name_an_id_or_all(stage, robot, commanding, node, mine):
    _, probes, client = robot
    assert eventually(lambda: all(abs(probe.speed) > 0.99 * SPEED for probe in probes.values()))

    def check(moving, powered):
        for node_id, each in probes.items():
            expected = (moving, powered) if node_id in mine else (True, True)
            assert eventually(lambda each=each, expected=expected: (abs(each.speed) > 1) is expected[0])
            assert (each.power == "OPERATION_ENABLED") is expected[1]

    for action, moving, powered in (
        ("halt", False, True),
        ("enable", True, True),
        ("disable", False, False),
        ("enable", True, True),
        ("quick-stop", False, False),
        ("enable", True, True),
    ):
        done = stage.call("axis", action, node)
        assert (done.wait(), done.out, done.err) == (0, f"{action} {node}: done\n", "")
        check(moving, powered)
    done = stage.call("axis", "fault-reset", node)
    assert done.wait() == 1
    assert "nothing was reset, because node " in done.err
    check(moving=True, powered=True)
    assert client.ask(GetStatus()).state == "running"


def test_a_fault_stops_the_robot_and_needs_reset_and_enable(stage, robot, commanding):
    program, probes, client = robot
    assert eventually(lambda: all(abs(probe.speed) > 0.99 * SPEED for probe in probes.values()))
    probes[3].fault("undervoltage")
    seconds_until(lambda: all(abs(probe.speed) < 1 for probe in probes.values()), 2)
    assert eventually(lambda: probes[2].power == "SWITCH_ON_DISABLED")
    status = client.ask(GetStatus())
    assert status.state == "fault"
    assert status.nodes["left_drive"].axes[0].state == "FAULT"
    assert "0x3220" in status.nodes["left_drive"].error or "0x3120" in status.nodes["left_drive"].error
    assert any(event.level == "error" and "node 3 (left_drive)" in event.text for event in status.events)
    assert "left_drive" in program.out

    enable = stage.call("axis", "enable", "all")
    assert enable.wait() == 1
    assert "left_drive" in enable.err
    assert "reset" in enable.err
    reset = stage.call("axis", "fault-reset", "left_drive")
    assert reset.wait() == 1  # the cause is still there
    assert "left_drive" in reset.err
    probes[3].fault("undervoltage", on=False)
    assert stage.call("axis", "fault-reset", "left_drive").wait() == 0
    assert eventually(lambda: client.ask(GetStatus()).state == "disabled")
    assert all(probe.speed == 0 and probe.power != "OPERATION_ENABLED" for probe in probes.values())
    assert stage.call("axis", "enable", "all").wait() == 0
    assert eventually(lambda: all(abs(probe.speed) > 0.99 * SPEED for probe in probes.values()))


def test_a_fault_that_is_switched_on_by_the_command_line(stage, probe):
    """`drive --fault F@T` breaks it while the robot runs: a lost heartbeat, which is found and named."""
    stage.drive("breaks", 3, "--fault", "heartbeat_lost@8s")
    stage.drive("breaks", 2)
    robot = stage.start("run", "robby", "--as", "breaks", "--can", "local:breaks", "--no-drives")
    robot.until("breaks runs")
    robot.until("node 3 (left_drive): no heartbeat")
    with RobotClient.connect("breaks") as client:
        assert eventually(lambda: client.ask(GetStatus()).state == "fault")
        assert client.ask(GetStatus()).nodes["right_drive"].nmt_state == "OPERATIONAL"
    right = probe("breaks", 2)
    assert eventually(lambda: right.power == "SWITCH_ON_DISABLED")
    assert robot.end() == 1, robot  # the silent drive is not known to be disabled


def test_shutdown_ends_the_robot_and_returns_when_it_has(stage, robot):
    program, _, _ = robot
    assert stage.call("shutdown").wait() == 0
    assert program.wait(1.0) == 0, program
    assert "stopping: requested by a client" in program.out
    assert "no robot is running" in stage.call("status").err


def test_base_controller_by_twist(stage):
    stage.robby("base", "--controller", "robby_base_controller")
    twist = stage.start("twist", "robby_base_controller", 0.1, 0)
    with RobotClient.connect("base") as client:
        joints = lambda: [joint.velocity for joint in client.ask(GetStatus()).joints.values()]  # noqa: E731
        moves = eventually(lambda: joints() == pytest.approx([0.1 / 0.035] * 2, rel=0.01))
        assert moves, client.ask(GetStatus()).events[-12:]
        assert twist.end(signal.SIGINT) == 0, twist
        assert eventually(lambda: joints() == [0, 0])


def test_mock_hardware_needs_no_bus(stage):
    robot = stage.start("run", "robby", "--mock", "--for", 2)
    robot.until("robby runs")
    assert stage.call("command", "robby_forward_controller", 3, 4, "--for", 0.5).wait() == 0
    assert robot.wait() == 0, robot
    assert len(stage.survivors()) == 0
