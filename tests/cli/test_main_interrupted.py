"""SIGINT, SIGTERM and SIGHUP at any step of a verb: exit code 130 or its own, and no traceback."""

import atexit
import signal
import subprocess
import sys

import pytest

from canopen_control.cli import main as program
from canopen_control.errors import CanopenError
from canopen_control.host.signals import ProcessSignals

NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture
def run_as_process(monkeypatch):
    """Runs a verb as the process of its own that it is for a user."""
    before = {number: signal.getsignal(number) for number in (*NUMBERS, signal.SIGALRM)}
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)

    def run(*words):
        signals = ProcessSignals()
        monkeypatch.setattr(program, "_signals", signals)
        monkeypatch.setattr(sys, "argv", ["canopen-control", *words])
        try:
            return program.main()
        finally:
            atexit.unregister(signals._ignore)
            for number, handler in before.items():
                signal.signal(number, handler)

    return run


def raising(error, cause=None):
    def dispatch(arguments):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise error from cause

    return dispatch


@pytest.mark.parametrize(
    ("error", "cause", "printed"),
    [
        (RuntimeError("Unable to convert call argument '0' to Python object"), None, ""),  # pybind11, in rclpy
        (CanopenError("ROS 2 could not be started"), RuntimeError("Unable to convert"), ""),
        (CanopenError("the drives of robby have not stopped"), None, "the drives of robby have not stopped\n"),
    ],
)
def test_an_exception_that_an_interrupt_has_become_is_the_interrupt(
    run_as_process, monkeypatch, capsys, error, cause, printed
):
    monkeypatch.setattr(program, "_dispatch", raising(error, cause))
    assert run_as_process("status") == 130
    assert capsys.readouterr().err.removeprefix("canopen-control: ") == printed


class Step:
    """Raises a signal at the call of a function, counted from the first one after the signals have handlers."""

    def __init__(self, number, at):
        self.number, self.at, self.count = number, at, 0

    def __call__(self, frame, event, argument):
        if event == "call" and (self.count or frame.f_code is program._run_and_flush.__code__):
            self.count += 1
            if self.count == self.at:
                sys.setprofile(None)
                signal.raise_signal(self.number)


VERBS = [
    ["eds", "show", "TMCM-1270.eds"],
    ["plan", "robby"],
    pytest.param(["bus", "list"], marks=pytest.mark.process, id="bus list"),  # it starts ip
    ["check", "robby"],
]


# a signal within `open` leaves a file that is closed without a message, as Python ignores this warning in programs
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("words", VERBS, ids=" ".join)
@pytest.mark.parametrize("number", NUMBERS)
def test_a_signal_at_any_step_ends_a_verb_without_a_traceback(run_as_process, capsys, words, number):
    program.main(words)  # imports are over: each step is the verb's
    steps = [*range(1, 22), *(round(30 * 1.6**power) for power in range(12))]
    for at in steps:
        step = Step(number, at)
        capsys.readouterr()
        sys.setprofile(step)
        try:
            code = run_as_process(*words)
        except SystemExit as exit_:
            code = exit_.code
        finally:
            sys.setprofile(None)
        err = capsys.readouterr().err
        assert code in (0, 130), (at, code, err)
        assert err == "", at


_INTERRUPTED_IMPORT = """
import os, signal, sys
class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == "canopen_control.cli.verbs":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupts())
sys.argv = ["canopen-control", "--version"]
from canopen_control.__main__ import main
main()
"""


@pytest.mark.process
def test_an_interrupt_while_the_program_is_imported_ends_it_without_a_traceback():
    ended = subprocess.run([sys.executable, "-c", _INTERRUPTED_IMPORT], capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout, ended.stderr) == (-signal.SIGINT, "", "")
