"""A bare listener: receives a bus like any other device, and checks the bytes of every cycle.

It knows nothing of the programs that it judges, only what they are to send. A cycle begins after
a SYNC and ends with the next: first the TPDOs that the SYNC calls for, then the RPDOs, each drive's once. COB-IDs are
those of the predefined connection set (CiA 301, 7.3.3).
"""

from __future__ import annotations

import contextlib
import select
import struct
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.bus.channel import open_port
from canopen_control.frame import CanFrame, frames_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.bus.port import Port


SYNC = 0x080
_PDOS = range(0x180, 0x580, 0x80)
_KINDS = (0x180, 0x280, 0x200, 0x300)  # TPDO 1 and 2, RPDO 1 and 2
_LATEST = 50  # cycles that are looked at together: a machine may be busy that long
ENABLED = 0x27  # statusword & 0x6F in OPERATION ENABLED, CiA 402
_WORD_MODE, _PAIR = struct.Struct("<Hb"), struct.Struct("<ii")
_KEPT = 5


@dataclass(slots=True)
class Verdict:
    """The problems found by the listener; in `late` cycles the TPDOs came after the RPDOs of the next cycle.

    `starved` are those of the mistakes that are TPDOs alone, which did not come for very long: drives without a
    processor on a busy machine, unless it is so every time.
    """

    cycles: int = 0
    late: int = 0
    starved: int = 0
    wrong: list[str] = field(default_factory=list)
    count: int = 0

    def say(self, text: str) -> None:
        """Record a problem; only the first few are kept."""
        self.count += 1
        if len(self.wrong) < _KEPT:
            self.wrong.append(text)


@contextlib.contextmanager
def listening(channel: str) -> Iterator[Callable[[float], list[CanFrame]]]:
    """Join a bus as a listener; yields a function that returns the frames of the next seconds."""
    with contextlib.closing(open_port(channel, label="listener")) as port:
        yield lambda seconds: _hear(port, seconds)


def _hear(port: Port, seconds: float) -> list[CanFrame]:
    frames: list[CanFrame] = []
    end = time.monotonic() + seconds
    while (rest := end - time.monotonic()) > 0:
        if select.select([port], [], [], rest)[0]:
            frames.extend(frames_of(port.receive()))
    if port.stats.lost:
        raise RuntimeError(f"the listener on {port.channel} itself lost {port.stats.lost} frames")
    return frames


def cycles_of(frames: Sequence[CanFrame]) -> list[list[CanFrame]]:
    """Return the PDOs of the complete cycles, without those before the first and after the last SYNC."""
    cycles: list[list[CanFrame]] = []
    for frame in frames:
        if frame.can_id == SYNC:
            cycles.append([])
        elif cycles and frame.can_id & ~0x7F in _PDOS:
            cycles[-1].append(frame)
    return cycles[:-1]


def judge(
    cycles: Sequence[list[CanFrame]], nodes: Sequence[int], expected: Callable[[int, int], Sequence[int]]
) -> Verdict:
    """Check every cycle; `expected(number, position)` are the target velocities allowed for a drive in it.

    Drives that come late answer within the next cycles: those are then looked at together.
    """
    verdict = Verdict(len(cycles))
    number = _first_whole(cycles, nodes)
    while number < len(cycles):
        span = _span(cycles[number:], nodes)
        if span == 0:
            _judge_identifiers(verdict, number, cycles[number], nodes)
            span = 1
        verdict.late += span - 1
        targets = [{value for n in range(number, number + span) for value in expected(n, p)} for p in range(len(nodes))]
        for frame in (frame for cycle in cycles[number : number + span] for frame in cycle):
            _judge_values(verdict, number, frame, nodes, targets)
        number += span
    return verdict


def _first_whole(cycles: Sequence[list[CanFrame]], nodes: Sequence[int]) -> int:
    """Return the number of the first complete cycle: earlier frames may answer a SYNC that was not received."""
    for number, cycle in enumerate(cycles[:_LATEST]):
        if _in_order([frame.can_id for frame in cycle], nodes):
            return number
    return 0


def _span(cycles: Sequence[list[CanFrame]], nodes: Sequence[int]) -> int:
    """Return how many cycles from the first contain together the frames due, or 0 if no small number does."""
    heard: list[int] = []
    for span, cycle in enumerate(cycles[:_LATEST], 1):
        heard += [frame.can_id for frame in cycle]
        if span == 1 and _in_order(heard, nodes):
            return 1
        if span > 1 and Counter(heard) == Counter(_due(nodes) * span):
            return span
    return 0 if len(cycles) >= _LATEST else len(cycles)  # the last cycles' answers may come after what was heard


def _in_order(heard: Sequence[int], nodes: Sequence[int]) -> bool:
    answers = 2 * len(nodes)
    return all(byte & 0x80 for byte in heard[:answers]) and Counter(heard) == Counter(_due(nodes))


def _due(nodes: Sequence[int]) -> list[int]:
    return [kind + node for node in nodes for kind in _KINDS]


def _judge_identifiers(verdict: Verdict, number: int, cycle: Sequence[CanFrame], nodes: Sequence[int]) -> None:
    there, due = Counter(frame.can_id for frame in cycle), Counter(_due(nodes))
    missing, more = due - there, there - due
    words = [", ".join(hex(element) for element in which.elements()) or "none" for which in (missing, more)]
    verdict.say(f"cycle {number}: PDOs missing: {words[0]}; too many: {words[1]}")
    tpdos = {kind + node for node in nodes for kind in _KINDS[:2]}
    verdict.starved += set(missing | more) <= tpdos


def _judge_values(
    verdict: Verdict, number: int, frame: CanFrame, nodes: Sequence[int], targets: Sequence[set[int]]
) -> None:
    """Check the bytes of one PDO; a wrong length is an error too."""
    kind, node, data = frame.can_id & ~0x7F, frame.can_id & 0x7F, frame.data
    if node not in nodes:
        return  # counted by its COB-ID
    if kind == 0x200 and data != _WORD_MODE.pack(0x0F, 3):
        verdict.say(f"cycle {number}: node {node} is sent controlword and mode {data.hex()}, not 0f0003")
    elif kind == 0x180 and (len(data) != _WORD_MODE.size or data[0] & 0x6F != ENABLED or data[2] != 3):
        verdict.say(f"cycle {number}: node {node} says statusword and mode {data.hex()}, not enabled in velocity mode")
    elif kind in (0x280, 0x300) and len(data) != _PAIR.size:
        verdict.say(f"cycle {number}: 0x{frame.can_id:03X} has {len(data)} bytes, not {_PAIR.size}")
    elif kind == 0x300 and (velocity := _PAIR.unpack(data)[1]) not in targets[nodes.index(node)]:
        wanted = sorted(targets[nodes.index(node)])
        verdict.say(f"cycle {number}: node {node} is sent {data.hex()} (velocity {velocity}), not {wanted}")
