"""Scope for the command line and for pages: selects signals by name, samples them and yields captures."""

from __future__ import annotations

import threading
import time
from collections import deque
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canopen_control.client import RobotClient
from canopen_control.commissioning.scope_capture import Condition, ScopeCapture, named_shot, parse_trigger
from canopen_control.commissioning.scope_signals import (
    MAX_SIGNALS,
    PolledSource,
    RobotSource,
    SignalValues,
    joint_signal_of,
    node_of,
    signal_of,
    statusword_of,
)
from canopen_control.errors import CanopenError, ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from canopen_control.commissioning.jobs import ScopeOptions
    from canopen_control.commissioning.live_reader import NodeObjects
    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.commissioning.scope_capture import NamedShot, Shot
    from canopen_control.commissioning.scope_signals import ScopeSource, Signal


KEPT: Final = 8  # maximum number of stored captures
_SAMPLE_S: Final = 0.1
_TIMEOUT_S: Final = 2.0


def capture_of(options: ScopeOptions, signals: int, faults: int = 0) -> ScopeCapture:
    """Return the capture memory for a number of signals; raise ConfigError for invalid options.

    For a trigger on faults the signals are followed by `faults` statuswords.
    """
    if not signals:
        raise ConfigError("choose at least one signal")
    if signals > MAX_SIGNALS:
        raise ConfigError(f"{signals} signals are too many for a capture; choose at most {MAX_SIGNALS}")
    if options.before is not None and not options.trigger:
        raise ConfigError("--before requires --trigger")
    trigger = parse_trigger(options.trigger, signals) if options.trigger else None
    if trigger is not None and trigger.condition is Condition.FAULT:
        trigger = replace(trigger, places=tuple(range(signals, signals + faults)))
    before = 0.0 if trigger is None else options.length / 5 if options.before is None else options.before
    return ScopeCapture(trigger, length=options.length, before=before, shots=None if options.rolling else options.shots)


class Scope:
    """Scope of the signals named by `texts`; raises ConfigError for an unknown signal.

    `sessions` are the sessions of the named nodes, `client` is connected to the robot, None on a bare bus.
    """

    def __init__(
        self,
        texts: Sequence[str],
        sessions: Mapping[str, NodeSession],
        client: RobotClient | None,
        options: ScopeOptions,
    ) -> None:
        joints = [joint_signal_of(text) for text in texts]
        if client is None and any(joints):
            raise ConfigError("joints exist only in a running robot; on a bare bus give objects: NODE:OBJECT")
        self.signals: list[Signal] = [
            joint or signal_of(text, sessions[node_of(text)]) for text, joint in zip(texts, joints, strict=True)
        ]
        by_id = {session.node_id: session for session in sessions.values()}
        faults = [statusword_of(session) for session in by_id.values()] if options.trigger == _FAULT else []
        if options.trigger == _FAULT and not faults:
            raise ConfigError("a trigger on faults needs a signal of a drive; add NODE:0x6041")
        self.capture = capture_of(options, len(texts), len(faults))
        self.values = SignalValues([*self.signals, *faults])
        self._source: ScopeSource = (
            PolledSource(self.values, by_id, options.rate)
            if client is None
            else RobotSource(client, self.values, by_id, options.rate)
        )
        self._before = self._source.cycles()

    def captures(self, ended: Callable[[], bool]) -> Iterator[list[Shot]]:
        """Yield the new captures repeatedly until all are complete or `ended` returns True.

        A capture in progress is then completed with the samples so far; samples before a trigger are dropped.
        """
        while not (self.capture.done or ended()):
            for moment, row in self._source.samples(_SAMPLE_S):
                self.capture.feed(moment, row)
                if self.capture.done:
                    break
            self.capture.tick(time.time())
            yield self.capture.take()
        self.capture.stop()
        yield self.capture.take()

    def cycle_words(self) -> str:
        """Return the numbers of the robot's cycles and missed cycles since the start as text, or "" without a robot."""
        after = self._source.cycles()
        if self._before is None or after is None:
            return ""
        return f"{after[0] - self._before[0]} cycles of the robot, {after[1] - self._before[1]} missed"


_FAULT: Final = Condition.FAULT.value


class ScopeRun:
    """Scope at a node of a running robot, shared by all pages; tests can replace `connect`.

    The scope has its own connection and writes nothing. It continues when the page that started it is closed, since a
    trigger may occur days later. The last `KEPT` captures are stored.
    """

    def __init__(
        self,
        desk: NodeObjects,
        texts: Sequence[str],
        options: ScopeOptions,
        connect: Callable[[str, float], RobotClient] = RobotClient.connect,
    ) -> None:
        capture_of(options, len(texts))
        self.texts, self.options = tuple(texts), options
        self.shots: deque[NamedShot] = deque(maxlen=KEPT)
        self.signals: Sequence[Signal] = ()
        self.captures = 0
        self.over, self.good = False, True
        self.words = "starting"
        self._desk, self._connect = desk, connect
        self._ending = threading.Event()

    def start(self) -> None:
        threading.Thread(target=self.run, name="page scope", daemon=True).start()

    def end(self) -> None:
        """Request the end and complete the capture in progress; samples before a trigger are dropped."""
        self._ending.set()

    def run(self) -> None:
        """Capture until complete or ended; runs on the scope's thread."""
        try:
            with ExitStack() as stack:
                session = stack.enter_context(self._desk.session())
                client = stack.enter_context(self._connect(self._desk.robot, _TIMEOUT_S))
                nodes = (node_of(text) for text in self.texts if joint_signal_of(text) is None)
                self._capture(
                    Scope(self.texts, dict.fromkeys([*nodes, str(session.node_id)], session), client, self.options)
                )
        except CanopenError as error:
            self.good, self.words = False, str(error)
        except Exception as error:  # noqa: BLE001 - the page shows it and continues
            self.good, self.words = False, f"the scope ended with {type(error).__name__}: {error}"
        finally:
            self.over = True

    def _capture(self, scope: Scope) -> None:
        self.signals = scope.signals
        for shots in scope.captures(self._ending.is_set):
            self.words = scope.capture.state.value
            for shot in shots:
                self.captures += 1
                label = time.strftime("%H:%M:%S", time.localtime(shot.zero))
                self.shots.append(named_shot(shot, self.signals, f"shot of {label}"))
        self.words = f"{self.captures} {'capture' if self.captures == 1 else 'captures'}; {scope.cycle_words()}"
