"""The listener of the campaign: one thread receives the bus, another polls shafts whose node is silent on the bus.

What was heard is judged a second later, when everybody has been told what he asked for. The thread wakes every ten
milliseconds whatever the bus does: when it does not, the machine stood still, and that excuses the robot too.
"""

from __future__ import annotations

import contextlib
import select
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Final

from canopen_control.bus.channel import open_port
from canopen_control.client.drive_client import DriveClient
from canopen_control.errors import CanopenError, RemoteError
from canopen_control.frame import frames_of
from canopen_control.rpc.messages.drive import GetDriveState

if TYPE_CHECKING:
    from campaigner.observer import Breach, Command, Enable, Observer, Reason


_LOOK_S: Final = 0.01
_STALL_S: Final = 0.03
_DELAY_S: Final = 1.0
_PROBE_S: Final = 0.05
_TIMEOUT_S: Final = 0.3
_SHOWN_S: Final = 1.5  # time span of frames stored with a breach
_LABEL: Final = "campaign"


class Listener:
    """Receives `channel` until `close`; all access to the observer goes through here, from any thread."""

    def __init__(self, channel: str, observer: Observer) -> None:
        self.channel, self.observer = channel, observer
        self.frames = 0
        self.stalled_s = 0.0
        self.deaf = False  # the bus is closed
        self._lock = threading.Lock()
        self._heard: deque[tuple[float, float, bytes | tuple[int, float]]] = deque()
        self._kept: deque[tuple[float, str]] = deque()
        self._ended = threading.Event()
        self._port = open_port(channel, label=_LABEL)
        self._threads = [
            threading.Thread(target=target, daemon=True) for target in (self._listen, self._look_at_shafts)
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop receiving, and evaluate the remaining frames."""
        self._ended.set()
        for thread in self._threads:
            thread.join(5.0)
        self._judge(float("inf"))
        self._port.close()

    def add(self, fact: Enable | Command | Reason) -> None:
        """Report a fact to the observer."""
        with self._lock:
            self.observer.add(fact)

    def excuse(self, since: float, until: float, node: int = 0) -> None:
        """Report an excuse to the observer."""
        with self._lock:
            self.observer.excuse(since, until, node)

    def forget(self, node: int) -> None:
        """Report to the observer that a node was restarted."""
        with self._lock:
            self.observer.forget(node)

    def powered(self) -> bool:
        """Whether all drives report on the bus that they are enabled."""
        with self._lock:
            now = time.monotonic() - _DELAY_S
            return all(
                self.observer.powered(node) and not self.observer.silent(node, now) for node in self.observer.wire.nodes
            )

    def take_breaches(self) -> list[tuple[Breach, list[str]]]:
        """Return new breaches, each with the preceding frames of its node."""
        with self._lock:
            found = [(breach, self._record(breach)) for breach in self.observer.breaches]
            self.observer.breaches.clear()
        return found

    # ------------------------------------------------------------------------------------------- the bus

    def _listen(self) -> None:
        looked = time.monotonic()
        while not self._ended.is_set():
            self._wait()
            now = time.monotonic()
            if now - looked > _LOOK_S + _STALL_S:
                self.stalled_s += now - looked
                self.excuse(looked, now)
            records = self._receive()
            if records:
                self._heard.append((looked, now, records))
            looked = now
            self._judge(now - _DELAY_S)

    def _wait(self) -> None:
        if self.deaf:
            time.sleep(_LOOK_S)
            return
        with contextlib.suppress(OSError, ValueError):
            select.select([self._port.fileno()], [], [], _LOOK_S)

    def _receive(self) -> bytes:
        if self.deaf:
            with contextlib.suppress(CanopenError, OSError):
                self._port = open_port(self.channel, label=_LABEL)
                self.deaf = False
            return b""
        try:
            return self._port.receive()
        except CanopenError:
            self._port.close()
            self.deaf = True
            return b""

    def _judge(self, until: float) -> None:
        with self._lock:
            while self._heard and self._heard[0][1] <= until:
                early, late, what = self._heard.popleft()
                if isinstance(what, tuple):
                    self._keep(late, f"shaft of node {what[0]}: {what[1]:.0f} (its own word)")
                    self.observer.on_shaft(early, late, *what)
                else:
                    self._judge_records(early, late, what)
            self.observer.prune(until)

    def _judge_records(self, early: float, late: float, records: bytes) -> None:
        wanted = self.observer.wire.fields
        for frame in frames_of(records):
            self.frames += 1
            if frame.can_id in wanted:
                self._keep(late, str(frame))
                self.observer.on_frame(early, late, frame.can_id, frame.data)
            elif frame.can_id == 0 or 0x700 < frame.can_id < 0x780 or 0x80 < frame.can_id < 0x100:
                self._keep(late, str(frame))

    def _keep(self, late: float, text: str) -> None:
        if not self.observer.breaches:  # frames before the first breach
            self._kept.append((late, text))
            while self._kept and self._kept[0][0] < late - _SHOWN_S:
                self._kept.popleft()

    def _record(self, breach: Breach) -> list[str]:
        return [f"{time - breach.time:+.3f} {text}" for time, text in self._kept]

    # ------------------------------------------------------------------------------------------- shafts

    def _look_at_shafts(self) -> None:
        """Query the drives directly, bypassing the bus, while the velocity of a node is not on it."""
        while not self._ended.wait(_PROBE_S):
            for node in self.observer.wire.nodes:
                if self.observer.silent(node, time.monotonic() - _DELAY_S):
                    self._look_at(node)

    def _look_at(self, node: int) -> None:
        early = time.monotonic()
        with contextlib.suppress(RemoteError, OSError, IndexError):
            with DriveClient.connect(self.channel, node, _TIMEOUT_S) as drive:
                velocity = drive.ask(GetDriveState()).axes[0].plant.velocity
            self._heard.append((early, time.monotonic(), (node, velocity)))
