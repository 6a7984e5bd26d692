"""Jog loop: turns key presses into commands, shows samples on a status line, and stops the drive at the end.

Each command ends with this connection (`dead_man`), and every exit from `run` requests the stop and waits until the
drive is disabled. The output to the terminal never affects the motion.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import sys
import termios
import time
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from canopen_control.client import RobotClient
from canopen_control.client.teleop_keys import KeyDecoder
from canopen_control.commissioning.driven_axis import (
    ENABLE_S,
    PERIOD_S,
    AxisCommand,
    DriveCurrent,
    axis_reading,
    choose_mode,
    ended_words,
    stop_drive,
)
from canopen_control.commissioning.jog_motion import HELP, JogEnd, JogKind, JogMotion
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.signals import INTERRUPTED, SuspensionWatch, on_signals
from canopen_control.rpc.messages.robot import AxisRequest, Subscribe
from canopen_control.rpc.messages.state import StateSample

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from canopen_control.commissioning.driven_axis import JogDrive
    from canopen_control.commissioning.jog_motion import JogLimits
    from canopen_control.commissioning.quantity import JogScale


# Terminal in raw mode that passes single keys, and is restored at the end.
#
# Canonical mode, echo, signals and flow control of the terminal are off while keys are read, so that Ctrl-C, Ctrl-Z and
# Ctrl-S arrive as keys: none of them may leave a robot moving. Terminals with xterm's mode 1004 report when they lose
# the focus. A closed terminal (SIGHUP) counts as the end of input.


_FOCUS_ON: Final = "\x1b[?1004h"
_FOCUS_OFF: Final = "\x1b[?1004l"
_CHUNK: Final = 1024


class Keyboard:
    """Context manager that reads keys from standard input; raises ConfigError if it is not a terminal.

    `ended` is True when no more input can arrive: after end of file, SIGTERM (`terminated`) or SIGHUP.
    """

    def __init__(self) -> None:
        self.ended = self.terminated = False
        self._fd = -1
        self._saved: list[Any] = []
        self._signals = contextlib.ExitStack()

    def __enter__(self) -> Keyboard:
        if not sys.stdin.isatty():
            raise ConfigError("standard input is not a terminal, so keys cannot be read; run this in a terminal")
        self._fd = sys.stdin.fileno()
        self._saved = termios.tcgetattr(self._fd)
        self._signals.enter_context(on_signals((signal.SIGHUP,), self._end))
        self._signals.enter_context(on_signals((signal.SIGTERM,), self._terminate))
        changed = termios.tcgetattr(self._fd)
        changed[0] &= ~(termios.IXON | termios.ICRNL)
        changed[3] &= ~(termios.ICANON | termios.ECHO | termios.ISIG | termios.IEXTEN)
        changed[6][termios.VMIN], changed[6][termios.VTIME] = 1, 0
        termios.tcsetattr(self._fd, termios.TCSADRAIN, changed)
        self._write_terminal(_FOCUS_ON)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._write_terminal(_FOCUS_OFF)
        with contextlib.suppress(OSError, termios.error):  # the terminal was closed: nothing is left to restore
            termios.tcsetattr(self._fd, termios.TCSAFLUSH, self._saved)
        self._signals.close()

    def read(self, timeout: float) -> bytes:
        """Return the input that arrives within `timeout` s, or b""."""
        if self.ended or not select.select([self._fd], [], [], max(timeout, 0.0))[0]:
            return b""
        try:
            data = os.read(self._fd, _CHUNK)
        except OSError:  # EIO: the other side of the terminal is closed
            data = b""
        if not data:
            self.ended = True
        return data

    def _end(self) -> None:
        self.ended = True

    def _terminate(self) -> None:
        self.ended = self.terminated = True

    def _write_terminal(self, sequence: str) -> None:
        """Print a control sequence if standard output is a terminal."""
        with contextlib.suppress(OSError, ValueError):
            if sys.stdout.isatty():
                sys.stdout.write(sequence)
                sys.stdout.flush()


_SOURCE: Final = "jog"
_RATE_HZ: Final = 50.0
_ENDING: Final = {
    JogEnd.INTERRUPTED: (signal.SIGINT, signal.SIGTERM),
    JogEnd.TERMINAL_CLOSED: (signal.SIGHUP,),
}
SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def reset_fault(drive: JogDrive) -> str:
    """Reset the fault of a drive, which stays disabled.

    Raise CanopenError if the drive has no fault, or if the cause of the fault remains.
    """
    with RobotClient.connect(drive.robot) as client:
        client.ask(AxisRequest(action="fault-reset", node=drive.node, joint=drive.joint, source=_SOURCE), ENABLE_S)
    return f"{drive.title}: the fault is reset; the drive stays disabled"


class JogRun:
    """Jog of one drive, from enabling to disabling; `ended` and `travelled` are the result."""

    def __init__(
        self, drive: JogDrive, scale: JogScale, kind: JogKind, value: float, limits: JogLimits, seconds: float | None
    ) -> None:
        self._drive, self._scale, self._kind = drive, scale, kind
        self._value, self._limits, self._seconds = value, limits, seconds
        self._sender = AxisCommand(drive, kind.value, _SOURCE)
        self._sample: StateSample | None = None
        self._current = DriveCurrent(drive)
        self._suspension = SuspensionWatch()
        self._left = JogEnd.NONE  # ended by a signal, without a terminal
        self.ended = JogEnd.NONE
        self.travelled = 0.0  # rad

    def run(self) -> int:
        """Run the jog from enabling to disabling; return the exit code; raise CanopenError if the drive failed."""
        with contextlib.ExitStack() as stack:
            client = stack.enter_context(RobotClient.connect(self._drive.robot))
            keyboard = stack.enter_context(Keyboard()) if sys.stdin.isatty() else None
            if keyboard is None:
                for end, numbers in _ENDING.items():
                    stack.enter_context(on_signals(numbers, partial(self._leave, end)))
            stack.enter_context(self._suspension)
            try:
                motion = self._begin(client)
                self._move(client, keyboard, motion)
            finally:
                stop_drive(client, self._drive, _SOURCE)
        self.ended, self.travelled = motion.ended, motion.travelled
        with contextlib.suppress(OSError, ValueError):  # the terminal may be closed
            done = "" if motion.ended is JogEnd.STATE else ": stopped and disabled"  # unknown of a lost drive
            print(f"\n{motion.ended.value}{done}", flush=True)
        if motion.ended is JogEnd.STATE:
            raise CanopenError(f"{self._drive.title}: {ended_words(self._sample, self._drive)}")
        if motion.ended.failed:
            return 1
        if motion.ended is JogEnd.INTERRUPTED:
            return INTERRUPTED
        # a jog that a lost terminal ended may have been too short for a new position
        text = None if motion.ended is JogEnd.TERMINAL_CLOSED else motion.nothing_turned(self._scale.resolution)
        if text is not None:
            raise CanopenError(f"{self._drive.title}: {text}")
        return 0

    def _leave(self, why: JogEnd) -> None:
        self._left = why

    def _begin(self, client: RobotClient) -> JogMotion:
        """Set the mode of operation, enable the drive, and return the motion, which starts now."""
        node, joint = self._drive.node, self._drive.joint
        if self._drive.mode:
            choose_mode(
                client, AxisRequest(action="mode", node=node, joint=joint, mode=self._drive.mode, source=_SOURCE)
            )
        client.ask(AxisRequest(action="enable", node=node, joint=joint, source=_SOURCE), ENABLE_S)
        client.ask(Subscribe(state_rate=_RATE_HZ))
        motion = JogMotion(self._kind, self._value, self._limits, seconds=self._seconds, now=time.monotonic_ns())
        if motion.by_keys:
            print(HELP, flush=True)
        return motion

    def _move(self, client: RobotClient, keyboard: Keyboard | None, motion: JogMotion) -> None:
        decoder, line = KeyDecoder(), _Line()
        while motion.ended is JogEnd.NONE:
            self._suspension.renew()
            now = time.monotonic_ns()
            self._take_keys(keyboard, decoder, motion, now)
            if (end := self._outside_end(keyboard)) is not JogEnd.NONE:
                motion.end(end)
            if end is JogEnd.SUSPENDED:
                break  # the robot has ended the command: send no other
            motion.tick(time.monotonic_ns())
            self._check_sample(client, motion)
            self._command(client, motion)
            if self._sample is not None:
                line.show(lambda: self._words(motion))

    def _outside_end(self, keyboard: Keyboard | None) -> JogEnd:
        """Return the external reason to end the jog (suspension, signal or lost terminal), or JogEnd.NONE."""
        if self._suspension.seconds:
            return JogEnd.SUSPENDED
        if keyboard is None or not keyboard.ended:
            return self._left
        return JogEnd.INTERRUPTED if keyboard.terminated else JogEnd.TERMINAL_CLOSED

    def _take_keys(self, keyboard: Keyboard | None, decoder: KeyDecoder, motion: JogMotion, now: int) -> None:
        if keyboard is None:
            time.sleep(PERIOD_S)
            return
        data = keyboard.read(PERIOD_S)
        now = time.monotonic_ns()
        for key in decoder.feed(data, now) if data else decoder.tick(now):
            motion.key(key, now)

    def _check_sample(self, client: RobotClient, motion: JogMotion) -> None:
        """Pass the latest sample and the drive's current to the motion."""
        for message in client.messages(0):
            if isinstance(message, StateSample):
                self._sample = message
        self._current.ask(client)
        if self._sample is not None:
            joint = self._sample.joints.get(self._drive.joint)
            axis = axis_reading(self._sample, self._drive)
            enabled = axis is None or axis.enabled
            motion.see(
                None if joint is None else joint.position,
                None if joint is None else joint.velocity,
                self._current.value,
                enabled=enabled,
            )

    def _command(self, client: RobotClient, motion: JogMotion) -> None:
        """Send the value that the motion commands; end the motion if the robot does not accept it."""
        value = motion.command
        if value is not None and not self._sender.send(client, value):
            motion.end(JogEnd.STATE)

    def _words(self, motion: JogMotion) -> str:
        axis = axis_reading(self._sample, self._drive)
        joint = None if self._sample is None else self._sample.joints.get(self._drive.joint)
        words = [(axis.state if axis is not None and axis.state else "no state").replace("_", " ")]
        if joint is not None and joint.velocity is not None:
            words.append(self._scale.velocity_words(joint.velocity))
        if not math.isnan(motion.travelled):
            words.append(f"at {self._scale.position_words(motion.travelled)}")
        words.append("current unknown" if self._current.value is None else f"current {self._current.value / 10:.1f} %")
        errors = axis.error if axis is not None and axis.error else "no error"
        return ", ".join([*words, errors]) + (f": {motion.note}" if motion.note else "")


class _Line:
    """Status line: rewritten ten times a second on a terminal, otherwise one line per second."""

    def __init__(self) -> None:
        self._live = sys.stdout.isatty()
        self._period = 0.1 if self._live else 1.0
        self._shown = 0.0

    def show(self, words: Callable[[], str]) -> None:
        """Print the text returned by `words` if a new line is due."""
        now = time.monotonic()
        if now - self._shown < self._period:
            return
        self._shown = now
        with contextlib.suppress(OSError, ValueError):
            print(f"\r{words()}\x1b[K" if self._live else words(), end="" if self._live else "\n", flush=True)
