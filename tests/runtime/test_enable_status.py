"""Joints that follow commands, and the reports if none does; on whole robots in simulated time."""

from pathlib import Path

import pytest
from support import makers
from support.apiclient import Client, base64_of
from support.busalone import IO, AloneBench, write_drives
from support.iomodule import with_io_module
from support.robots import FORWARD, LEFT, RIGHT, Bench, copy_robby
from support.samples import state_dict, status_dict

from canopen_control.cia301.nmt import COMMAND_NAMES, NmtCommand
from canopen_control.cia402.state import State
from canopen_control.errors import ControlError, NotEnabled, NotYetEnabled
from canopen_control.hardware.axis_statechart import Action
from canopen_control.runtime.api import ApiServer
from canopen_control.runtime.core import RobotState
from canopen_control.runtime.enable_status import StopLatch, is_controlword


@pytest.fixture
def bench_of_needed_nodes(tmp_path, request):
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
    for benche in benches:
        benche.close()


@pytest.mark.parametrize("key", ["", "required: false", "mandatory: false"])
def test_one_that_is_not_called_required_is_reported_and_stops_nothing(bench_of_needed_nodes, key):
    robot = bench_of_needed_nodes(key)
    robot.power_off(IO)
    robot.collected("heartbeat_lost")
    robot.target(2.0)
    robot.run(500)
    assert robot.found("stop") == []
    assert robot.at("velocity") == pytest.approx(2.0, rel=0.02)
    assert robot.robot.nodes["io_module"].error is not None
    assert (robot.robot.state is RobotState.FAULT) is (key == "")  # by default the robot waits for it


@pytest.mark.parametrize("key", ["required: true", "mandatory: true"])
def test_one_that_is_required_stops_all_axes_with_their_ramp_and_names_itself(bench_of_needed_nodes, key):
    robot = bench_of_needed_nodes(key)
    robot.power_off(IO)
    event, _ = robot.collected("stop")
    assert "node 5 (io_module), which bus.yml requires, was lost" in event.text
    robot.disabled_after()
    assert robot.found("fault") == []
    assert "is gone" not in str(robot.target(2.0))
    assert robot.robot.state is RobotState.FAULT


def test_nothing_is_enabled_before_it_is_back_and_its_return_enables_nothing(bench_of_needed_nodes):
    robot = bench_of_needed_nodes("required: true")
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


def test_one_that_restarts_between_two_cycles_stops_them_too(bench_of_needed_nodes):
    robot = bench_of_needed_nodes("required: true")
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


NO_TIMEOUT_OF_LATCH = {"command_timeout: 2.0": "command_timeout: 0.0"}


@pytest.fixture
def bench_of_latch(request, tmp_path):
    benches = []

    def make(**edits):
        name = f"latch{abs(hash(request.node.nodeid)) % 10**8}"
        benches.append(Bench(name, config=copy_robby(tmp_path, **edits)))
        return benches[-1]

    yield make
    for benche in benches:
        benche.close()


def stop_of_latch(robby, by="a test"):
    answers = []
    robby.robot.stop(answers.append, by)
    robby.until(lambda: answers)
    assert answers == [None]


def act_of_latch(robby, action):
    answers = []
    robby.robot.axis(action, "all", answers.append)
    robby.until(lambda: answers)
    assert answers == [None]


def test_a_latched_stop_stops_and_refuses_everything_that_would_move_with_a_remedy(bench_of_latch):
    robby = bench_of_latch()
    robby.start()
    robby.hold(10, 10, ms=500)
    assert abs(robby.speed(LEFT)) > 1000
    stop_of_latch(robby)
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
    act_of_latch(robby, Action.DISABLE)
    answers = []
    robot.axis(Action.FAULT_RESET, "all", answers.append)  # not refused for the latch
    robby.until(lambda: answers)
    assert answers[0].startswith("nothing was reset, because")
    robot.switch((), [FORWARD], strict=True)
    robby.run(1000)
    assert all(joint.state is State.SWITCH_ON_DISABLED for joint in robot.joints.values())


