"""Joints that follow commands, and the reports if none does; on whole robots in simulated time."""

import pytest
from support import makers
from support.apiclient import Client
from support.robots import FORWARD, LEFT, RIGHT, Bench, copy_robby
from support.samples import state_dict

from canopen_control.cia301.nmt import COMMAND_NAMES, NmtCommand
from canopen_control.errors import ControlError, NotEnabled, NotYetEnabled
from canopen_control.hardware.axis_statechart import Action
from canopen_control.runtime.api import ApiServer
from canopen_control.runtime.core import RobotState

NO_TIMEOUT = {"    command_timeout: 2.0 ": "    # "}
FOR_EVER = {"command_timeout: 2.0": "command_timeout: 0.0"}


@pytest.fixture
def bench(request, tmp_path):
    benches = []

    def make(start=True, **edits):
        name = f"ready{abs(hash(request.node.nodeid)) % 10**8}"
        benches.append(Bench(name, config=copy_robby(tmp_path, **edits)))
        if start:
            benches[-1].start()
        return benches[-1]

    yield make
    for each in benches:
        each.close()


def ask(robby, verb, *how):
    answers = []
    verb(*how, answers.append)
    robby.until(lambda: answers)
    assert answers == [None]


def act(robby, action, node="all"):
    ask(robby, robby.robot.axis, action, node)


def stop(robby):
    ask(robby, robby.robot.stop)


def test_a_command_to_a_stopped_robot_is_refused_and_moves_nothing_after_the_enable(bench):
    robby = bench(controllers=NO_TIMEOUT)
    stop(robby)
    with pytest.raises(NotEnabled) as refused:
        robby.command(10, 10)
    assert str(refused.value).startswith(
        "left_drive, right_drive are not enabled and will not move: canopen-control axis enable all"
    )
    act(robby, Action.ENABLE)
    robby.run(1000)
    assert (robby.speed(LEFT), robby.speed(RIGHT)) == (0, 0)
    robby.command(5, 5)
    robby.run(500)
    assert robby.velocity(LEFT) == pytest.approx(5.0, rel=0.02)


@pytest.mark.parametrize("how", [Action.DISABLE, Action.QUICK_STOP, Action.HALT])
@pytest.mark.parametrize("node", ["all", "right_drive"])
def test_what_was_commanded_before_counts_no_more_after_the_next_enable(bench, how, node):
    robby = bench(controllers=FOR_EVER)
    robby.command(10, 10)
    robby.run(500)
    act(robby, how, node)
    robby.run(300)
    act(robby, Action.ENABLE)
    robby.run(1000)
    assert (robby.speed(LEFT), robby.speed(RIGHT)) == (0, 0)


def test_a_stop_and_an_enable_between_two_cycles_keep_nothing(bench):
    robby = bench(controllers=FOR_EVER)
    robby.command(10, 10)
    robby.run(500)
    robby.robot.stop(print)
    robby.robot.axis(Action.ENABLE, "all", lambda _error: None)
    robby.run(2000)
    assert (robby.speed(LEFT), robby.speed(RIGHT)) == (0, 0)


def test_after_a_fault_it_takes_a_reset_an_enable_and_a_new_command(bench):
    robby = bench(controllers=FOR_EVER)
    robby.command(10, 10)
    robby.run(500)
    robby.drives[RIGHT].drives[0].fault(0x4310, robby.reactor.now())
    robby.run(1000)
    with pytest.raises(NotEnabled, match="fault-reset all, then canopen-control axis enable all"):
        robby.command(10, 10)
    act(robby, Action.FAULT_RESET)
    act(robby, Action.ENABLE)
    robby.run(1000)
    assert (robby.speed(LEFT), robby.speed(RIGHT)) == (0, 0)


def test_while_it_is_being_enabled_a_command_comes_too_early_and_the_next_one_is_taken(bench):
    robby = bench()
    stop(robby)
    robby.events.clear()
    robby.robot.axis(Action.ENABLE, "all", lambda _error: None)
    with pytest.raises(NotYetEnabled, match="left_drive, right_drive: being enabled"):
        robby.command(5, 5)
    robby.hold(5, 5, ms=600)
    assert robby.velocity(LEFT) == pytest.approx(5.0, rel=0.02)
    assert not robby.texts("refused")  # a transient state is not reported


