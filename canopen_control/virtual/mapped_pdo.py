"""One PDO of a node as its records map it: what an RPDO brings to whom, and where the values of a TPDO come from."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

from canopen_control.cia301.pdo import PdoCodec, PdoParameters
from canopen_control.cia301.rpdo import RpdoConsumer
from canopen_control.cia301.tpdo import TpdoProducer
from canopen_control.cia402 import objects as o
from canopen_control.errors import LocalProtocolError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from canopen_control.cia301.rpdo import RpdoEventKind
    from canopen_control.od.model import Address, Entry, Value

__all__ = ["Axis", "Concern", "MappedRpdo", "MappedTpdo", "concerns_of"]


class Axis(Protocol):
    """What process data ask of an axis."""

    def advance(self, now: int) -> None:
        """Bring the axis to `now`."""

    def refresh(self, now: int, *, controlword: bool = False, set_point: bool = False) -> None:
        """Act on objects that were written."""

    @property
    def set_point(self) -> int:
        """The object whose RPDOs are set-points of the active mode, 0: none."""

    def set_point_received(self, now: int, *, overwrites: bool) -> None:
        """Note that an RPDO with a set-point arrived, and whether it replaces one that waits."""

    def set_point_missed(self) -> None:
        """Note that a SYNC came without a set-point."""


class Concern(NamedTuple):
    """An axis that an RPDO writes to: whether its controlword, and which other objects as those of axis 0."""

    axis: Axis
    controlword: bool
    objects: frozenset[int]


class MappedRpdo:
    """One RPDO: what its bytes are, and whom they concern."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.codec = PdoCodec(())
        self.entries: tuple[Entry | None, ...] = ()  # None: a gap
        self.consumer = RpdoConsumer(PdoParameters(0, enabled=False), 0)
        self.wrong: set[RpdoEventKind] = set()  # of what came last
        self.set_points: tuple[tuple[int, int], ...] = ()  # axis, and object of axis 0
        self.cyclic = False  # expected at every SYNC
        self.concerns: tuple[Concern, ...] = ()  # the axes, where nobody else looks at its objects
        self.by_values = False  # whether the values alone decide what is taken
        self.applied = b""  # what was taken last as a whole, and the version of the values since
        self.version = -1


class MappedTpdo:
    """One TPDO: where its values come from, and the bytes last sampled."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.codec = PdoCodec(())
        self.sources: tuple[Callable[[], Value], ...] = ()
        self.mapped: tuple[Address, ...] = ()
        self.moving = False
        self.last = b""
        self.producer = TpdoProducer(PdoParameters(0, enabled=False), self.sample)

    def sample(self) -> bytes:
        """Return the packed present values."""
        try:
            self.last = self.codec.pack([source() for source in self.sources])
        except LocalProtocolError:  # a file that maps an object narrower than its type
            self.last = bytes(self.codec.length)
        return self.last

    def changed_since(self, before: bytes) -> list[Address]:
        """Return the objects whose values are others than when it was sampled as `before`."""
        if len(before) != len(self.last) or len(self.mapped) != len(self.codec.objects):
            return list(self.mapped)
        pairs = zip(self.codec.unpack(before), self.codec.unpack(self.last), strict=True)
        return [address for address, (old, new) in zip(self.mapped, pairs, strict=True) if old != new]


def concerns_of(entries: Iterable[Entry | None], axes: Mapping[int, Axis]) -> tuple[Concern, ...]:
    """Return the axes that an RPDO writes to, in the order of its objects; none where others hear of an object too."""
    bases: dict[int, set[int]] = {}
    for entry in entries:
        if entry is None:  # a gap
            continue
        base, axis = o.axis_of(entry.index)
        if axis not in axes or base < 0x6000:
            return ()
        bases.setdefault(axis, set()).add(base)
    return tuple(Concern(axes[axis], o.CONTROLWORD in found, frozenset(found)) for axis, found in bases.items())
