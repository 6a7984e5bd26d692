from __future__ import annotations

from canopen_control.cia402.quick_stop_exit import QuickStopExit, StopStage
from canopen_control.cia402.state import Command

MOVING, REACHED = 0x0217, 0x0617


def test_to_enable_transition_16_is_asked_for_when_the_mode_is_confirmed():
    leave = QuickStopExit()
    assert leave.command(True, MOVING, False, False) is Command.QUICK_STOP
    assert leave.command(True, MOVING, False, True) is Command.ENABLE_OPERATION
    leave.advance()
    assert leave.command(True, MOVING, False, True) is Command.QUICK_STOP
    leave.advance()
    assert leave.command(True, MOVING, False, True) is Command.DISABLE_VOLTAGE


def test_to_disable_the_end_of_the_stop_is_waited_for():
    leave = QuickStopExit()
    leave.enter()
    leave.look(MOVING)
    assert leave.command(False, MOVING, False, True) is Command.QUICK_STOP
    assert leave.stage is StopStage.WAIT
    leave.look(REACHED)
    assert leave.command(False, REACHED, False, True) is Command.DISABLE_VOLTAGE
    assert leave.command(False, MOVING, False, True) is Command.DISABLE_VOLTAGE


def test_a_bit_10_that_was_there_before_the_stop_is_no_standstill():
    leave = QuickStopExit()
    leave.look(REACHED)
    assert leave.command(False, REACHED, False, True) is Command.QUICK_STOP
    assert leave.command(False, REACHED, True, True) is Command.DISABLE_VOLTAGE
    leave.enter()
    leave.look(REACHED)
    assert leave.command(False, REACHED, False, True) is Command.QUICK_STOP


def test_another_goal_begins_again():
    leave = QuickStopExit()
    leave.advance()
    leave.advance()
    leave.restart()
    assert leave.command(True, MOVING, False, True) is Command.ENABLE_OPERATION
