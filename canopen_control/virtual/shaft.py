"""The shaft that a virtual encoder (CiA 406) sits on: the motor of a virtual drive turns it, behind a gear.

A drive in the same process is looked at; one in another process keeps the places of its shafts in a file that both
name, brought up to date at the world's period. What is measured is the load's side: the backlash of a loaded plant is
between it and the motor.
"""

from __future__ import annotations

import fcntl
import math
import os
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol, runtime_checkable

from canopen_control.virtual.diffbase import open_shared
from canopen_control.virtual.plant import LoadedPlant, World
from canopen_control.virtual.wheel import WheelPlant

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from canopen_control.virtual.plant import Plant

__all__ = ["Coupling", "ShaftFile", "ShaftWorld", "load_counts"]

_SLOT: Final = struct.Struct("<Qd")  # 1 where it is known, counts
_AXES: Final = 8


@runtime_checkable
class ShaftWorld(World, Protocol):
    """An engine that knows which encoders sit on which shafts."""

    def shaft(self, node_id: int) -> Callable[[], float | None] | None:
        """Return what tells the place of a node's shaft, in rad (m); None: it sits on none. None in it: not known."""

    def publish(self) -> None:
        """Tell other processes where the shafts are."""


@dataclass(frozen=True, slots=True)
class Coupling:
    """How a motor turns the shaft of an encoder: counts for each motor turn, motor turns for each of the encoder's.

    With a `lead` it is a way in m for each of these turns, of a linear encoder.
    """

    counts_per_revolution: float
    gear: float = 1.0
    reversed: bool = False
    lead: float | None = None

    def place(self, counts: float) -> float:
        """Return where the encoder is when its motor is at `counts`, in rad or m."""
        turns = counts / self.counts_per_revolution / self.gear
        return (-turns if self.reversed else turns) * (self.lead or math.tau)


def load_counts(plant: Plant) -> float:
    """Return where the load of an axis is, in counts of its motor."""
    inner = plant.inner if isinstance(plant, WheelPlant) else plant
    return inner.load_position if isinstance(inner, LoadedPlant) and inner.backlash else inner.position


class ShaftFile:
    """The places of shafts by node id and axis, in a file of several processes; ConfigError where it cannot be had."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: int | None = None

    def put(self, node_id: int, axis: int, counts: float) -> None:
        """Tell where a shaft is."""
        fd = self._open()
        fcntl.flock(fd, fcntl.LOCK_EX)
        try:
            os.pwrite(fd, _SLOT.pack(1, counts), self._place(node_id, axis))
        finally:
            fcntl.flock(fd, fcntl.LOCK_UN)

    def get(self, node_id: int, axis: int) -> float | None:
        """Return where a shaft is, None: nobody has told yet."""
        fd = self._open()
        fcntl.flock(fd, fcntl.LOCK_SH)
        try:
            data = os.pread(fd, _SLOT.size, self._place(node_id, axis))
        finally:
            fcntl.flock(fd, fcntl.LOCK_UN)
        known, counts = _SLOT.unpack(data.ljust(_SLOT.size, b"\0"))
        return float(counts) if known == 1 and math.isfinite(counts) else None

    def close(self) -> None:
        """Let go of the file."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _place(self, node_id: int, axis: int) -> int:
        return (node_id * _AXES + axis) * _SLOT.size

    def _open(self) -> int:
        if self._file is None:
            self._file = open_shared(self._path)
        return self._file