def test_a_robot_that_waits_for_tpdos_without_sync_reports_this(bench):
    robby = bench(bus={"  sync_period: 20000 ": "  #"}, start=False)
    robby.robot.start()
    robby.run(3000)
    assert robby.robot.state is RobotState.STARTING
    assert "statusword of left_drive, right_drive was received: no SYNC is sent; set sync_period" in robby.robot.hint


def test_a_robot_that_waits_for_a_node_which_does_not_boot_names_it(bench):
    robby = bench(start=False)
    robby.power_off(LEFT)
    robby.robot.start()
    robby.run(2000)
    assert robby.robot.state is RobotState.STARTING
    assert robby.robot.hint.startswith("node 3 (left_drive): boot error B: no answer")


def test_the_state_reports_that_it_is_disabled_and_what_to_call(bench):
    robby = bench()
    assert (robby.robot.state, robby.robot.hint) == (RobotState.RUNNING, None)
    stop(robby)
    sample = state_dict(robby.robot)
    assert sample["state"] == "disabled"
    assert (
        sample["hint"] == "left_drive, right_drive are not enabled and will not move: canopen-control axis enable all"
    )
    act(robby, Action.ENABLE)
    assert (robby.robot.state, robby.robot.hint) == (RobotState.RUNNING, None)
    act(robby, Action.DISABLE, "right_drive")
    assert robby.robot.state is RobotState.DISABLED
    assert robby.robot.hint.startswith("right_drive is not enabled")
    act(robby, Action.ENABLE)
    act(robby, Action.HALT)
    assert robby.robot.state is RobotState.DISABLED
    assert robby.robot.hint.startswith("left_drive, right_drive are halted")


def test_a_latched_stop_suggests_how_to_release_it_and_then_how_to_enable(bench):
    robby = bench()
    robby.robot.stop(lambda _error: None, "a test")
    robby.run(1000)
    assert robby.robot.state is RobotState.DISABLED
    assert robby.robot.hint == "STOP is latched (by a test): canopen-control stop --release"
    robby.robot.latch.release("a test", robby.reactor.now())
    assert robby.robot.state is RobotState.DISABLED
    assert robby.robot.hint.endswith("canopen-control axis enable all")


def test_a_velocity_ends_after_two_seconds_where_the_yaml_names_no_time(bench):
    robby = bench(controllers=NO_TIMEOUT)
    robby.command(10, 10)
    robby.run(1900)
    assert robby.velocity(LEFT) == pytest.approx(10.0, rel=0.02)
    robby.run(1000)
    assert (robby.speed(LEFT), robby.speed(RIGHT)) == (0, 0)


def test_a_time_out_of_zero_is_reported_once_when_it_starts(bench):
    robby = bench(controllers=FOR_EVER)
    robby.run(3000)
    assert [text for text in robby.texts("endless_command") if "command_timeout is 0" in text] == [
        "robby_forward_controller: command_timeout is 0, so commands never expire: "
        "moving joints continue when the sender disappears"
    ]


def test_a_controller_that_is_only_in_the_file_suggests_how_to_switch(bench):
    robby = bench()
    with pytest.raises(ControlError) as refused:
        robby.robot.command("robby_base_controller", [0.1, 0.0], "test")
    assert str(refused.value) == (
        "robby_base_controller is unloaded, so it accepts no command; activate it: canopen-control controller switch "
        "--activate robby_base_controller --deactivate robby_forward_controller"
    )
    robby.robot.switch(["robby_base_controller"], [FORWARD], strict=True)
    with pytest.raises(ControlError, match=r"robby_forward_controller is inactive.*--deactivate robby_base_controller"):
        robby.command(1, 1)


def test_the_api_names_what_is_only_in_the_file_where_it_is_asked(bench):
    robby = bench()
    api = ApiServer(robby.robot)
    client = Client(robby)
    try:
        result = {item["name"]: item["state"] for item in client.ask("controllers", all=True)["result"]}
        assert result["robby_base_controller"] == "unloaded"
        assert "robby_base_controller" not in {item["name"] for item in client.ask("controllers")["result"]}
        answer = client.ask("twist", controller="robby_base_controller", linear=0.1, angular=0.0)
        assert "controller switch --activate robby_base_controller" in answer["error"]["message"]
    finally:
        client.close()
        api.close()


