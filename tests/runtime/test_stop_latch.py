"""The STOP latch, its file, and what it refuses."""

from pathlib import Path

import pytest
from support.apiclient import Client, base64_of
from support.robots import FORWARD, LEFT, RIGHT, Bench, copy_robby
from support.samples import state_dict, status_dict

from canopen_control.cia402.state import State
from canopen_control.errors import ControlError
from canopen_control.hardware.axis_statechart import Action
from canopen_control.runtime.api import ApiServer
from canopen_control.runtime.core import RobotState
from canopen_control.runtime.stop_latch import StopLatch, is_controlword

NO_TIMEOUT = {"command_timeout: 2.0": "command_timeout: 0.0"}


@pytest.fixture
def bench(request, tmp_path):
    benches = []

    def make(**edits):
        name = f"latch{abs(hash(request.node.nodeid)) % 10**8}"
        benches.append(Bench(name, config=copy_robby(tmp_path, **edits)))
        return benches[-1]

    yield make
    for each in benches:
        each.close()


def stop(robby, by="a test"):
    answers = []
    robby.robot.stop(answers.append, by)
    robby.until(lambda: answers)
    assert answers == [None]


def act(robby, action):
    answers = []
    robby.robot.axis(action, "all", answers.append)
    robby.until(lambda: answers)
    assert answers == [None]


def test_a_latched_stop_stops_and_refuses_everything_that_would_move_with_a_remedy(bench):
    robby = bench()
    robby.start()
    robby.hold(10, 10, ms=500)
    assert abs(robby.speed(LEFT)) > 1000
    stop(robby)
    assert (robby.speed(LEFT), robby.speed(RIGHT)) == (0, 0)
    robot = robby.robot
    for attempt in (
        lambda: robot.command(FORWARD, [1.0, 1.0], "test"),
        lambda: robot.axis(Action.ENABLE, "all", print),
        lambda: robot.axis(Action.HOME, "all", print),
        lambda: robot.switch(["robby_base_controller"], [FORWARD], strict=True),
    ):
        with pytest.raises(ControlError, match=r"STOP is latched \(by a test\).*canopen-control stop --release"):
            attempt()
    assert robot.manager.get(FORWARD).state.value == "active"  # the refused switch has changed nothing
    act(robby, Action.DISABLE)
    answers = []
    robot.axis(Action.FAULT_RESET, "all", answers.append)  # not refused for the latch
    robby.until(lambda: answers)
    assert answers[0].startswith("nothing was reset, because")
    robot.switch((), [FORWARD], strict=True)
    robby.run(1000)
    assert all(joint.state is State.SWITCH_ON_DISABLED for joint in robot.joints.values())


def test_a_release_enables_nothing_and_the_old_command_is_discarded(bench):
    robby = bench(controllers=NO_TIMEOUT)
    robby.start()
    robby.command(10, 10)
    robby.run(500)
    stop(robby)
    robby.robot.latch.release("a test", robby.reactor.now())
    robby.run(500)
    assert not any(joint.enabled for joint in robby.robot.joints.values())
    act(robby, Action.ENABLE)
    robby.run(500)
    assert (robby.speed(LEFT), robby.speed(RIGHT)) == (0, 0)  # without a timeout, 10 rad/s would be the command still
    robby.command(5, 5)
    robby.run(500)
    assert robby.velocity(LEFT) == pytest.approx(5.0, rel=0.02)


def test_a_latch_whose_folder_cannot_exist_is_not_held():
    latch = StopLatch(print)
    latch.keep(Path("/dev/null/canopen_control/robby/stop_latched"))
    assert not latch.held


def test_an_ordinary_stop_latches_nothing(bench):
    robby = bench()
    robby.start()
    stop(robby, None)
    assert not robby.robot.latch.held
    act(robby, Action.ENABLE)


def test_a_robot_that_is_latched_while_it_boots_waits_for_the_release(bench):
    robby = bench()
    robby.robot.start()
    robby.run(2)
    robby.robot.stop(lambda _error: None, "a test")
    robby.run(3000)
    assert robby.robot.state is RobotState.STARTING
    assert robby.robot.hint == "STOP is latched (by a test): canopen-control stop --release"
    assert not any(joint.enabled for joint in robby.robot.joints.values())
    robby.robot.latch.release("a test", robby.reactor.now())
    robby.until(lambda: robby.robot.state is not RobotState.STARTING)
    robby.run(1000)
    assert not any(joint.enabled for joint in robby.robot.joints.values())  # a release enables nothing
    act(robby, Action.ENABLE)
    robby.run(500)
    assert all(joint.enabled for joint in robby.robot.joints.values())


def test_a_drive_that_returns_under_a_latched_stop_stays_off(bench):
    robby = bench()
    robby.start()
    robby.hold(10, 10, ms=300)
    robby.power_off(LEFT)
    robby.run(100)
    stop(robby)
    robby.power_on(LEFT)
    robby.until(lambda: robby.robot.nodes["left_drive"].ready)
    robby.run(3000)
    assert not any(joint.enabled for joint in robby.robot.joints.values())


