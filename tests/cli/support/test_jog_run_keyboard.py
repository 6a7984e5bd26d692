import os
import signal
import sys
import termios

import pytest
from support.terminal import typed

from canopen_control.cli.support.jog_run import Keyboard
from canopen_control.errors import ConfigError


@pytest.fixture
def terminal(monkeypatch):
    with typed(monkeypatch) as master:
        yield master


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
def test_signals_are_the_end_and_the_handlers_come_back(terminal, number):
    before = signal.getsignal(number)
    with Keyboard() as keyboard:
        os.kill(os.getpid(), number)
        assert keyboard.read(1.0) == b""
        assert keyboard.ended
    assert signal.getsignal(number) == before


def test_what_is_no_terminal_gives_no_keys(monkeypatch):
    with open(os.devnull) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with pytest.raises(ConfigError, match="standard input is none"), Keyboard():
            pass
