import pytest
from support.generic import write_generic
from support.robots import LEFT, Bench

from canopen_control.cia402.state import Command
from canopen_control.errors import CanopenError, ControlError
from canopen_control.hardware.axis_statechart import Action
from canopen_control.runtime.core import REQUEST_TIMEOUT_NS


@pytest.fixture
def robby():
    bench = Bench("request")
    bench.start()
    yield bench
    bench.close()


def ask(robby, action, node="all"):
    answers = []
    robby.robot.axis(action, node, answers.append)
    robby.until(lambda: answers, ms=20_000)
    return answers


def test_what_is_reached_already_is_answered_at_once(robby):
    assert ask(robby, Action.ENABLE) == [None]


def test_a_fault_reset_without_a_fault_is_refused_and_changes_nothing(robby):
    both = "node 3 (left_drive) and node 2 (right_drive) have no fault"
    assert ask(robby, Action.FAULT_RESET) == [f"nothing was reset, because {both}"]
    assert ask(robby, Action.FAULT_RESET, "left_drive") == [
        "nothing was reset, because node 3 (left_drive) has no fault"
    ]
    assert robby.joint(LEFT).enabled


def test_disable_enable_halt_and_quick_stop_are_answered_when_they_are_done(robby):
    robby.hold(5.0, 5.0, ms=300)
    assert ask(robby, Action.HALT) == [None]
    assert robby.speed(LEFT) == 0
    assert ask(robby, Action.DISABLE) == [None]
    assert ask(robby, Action.ENABLE) == [None]
    robby.hold(5.0, 5.0, ms=300)
    assert ask(robby, Action.QUICK_STOP) == [None]
    assert robby.speed(LEFT) == 0