def test_a_release_enables_nothing_and_the_old_command_is_discarded(bench_of_latch):
    robby = bench_of_latch(controllers=NO_TIMEOUT_OF_LATCH)
    robby.start()
    robby.command(10, 10)
    robby.run(500)
    stop_of_latch(robby)
    robby.robot.latch.release("a test", robby.reactor.now())
    robby.run(500)
    assert not any(joint.enabled for joint in robby.robot.joints.values())
    act_of_latch(robby, Action.ENABLE)
    robby.run(500)
    assert (robby.speed(LEFT), robby.speed(RIGHT)) == (0, 0)  # without a timeout, 10 rad/s would be the command still
    robby.command(5, 5)
    robby.run(500)
    assert robby.velocity(LEFT) == pytest.approx(5.0, rel=0.02)


def test_a_latch_whose_folder_cannot_exist_is_not_held():
    latch = StopLatch(print)
    latch.keep(Path("/dev/null/canopen_control/robby/stop_latched"))
    assert not latch.held


def test_an_ordinary_stop_latches_nothing(bench_of_latch):
    robby = bench_of_latch()
    robby.start()
    stop_of_latch(robby, None)
    assert not robby.robot.latch.held
    act_of_latch(robby, Action.ENABLE)


def test_a_robot_that_is_latched_while_it_boots_waits_for_the_release(bench_of_latch):
    robby = bench_of_latch()
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
    act_of_latch(robby, Action.ENABLE)
    robby.run(500)
    assert all(joint.enabled for joint in robby.robot.joints.values())


def test_a_drive_that_returns_under_a_latched_stop_stays_off(bench_of_latch):
    robby = bench_of_latch()
    robby.start()
    robby.hold(10, 10, ms=300)
    robby.power_off(LEFT)
    robby.run(100)
    stop_of_latch(robby)
    robby.power_on(LEFT)
    robby.until(lambda: robby.robot.nodes["left_drive"].ready)
    robby.run(3000)
    assert not any(joint.enabled for joint in robby.robot.joints.values())


def test_status_and_stream_name_the_client_that_latched_it(bench_of_latch):
    robby = bench_of_latch()
    robby.start()
    assert [status_dict(robby.robot)[key] for key in ("latched", "latched_by")] == [False, None]
    stop_of_latch(robby, "the page")
    stop_of_latch(robby, "somebody else")
    for reported in (status_dict(robby.robot), state_dict(robby.robot)):
        assert (reported["latched"], reported["latched_by"]) == (True, "the page")
    assert len(robby.texts("stop_latched")) == 1


@pytest.mark.parametrize(
    ("index", "expected"),
    [(0x6040, True), (0x6840, True), (0x9840, True), (0xA040, False), (0x6041, False), (0x2040, False)],
)
def test_the_controlwords_of_all_axes_are_known(index, expected):
    assert is_controlword(index) is expected


def test_the_api_latches_refuses_and_releases(bench_of_latch):
    robby = bench_of_latch()
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


def hold(bench_of_latch, **params):
    """Let a client command 10 rad/s on a controller without timeout, and die; return what the wheels do then."""
    robby = bench_of_latch(controllers=NO_TIMEOUT_OF_LATCH)
    api = ApiServer(robby.robot)
    robby.start()
    client = Client(robby)
    assert client.ask("command", controller=FORWARD, values=[10, 10], source="page", **params)["result"] == {}
    robby.run(500)
    assert robby.velocity(LEFT) == pytest.approx(10.0, rel=0.02)
    return robby, api, client


def test_what_a_dead_man_commands_ends_with_his_connection(bench_of_latch):
    robby, api, client = hold(bench_of_latch, dead_man=True)
    client.close()
    robby.run(500)
    assert (robby.speed(LEFT), robby.speed(RIGHT)) == (0, 0)
    api.close()


def test_a_client_without_a_dead_man_or_command_ends_nothing(bench_of_latch):
    robby, api, client = hold(bench_of_latch)
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
    for benche in benches:
        benche.close()


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
