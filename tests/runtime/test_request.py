import pytest
from support.robots import LEFT, Bench

from canopen_control.hardware.joint import Action
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
    assert ask(robby, Action.FAULT_RESET) == [None]


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
    robby.run(1000)
    assert not robby.joint(LEFT).machine.enabled
    assert ask(robby, Action.ENABLE) == [None]
