"""Where a scope's samples come from: TPDOs of a running robot, each cycle, and SDO for what none carries.

The law of this file: what a TPDO carries costs nothing and comes at the rate of SYNC; what is polled goes one object at
a time, through a robot no faster than `READS_PER_S` in all, so that nothing of the robot waits for a scope.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.errors import CanopenError, ConfigError
from canopen_control.rpc.messages.robot import GetStatus, ProcessData, Subscribe
from canopen_control.rpc.messages.state import StateSample
from canopen_control.service.node_session import is_abort
from canopen_control.service.object_rows import READS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from canopen_control.client import RobotClient
    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.scope_signals import ScopeSignal, SignalValues

__all__ = ["PolledSource", "RobotSource", "ScopeSource"]


_EVERY_CYCLE: Final = 1000.0  # Hz


class ScopeSource(Protocol):
    """Whoever brings samples; times in Unix seconds."""

    def samples(self, seconds: float) -> Iterator[tuple[float, tuple[float | None, ...]]]:
        """Yield what comes within `seconds`, at most."""

    def cycles(self) -> tuple[int, int] | None:
        """Return how many cycles a robot has made, and how many it has missed; None where there is no robot."""


class PolledSource:
    """Reads every signal by SDO, `rate` times a second as far as the node answers so fast."""

    def __init__(self, values: SignalValues, sessions: Mapping[int, NodeSession], rate: float) -> None:
        self._values, self._sessions = values, sessions
        self._period = 1.0 / rate
        self._due = time.monotonic()

    def cycles(self) -> None:
        """Return nothing: a bare bus has no cycle."""
        return

    def samples(self, seconds: float) -> Iterator[tuple[float, tuple[float | None, ...]]]:
        """Read all signals when it is time."""
        wait = self._due - time.monotonic()
        if wait > 0:
            time.sleep(min(wait, seconds))
            if wait > seconds:
                return
        self._due = max(self._due + self._period, time.monotonic() - self._period)
        for signal in self._values.objects:
            read_signal(self._values, self._sessions[signal.node_id], signal)
        yield time.time(), self._values.row


class RobotSource:
    """Listens to the TPDOs of a running robot; signals that none has brought yet are polled among them."""

    def __init__(
        self, client: RobotClient, values: SignalValues, sessions: Mapping[int, NodeSession], rate: float
    ) -> None:
        self._client, self._values, self._sessions = client, values, sessions
        self._ids = {session.name: node_id for node_id, session in sessions.items()}
        self._polled = {signal.key: signal for signal in values.objects}
        self._period = 1.0 / min(rate, READS_PER_S)
        self._due = time.monotonic() + self._period  # the first message has all that TPDOs carry
        if values.joints:
            known = client.ask(GetStatus()).joints
            if missing := [joint for joint in values.joints if joint not in known]:
                raise ConfigError(f"robot {client.robot} has no joint {missing[0]!r}; its joints: {', '.join(known)}")
        client.ask(Subscribe(pdos=bool(values.objects), state_rate=_EVERY_CYCLE if values.joints else None))

    def cycles(self) -> tuple[int, int]:
        """Return how many cycles the robot has made, and how many it has missed."""
        cycle = self._client.ask(GetStatus()).cycle
        return cycle.count, cycle.missed

    @property
    def polled(self) -> list[ScopeSignal]:
        """The signals that no TPDO has brought."""
        return list(self._polled.values())

    def samples(self, seconds: float) -> Iterator[tuple[float, tuple[float | None, ...]]]:
        """Yield a sample for each cycle in which something changed, and for each that was polled."""
        wait = min(seconds, max(self._due - time.monotonic(), 0.0)) if self._polled else seconds
        end = time.monotonic() + wait
        for message in self._client.messages(wait):
            if (isinstance(message, ProcessData) and self._take(message)) or (
                isinstance(message, StateSample) and self._values.put_joints(message.joints)
            ):
                yield message.time, self._values.row
            if time.monotonic() >= end:
                break
        if self._polled and time.monotonic() >= self._due:
            yield from self._poll()

    def _take(self, message: ProcessData) -> bool:
        taken = False
        for name, mapped in message.nodes.items():
            node_id = self._ids.get(name)
            for each in mapped if node_id is not None else ():
                if self._values.put(node_id or 0, each.index, each.subindex, each.data):
                    self._polled.pop((node_id or 0, each.index, each.subindex), None)
                    taken = True
        return taken

    def _poll(self) -> Iterator[tuple[float, tuple[float | None, ...]]]:
        """Read one of those that no TPDO carries, in turn."""
        self._due = time.monotonic() + self._period
        key, signal = next(iter(self._polled.items()))
        self._polled[key] = self._polled.pop(key)
        read_signal(self._values, self._sessions[signal.node_id], signal)
        yield time.time(), self._values.row


def read_signal(values: SignalValues, session: NodeSession, signal: ScopeSignal) -> None:
    """Read a signal by SDO; one that the node refuses has no value."""
    try:
        data = session.read(signal.index, signal.subindex)
    except CanopenError as error:
        if not is_abort(error):
            raise
        data = b""
    values.put(signal.node_id, signal.index, signal.subindex, data)
