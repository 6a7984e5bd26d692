"""Running scope for pages: samples of a node's objects and of joints on a thread, captures for all. No toolkit.

It has connections of its own, so that nothing waits behind it, and writes nothing. It goes on
when the page that began it is closed, since a trigger on a fault may be waited for for days; it keeps `KEPT` shots.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from canopen_control.client import RobotClient
from canopen_control.commissioning.object_rows import READS_PER_S
from canopen_control.commissioning.scope_capture import Condition, ScopeCapture, named_shot, parse_trigger
from canopen_control.commissioning.scope_signals import (
    MOST_SIGNALS,
    RobotSource,
    Signal,
    SignalValues,
    joint_signal_of,
    signal_of,
    statusword_of,
)
from canopen_control.errors import CanopenError, ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.commissioning.live_reader import NodeObjects
    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.commissioning.scope_capture import NamedShot


KEPT: Final = 8  # shots
_LOOK_S: Final = 0.1
_TIMEOUT_S: Final = 2.0


@dataclass(frozen=True, slots=True)
class ScopeForm:
    """Form of a scope: `trigger` as in the verb, "" for none; `rolling` captures repeatedly."""

    signals: tuple[str, ...]
    length: float = 2.0
    trigger: str = ""
    before: float = 0.0
    rolling: bool = False

    def check(self) -> None:
        """Raise ConfigError for invalid input before a request is sent."""
        if not self.signals:
            raise ConfigError("choose what to look at: one signal at least")
        if len(self.signals) > MOST_SIGNALS:
            raise ConfigError(f"{len(self.signals)} signals are too many for one look; {MOST_SIGNALS} at most")
        if self.trigger:
            parse_trigger(self.trigger, len(self.signals))
        self.capture(())

    def capture(self, faults: tuple[int, ...]) -> ScopeCapture:
        """Return its capture memory; `faults` are the columns of statuswords. ConfigError for inconsistent times."""
        trigger = parse_trigger(self.trigger, len(self.signals)) if self.trigger else None
        if trigger is not None and trigger.condition is Condition.FAULT:
            trigger = replace(trigger, places=faults)
        before = 0.0 if trigger is None else self.before
        return ScopeCapture(trigger, length=self.length, before=before, shots=None if self.rolling else 1)


class ScopeRun:
    """Scope run at a node of a running robot; `connect` is for tests."""

    def __init__(
        self, desk: NodeObjects, wish: ScopeForm, connect: Callable[[str, float], RobotClient] = RobotClient.connect
    ) -> None:
        wish.check()
        self.wish = wish
        self.shots: deque[NamedShot] = deque(maxlen=KEPT)
        self.signals: tuple[Signal, ...] = ()
        self.taken = 0
        self.over = False
        self.good = True
        self.words = "begins"
        self._desk, self._connect = desk, connect
        self._ending = threading.Event()

    def start(self) -> None:
        """Start the thread."""
        threading.Thread(target=self.run, name="page scope", daemon=True).start()

    def end(self) -> None:
        """End the run: a capture in progress is kept, a waiting one dropped."""
        self._ending.set()

    def run(self) -> None:
        """Capture until complete or ended; body of the thread."""
        try:
            with self._desk.session() as session, self._connect(self._desk.robot, _TIMEOUT_S) as client:
                self._resolve(session, client)
        except CanopenError as error:
            self.good, self.words = False, str(error)
        except Exception as error:  # noqa: BLE001 - the page shows it and continues
            self.good, self.words = False, f"the scope ended with {type(error).__name__}: {error}"
        finally:
            self.over = True

    def _resolve(self, session: NodeSession, client: RobotClient) -> None:
        self.signals = tuple(joint_signal_of(text) or signal_of(text, session) for text in self.wish.signals)
        extra: list[Signal] = []
        if self.wish.trigger == Condition.FAULT.value:
            extra = [statusword_of(session)]
        count = len(self.signals)
        capture = self.wish.capture(tuple(range(count, count + len(extra))))
        values = SignalValues([*self.signals, *extra])
        source = RobotSource(client, values, {session.node_id: session}, READS_PER_S)
        before = source.cycles()
        while not (capture.done or self._ending.is_set()):
            self.words = capture.state.value
            for moment, row in source.samples(_LOOK_S):
                capture.feed(moment, row)
                if capture.done:
                    break
            capture.tick(time.time())
            self._keep(capture)
        capture.stop()
        self._keep(capture)
        after = source.cycles()
        self.words = (
            f"{self.taken} {'shot' if self.taken == 1 else 'shots'}; the robot made {after[0] - before[0]} cycles "
            f"meanwhile and missed {after[1] - before[1]}"
        )

    def _keep(self, capture: ScopeCapture) -> None:
        for shot in capture.take():
            self.taken += 1
            label = time.strftime("%H:%M:%S", time.localtime(shot.zero))
            self.shots.append(named_shot(shot, self.signals, f"shot of {label}"))
