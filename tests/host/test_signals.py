import atexit
import gc
import os
import signal
import sys
import time

import pytest

from canopen_control.errors import CanopenError
from canopen_control.host import signals
from canopen_control.host.signals import (
    LONGEST_SUSPENSION_S,
    ProcessSignals,
    SuspensionWatch,
    block_for_exec,
    interrupt,
    on_signals,
)


def test_it_calls_within_the_block_and_is_as_before_afterwards():
    before, called = signal.getsignal(signal.SIGUSR1), []
    with on_signals((signal.SIGUSR1,), lambda: called.append(1)):
        os.kill(os.getpid(), signal.SIGUSR1)
        assert called == [1]
    assert signal.getsignal(signal.SIGUSR1) is before


def test_a_signal_can_end_as_ctrl_c_does():
    with pytest.raises(KeyboardInterrupt), on_signals((signal.SIGUSR1,), interrupt):
        os.kill(os.getpid(), signal.SIGUSR1)


@pytest.fixture
def clock(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(signals.time, "monotonic", lambda: now[0])
    return now


def test_a_suspension_that_is_longer_than_a_command_may_last_is_a_sentence(clock):
    before = signal.getsignal(signal.SIGCONT)
    with SuspensionWatch() as watch:
        clock[0] += 60.0  # a busy machine, or a program that waits
        watch.require_unsuspended()
        clock[0] += LONGEST_SUSPENSION_S
        signal.raise_signal(signal.SIGCONT)
        watch.require_unsuspended()
        clock[0] += 12.34
        signal.raise_signal(signal.SIGCONT)
        with pytest.raises(CanopenError, match=r"this program was suspended for 12\.3 s, so its command has ended"):
            watch.require_unsuspended()
    assert signal.getsignal(signal.SIGCONT) == before


@pytest.fixture
def process_signals(monkeypatch):
    """Signals of this process, as the command line has them; restored afterwards."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)
    before = {number: signal.getsignal(number) for number in numbers}
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    signals = ProcessSignals()
    signals.begin()
    yield signals
    atexit.unregister(signals._ignore)
    signal.setitimer(signal.ITIMER_REAL, 0)
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_of_a_process_interrupts_it_until_it_has_finished(process_signals, monkeypatch, number):
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(number)
    assert process_signals.received
    process_signals.finish()
    signal.raise_signal(number)
    monkeypatch.setattr(os, "_exit", interrupt_with_code)
    with pytest.raises(SystemExit, match="130"):
        signal.raise_signal(number)


def interrupt_with_code(code):
    raise SystemExit(code)


@pytest.mark.parametrize("first", [signal.SIGHUP, signal.SIGINT])
def test_a_terminal_that_is_closed_during_the_end_does_not_interrupt_it(process_signals, first):
    """The kernel and the shell send one SIGHUP each, and the end of a verb may ramp drives down."""
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(first)
    signal.raise_signal(signal.SIGHUP)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)


def test_at_the_end_of_a_process_its_signals_are_ignored(process_signals):
    process_signals._ignore()
    assert signal.getsignal(signal.SIGINT) == signal.getsignal(signal.SIGTERM) == signal.SIG_IGN


def test_an_ignored_signal_stays_ignored(process_signals, monkeypatch):
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ProcessSignals().begin()
    assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN


def test_a_signal_during_an_import_interrupts_after_it(process_signals, tmp_path, monkeypatch):
    """A module in C whose import is interrupted ends the process by SIGSEGV: msgspec 0.19."""
    text = "import signal\nsignal.raise_signal(signal.SIGINT)\nwhole = True\n"
    (tmp_path / "imported_by_half.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012 - it comes a moment later
        import imported_by_half

        assert imported_by_half.whole
        time.sleep(60)


def test_an_interrupt_that_is_lost_while_an_object_is_freed_comes_again(process_signals, capsys):
    class Freed:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):  # noqa: PT012 - it comes a moment later
        Freed()
        gc.collect()
        time.sleep(60)
    assert capsys.readouterr().err == ""


def test_another_exception_there_is_reported(process_signals, capsys):
    class Freed:
        def __del__(self):
            raise ZeroDivisionError

    Freed()
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_signals_before_exec_come_after_it(process_signals):
    block_for_exec()
    signal.raise_signal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        ProcessSignals().begin()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT, signal.SIGTERM])
