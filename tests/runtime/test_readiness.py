"""Who follows commands, and what is said where nobody does; on whole robots in simulated time."""

import pytest
from support.apiclient import Client
from support.robots import FORWARD, LEFT, RIGHT, Bench, copy_robby
from support.samples import state_dict

from canopen_control.errors import ControlError, NotEnabled, NotYetEnabled
from canopen_control.hardware.axis_power import Action
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
    assert not robby.texts("refused")  # what passes by itself is nothing to tell


def test_the_state_says_that_it_is_disabled_and_what_to_call(bench):
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


def test_a_latched_stop_says_how_to_let_go_and_then_how_to_enable(bench):
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


def test_a_time_out_of_zero_is_told_once_when_it_starts(bench):
    robby = bench(controllers=FOR_EVER)
    robby.run(3000)
    assert [text for text in robby.texts("endless_command") if "command_timeout is 0" in text] == [
        "robby_forward_controller: command_timeout is 0, so a command never ends by itself: "
        "what moves goes on when its sender dies"
    ]


def test_a_controller_that_is_only_in_the_file_says_how_to_switch(bench):
    robby = bench()
    with pytest.raises(ControlError) as refused:
        robby.robot.command("robby_base_controller", [0.1, 0.0], "test")
    assert str(refused.value) == (
        "robby_base_controller is unloaded, so it takes no command; activate it: canopen-control controller switch "
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
        found = {each["name"]: each["state"] for each in client.ask("controllers", all=True)["result"]}
        assert found["robby_base_controller"] == "unloaded"
        assert "robby_base_controller" not in {each["name"] for each in client.ask("controllers")["result"]}
        answer = client.ask("twist", controller="robby_base_controller", linear=0.1, angular=0.0)
        assert "controller switch --activate robby_base_controller" in answer["error"]["message"]
    finally:
        client.close()
        api.close()