@pytest.mark.parametrize(
    ("action", "condition"),
    [(Action.DISABLE, "not enabled"), (Action.HALT, "halted"), (Action.QUICK_STOP, "not enabled")],
)
def test_a_command_names_the_joint_that_does_not_follow_and_the_advice_works(bench, action, condition):
    robby = bench()
    act(robby, action, "left_drive")
    advice = f"left_drive is {condition}: canopen-control axis enable left_drive"
    assert robby.robot.command(FORWARD, [5.0, 5.0], "test") == {"left_wheel_joint": advice}
    robby.hold(5.0, 5.0, ms=600)
    assert (robby.velocity(LEFT), robby.velocity(RIGHT)) == (0.0, pytest.approx(5.0, rel=0.02))
    assert robby.texts("not_followed") == [f"{FORWARD}: left_wheel_joint does not follow: {advice} (reported once)"]
    act(robby, Action.ENABLE, "left_drive")
    assert robby.robot.command(FORWARD, [5.0, 5.0], "test") == {}
    robby.hold(5.0, 5.0, ms=600)
    assert robby.velocity(LEFT) == pytest.approx(5.0, rel=0.02)


def followed(robby, advice):
    """Execute the commands in an advice literally, as far as they are those of this program."""
    for command in advice.split(", then "):
        _, _, words = command.partition("canopen-control ")
        words, condition, _ = words.partition(" if a drive is in fault")
        verb, action, node = words.split()
        if condition and not any(joint.machine.fault for joint in robby.robot.joints.values()):
            continue
        if verb == "nmt":
            remote = robby.robot.nodes[node]
            remote.command(COMMAND_NAMES[action], robby.reactor.now())
            robby.until(lambda remote=remote: remote.ready)
            robby.run(500)
        else:
            act(robby, Action(action), node)


@pytest.mark.parametrize("command", [NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL, NmtCommand.RESET_NODE])
@pytest.mark.parametrize("reported", ["hint", "refused", "stop"])
def test_the_advice_after_an_nmt_command_works(bench, command, reported):
    robby = bench()
    robby.hold(5.0, 5.0, ms=600)
    robby.robot.nodes["left_drive"].command(command, robby.reactor.now())
    robby.run(2000)
    with pytest.raises(NotEnabled) as refused:
        robby.command(5.0, 5.0)
    hint = robby.robot.hint
    advice = {
        "hint": hint.partition("start the stopped nodes: ")[2],
        "refused": str(refused.value)
        .removesuffix("; an earlier command is refused and not kept")
        .partition("nodes: ")[2],
        "stop": robby.texts("stop")[0].partition("; to continue: ")[2],
    }[reported]
    assert advice.count("canopen-control") == 3
    followed(robby, advice)
    assert (robby.robot.state, robby.robot.hint) == (RobotState.RUNNING, None)
    robby.hold(5.0, 5.0, ms=600)
    assert robby.velocity(LEFT) == pytest.approx(5.0, rel=0.02)


def test_the_advice_after_an_nmt_start_works(bench):
    robby = bench()
    robby.hold(5.0, 5.0, ms=600)
    node = robby.robot.nodes["left_drive"]
    for command in (NmtCommand.STOP, NmtCommand.START):
        node.command(command, robby.reactor.now())
        robby.run(2000)
    followed(robby, robby.robot.hint.partition("will not move: ")[2])
    assert (robby.robot.state, robby.robot.hint) == (RobotState.RUNNING, None)


def test_a_virtual_drive_whose_process_has_ended_is_started_again_by_its_command(bench):
    robby = bench()
    robby.robot.nodes["left_drive"].restart_command = "canopen-control drive --node-id 3"
    robby.power_off(LEFT)
    robby.until(lambda: not robby.robot.nodes["left_drive"].ready)
    robby.run(1000)
    assert robby.robot.hint == (
        "left_drive, right_drive are not enabled and will not move: start left_drive again in another terminal: "
        "canopen-control drive --node-id 3; then canopen-control axis enable all"
    )


def test_a_node_that_refuses_its_configuration_is_not_waited_for(tmp_path):
    """A drive exchanged for one whose 0x1016 is read-only: waiting does not help, its boot fails every second."""
    robot = makers.robot(tmp_path, "pv")
    try:
        robot.drives[2].start_with(["consumer_refused"])
        robot.drives[2].power_off(0.5)
        robot.run(3.0)
        assert robot.simulated.core.hint.endswith(
            " and will not move: remove the cause of boot error J of pan_drive, which `canopen-control status` shows, "
            "then canopen-control axis fault-reset all if a drive is in fault, then canopen-control axis enable all"
        )
        robot.drives[2].quirk_off("consumer_refused")
        robot.run(3.0)
        robot.enable()
        robot.run(1.0)
        assert (robot.state, robot.simulated.core.hint) == ("running", None)
    finally:
        robot.close()