def test_status_and_stream_name_the_client_that_latched_it(bench):
    robby = bench()
    robby.start()
    assert [status_dict(robby.robot)[key] for key in ("latched", "latched_by")] == [False, None]
    stop(robby, "the page")
    stop(robby, "somebody else")
    for reported in (status_dict(robby.robot), state_dict(robby.robot)):
        assert (reported["latched"], reported["latched_by"]) == (True, "the page")
    assert len(robby.texts("stop_latched")) == 1


@pytest.mark.parametrize(
    ("index", "expected"),
    [(0x6040, True), (0x6840, True), (0x9840, True), (0xA040, False), (0x6041, False), (0x2040, False)],
)
def test_the_controlwords_of_all_axes_are_known(index, expected):
    assert is_controlword(index) is expected


def test_the_api_latches_refuses_and_releases(bench):
    robby = bench()
    api = ApiServer(robby.robot)
    robby.start()
    client = Client(robby)
    try:
        assert client.ask("stop", latch=True, source="the page")["result"] == {}
        answer = client.ask("command", controller=FORWARD, values=[1, 1])
        assert (answer["error"]["kind"], "latched" in answer["error"]["message"]) == ("ControlError", True)
        answer = client.ask("sdo_write", node="left_drive", index=0x6040, subindex=0, data=base64_of("0f00"))
        assert "controlword (0x6040)" in answer["error"]["message"]
        assert "result" in client.ask(
            "sdo_write", node="left_drive", index=0x6081, subindex=0, data=base64_of("40060000")
        )
        assert client.ask("release", source="a test") == {"id": 1, "result": {}}
        assert client.ask("status")["result"]["latched"] is False
        assert client.ask("axis", action="enable", node="all")["result"] == {}
        assert robby.texts("stop_released") == [
            "STOP was released by a test; the drives stay disabled until you enable them"
        ]
    finally:
        client.close()
        api.close()


def hold(bench, **params):
    """Let a client command 10 rad/s on a controller without timeout, and die; return what the wheels do then."""
    robby = bench(controllers=NO_TIMEOUT)
    api = ApiServer(robby.robot)
    robby.start()
    client = Client(robby)
    assert client.ask("command", controller=FORWARD, values=[10, 10], source="page", **params)["result"] == {}
    robby.run(500)
    assert robby.velocity(LEFT) == pytest.approx(10.0, rel=0.02)
    return robby, api, client


def test_what_a_dead_man_commands_ends_with_his_connection(bench):
    robby, api, client = hold(bench, dead_man=True)
    client.close()
    robby.run(500)
    assert (robby.speed(LEFT), robby.speed(RIGHT)) == (0, 0)
    api.close()


def test_a_client_without_a_dead_man_or_command_ends_nothing(bench):
    robby, api, client = hold(bench)
    client.close()
    robby.run(500)
    assert robby.velocity(LEFT) == pytest.approx(10.0, rel=0.02)
    client = Client(robby)
    assert client.ask("command", controller=FORWARD, values=[8, 8], source="page", dead_man=True)["result"] == {}
    robby.command(5, 5, source="somebody else")
    client.close()
    robby.run(500)
    assert robby.velocity(LEFT) == pytest.approx(5.0, rel=0.02)
    api.close()


def test_a_latch_outlives_its_process_and_a_release_ends_it(tmp_path):
    reports = []
    first = StopLatch(reports.append)
    first.keep(tmp_path / "robby" / "stop_latched")
    assert not first.held
    first.hold("the page", 5)

    second = StopLatch(reports.append)
    second.keep(tmp_path / "robby" / "stop_latched")
    assert second.by == "the page"
    second.report(6)
    assert "earlier run (by the page)" in reports[-1].text
    assert "canopen-control stop --release" in reports[-1].text
    second.release("a test", 7)

    third = StopLatch(reports.append)
    third.keep(tmp_path / "robby" / "stop_latched")
    third.report(8)
    assert not third.held
    assert [event.kind for event in reports] == ["stop_latched", "stop_latched", "stop_released"]


@pytest.mark.parametrize("content", ["", "{}", "[1]", '{"by"', "7"])
def test_a_latch_that_cannot_be_read_is_held(tmp_path, content):
    (tmp_path / "stop_latched").write_text(content)
    latch = StopLatch(lambda _event: None)
    latch.keep(tmp_path / "stop_latched")
    assert latch.held


def test_a_latch_that_cannot_be_kept_holds_and_reports_this(tmp_path):
    (tmp_path / "file").write_text("")
    reports = []
    latch = StopLatch(reports.append)
    latch.keep(tmp_path / "file" / "stop_latched")
    latch.by = None
    latch.hold("a test", 5)
    assert latch.held
    assert reports[-1].kind == "latch_not_kept"
    assert "the next run will not be latched" in reports[-1].text
