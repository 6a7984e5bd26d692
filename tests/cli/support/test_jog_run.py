import os
import signal
import sys
import termios

import pytest
from support.fake_client import FakeClient

from canopen_control.cli.support import jog_run
from canopen_control.cli.support.jog_run import JogRun, Keyboard, reset_fault
from canopen_control.commissioning.driven_axis import JogDrive
from canopen_control.commissioning.jog_motion import JogEnd, JogKind, JogLimits, JogMotion
from canopen_control.commissioning.quantity import JogScale
from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.robot import CommandController


def modes():
    return termios.tcgetattr(sys.stdin.fileno())


def test_single_keys_come_without_enter_and_ctrl_c_is_one_of_them(terminal):
    with Keyboard() as keyboard:
        terminal.write(b"i\x03\x1a\x13")
        assert keyboard.read(1.0) == b"i\x03\x1a\x13"
        assert keyboard.read(0.0) == b""
        assert not keyboard.ended


def test_the_terminal_is_itself_again_also_after_an_error(terminal):
    before = modes()
    with pytest.raises(ZeroDivisionError), Keyboard():
        assert 1 / (modes() == before)
    assert modes() == before


def test_a_closed_terminal_is_the_end(terminal):
    with Keyboard() as keyboard:
        terminal.close()
        assert keyboard.read(1.0) == b""
        assert keyboard.ended


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_signals_are_the_end_and_the_handlers_return(terminal, number):
    before = signal.getsignal(number)
    with Keyboard() as keyboard:
        os.kill(os.getpid(), number)
        assert keyboard.read(1.0) == b""
        assert keyboard.ended
        assert keyboard.terminated is (number == signal.SIGTERM)
    assert signal.getsignal(number) == before


DRIVE = JogDrive("jog_5", "drive", "joint", "controller", "PV")
LIMITS = JogLimits(2.0, 10.0, 1000.0)


def jog(value=1.0):
    return JogRun(DRIVE, JogScale(4096, is_known=True), JogKind.VELOCITY, value, LIMITS, 5.0)


def motion():
    return JogMotion(JogKind.VELOCITY, 1.0, LIMITS, seconds=5.0, now=0)


def test_a_fault_reset_asks_for_nothing_else(monkeypatch):
    client = FakeClient()
    monkeypatch.setattr(jog_run.RobotClient, "connect", lambda _name: client)
    assert reset_fault(DRIVE) == "joint: the fault is reset; the drive stays disabled"
    assert [each.action for each in client.asked] == ["fault-reset"]


def test_a_command_dies_with_its_sender_and_names_what_it_means():
    client, run = FakeClient(), jog()
    run._command(client, motion())
    run._command(client, motion())  # within the time for which it holds
    assert client.asked == [
        CommandController(controller="controller", values=[1.0], source="jog", dead_man=True, interface="velocity")
    ]


def test_a_drive_that_is_off_ends_the_jog_and_any_other_refusal_is_reported():
    moved = motion()
    jog()._command(FakeClient(("NotEnabled", "off")), moved)
    assert moved.ended is JogEnd.STATE
    with pytest.raises(RemoteError, match="latched"):
        jog()._command(FakeClient(("ControlError", "STOP is latched")), motion())
