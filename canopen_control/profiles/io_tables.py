"""Signals of generic I/O modules (CiA 401): digital and analogue inputs and outputs, named di0, do0, ai0, ao0, ...

Lines are counted through from 0: bit 3 of 0x6000:02 is di11. The same lines may be grouped by 8, 16 or 32; the first
group that a device has is used. Analogue values are raw numbers, whose full scale is 32767 for 16 bits: which voltage
that is no object says, so `signals` of bus.yml gives a factor and a unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.profiles.device_signal import Signal

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.od.model import ObjectDictionary

__all__ = ["AI_DELTA", "AI_ENABLE", "ANALOGUE_INPUTS", "DIGITAL_INPUTS", "io_signals"]

AI_ENABLE: Final = 0x6423  # no analogue input is sent by an event before it is set
AI_DELTA: Final = 0x6426
DIGITAL_INPUTS: Final = (0x6000, 0x6100, 0x6120)
ANALOGUE_INPUTS: Final = (0x6401, 0x6402, 0x6400, 0x6403)


@dataclass(frozen=True, slots=True)
class _Group:
    """Objects that show the same lines, the usual one first; `lines` per subindex where they are bits."""

    prefix: str
    output: bool
    objects: tuple[tuple[int, int | None], ...]


_GROUPS: Final = (
    _Group("di", output=False, objects=((0x6000, 8), (0x6100, 16), (0x6120, 32))),
    _Group("do", output=True, objects=((0x6200, 8), (0x6300, 16), (0x6320, 32))),
    _Group("ai", output=False, objects=tuple((index, None) for index in ANALOGUE_INPUTS)),
    _Group("ao", output=True, objects=((0x6411, None), (0x6412, None), (0x6410, None), (0x6413, None))),
)


def io_signals(od: ObjectDictionary) -> Iterator[Signal]:
    """Yield the lines of an I/O module."""
    for group in _GROUPS:
        for index, lines in group.objects:
            subindices = [each for each in od.subindices(index) if 1 <= each < 0xFF]
            if not subindices:
                continue
            for subindex in subindices:
                first = (subindex - 1) * (lines or 1)
                for bit in range(lines or 1):
                    name = f"{group.prefix}{first + bit}"
                    yield Signal(name, index, subindex, group.output, bit if lines else None)
            break