def test_a_drive_that_goes_while_it_is_waited_for_is_named(robby):
    ask(robby, Action.DISABLE)
    answers = []
    robby.robot.axis(Action.ENABLE, "left_drive", answers.append)
    robby.power_off(LEFT)
    robby.until(lambda: answers, ms=REQUEST_TIMEOUT_NS // 1_000_000 + 1000)
    assert "node 3 (left_drive): enable not reached" in answers[0]


def test_a_fault_is_reset_without_enabling(robby):
    drive = robby.drives[LEFT]
    drive.drives[0].fault(0x4310, robby.reactor.now())
    robby.hosts[LEFT].wake(drive)
    robby.until(lambda: robby.joint(LEFT).machine.fault)
    robby.run(500)
    assert ask(robby, Action.FAULT_RESET, "left_drive") == [None]
    assert ask(robby, Action.FAULT_RESET, "left_drive") != [None]
    robby.run(1000)
    assert not robby.joint(LEFT).machine.enabled
    assert ask(robby, Action.ENABLE) == [None]


def test_a_mode_is_answered_when_it_shows_and_refused_where_a_controller_needs_another(robby):
    answers = []
    with pytest.raises(ControlError, match="a controller commands its velocity"):
        robby.robot.axis(Action.MODE, "all", answers.append, mode="PP")
    robby.robot.switch([], ["robby_forward_controller"], strict=True)
    robby.run(500)
    robby.robot.axis(Action.MODE, "all", answers.append, mode="pp")
    robby.until(lambda: answers)
    assert answers == [None]
    assert robby.drives[LEFT].get(0x6061) == 1
    for wrong in ("CSV", "nonsense", "-3", "99"):
        with pytest.raises(CanopenError):
            robby.robot.axis(Action.MODE, "all", answers.append, mode=wrong)


def test_homing_is_answered_when_it_is_done_and_refused_for_all_or_none(robby):
    answers = []
    robby.robot.axis(Action.HOME, "left_drive", answers.append, method=35)
    robby.until(lambda: answers)
    assert answers == [None]
    assert robby.joint(LEFT).homed
    with pytest.raises(CanopenError, match="homing method 99"):
        robby.robot.axis(Action.HOME, "all", answers.append, method=99)
    assert all(joint.homing is None for joint in robby.robot.joints.values())


@pytest.mark.rest
def test_a_touch_probe_is_read_where_there_is_one(robby, tmp_path):
    with pytest.raises(ControlError, match="no touch probe"):
        robby.robot.touch_probe("left_drive", list)
    servo = Bench("probe", config=write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    servo.start()
    servo.drives[2].store.set(0x60B9, 0, 0x0101)
    servo.drives[2].store.set(0x60BA, 0, -70000)
    results = []
    servo.robot.touch_probe("2", results.append)
    servo.until(lambda: results)
    assert results[0]["status"] == 0x0101
    assert results[0]["probe_1_positive"] == -70000
    servo.bus.drop(lambda _label, frame: frame.can_id == 0x582)
    servo.robot.touch_probe("2", results.append)
    servo.until(lambda: len(results) == 2, ms=20_000)
    assert "node 2 (drive_one)" in results[1]
    servo.close()


@pytest.fixture
def slow(request, tmp_path):
    """Return a robot of two drives, one of which does not leave SWITCHED_ON, and has 30 s for that.

    The parameter is whether each drive has a stop group of its own.
    """
    groups, extra = getattr(request, "param", False), "transition_timeouts_ms: {4: 30000}"
    config = write_generic(tmp_path, modes="velocity_mode: 3", extra=extra, groups=groups)
    bench = Bench("slow", config=config, drives=(2, 3), controllers=["velocity"])
    bench.start()
    assert ask(bench, Action.DISABLE) == [None]
    bench.run(1000)
    power = bench.drives[2].drives[0].power
    obey = power.obey
    power.obey = lambda command, now: None if command is Command.ENABLE_OPERATION else obey(command, now)
    bench.release = lambda: setattr(power, "obey", obey)
    yield bench
    bench.close()


@pytest.mark.sources
def test_enabling_has_the_time_that_bus_yml_gives(slow):
    answers = []
    slow.robot.axis(Action.ENABLE, "all", answers.append)
    slow.run(15_000)
    assert answers == []
    slow.release()
    slow.until(lambda: answers)
    assert answers == [None]


@pytest.mark.sources
@pytest.mark.parametrize("lost", [True, False])
def test_no_drive_is_enabled_after_its_request_has_ended(slow, lost):
    answers, client = [], object()
    slow.robot.axis(Action.ENABLE, "all", answers.append, holder=client)
    slow.run(1000)
    if lost:  # Ctrl-C
        slow.robot.client_disconnected(client)
        assert "so its drives are stopped and disabled" in slow.texts("commander_gone")[-1]
    else:
        slow.robot._requests[0]._deadline = slow.reactor.now()
    slow.until(lambda: answers)
    assert "enable not reached" in answers[0]
    slow.run(1000)
    slow.release()
    slow.run(5000)
    assert [drive.get(0x6041) & 0x6F for drive in slow.drives.values()] == [0x40, 0x40]


@pytest.mark.sources
@pytest.mark.parametrize("slow", [True], indirect=True)
def test_the_answer_names_the_drives_that_are_not_enabled_because_another_one_has_a_fault(slow):
    answers = []
    slow.robot.axis(Action.ENABLE, "all", answers.append)
    slow.run(500)
    slow.drives[3].drives[0].power.fault(0x2310, slow.reactor.now())
    slow.until(lambda: answers)
    assert answers[0].startswith("node 3 (drive_two): enable not reached, the drive is FAULT")
    assert answers[0].endswith("; therefore also disabled: drive_one")
    slow.release()
    slow.run(1000)
    assert slow.drives[2].get(0x6041) & 0x6F == 0x40


@pytest.mark.sources
@pytest.mark.parametrize("gone", [True, False])
def test_the_axes_that_stop_with_an_axis_whose_enabling_is_given_up_are_named(slow, gone):
    slow.release()
    assert ask(slow, Action.ENABLE) == [None]
    assert ask(slow, Action.DISABLE, "drive_one") == [None]
    power = slow.drives[2].drives[0].power
    obey = power.obey
    power.obey = lambda command, now: None if command is Command.ENABLE_OPERATION else obey(command, now)
    answers, client = [], object()
    slow.robot.axis(Action.ENABLE, "drive_one", answers.append, holder=client)
    slow.run(500)
    assert slow.joint(3).machine.enabled
    if gone:
        slow.robot.client_disconnected(client)
        assert slow.texts("commander_gone")[-1].startswith("the client that enables or homes one, two is gone")
    else:
        slow.robot._requests[0]._deadline = slow.reactor.now()
    slow.until(lambda: answers)
    assert gone or answers[0].endswith("; therefore also disabled: drive_two")
    assert slow.joint(3).stopped_by == "stopped since the enabling of one was given up"
    slow.run(1000)
    assert [drive.get(0x6041) & 0x6F for drive in slow.drives.values()] == [0x40, 0x40]
