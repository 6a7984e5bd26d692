"""What outputs do when their master is gone: the objects of error mode and error value (CiA 401, CiA 404).

An output whose mode says so takes its error value when the heartbeat of the master stays away, at NMT stop and when the
device fails; one whose mode says no keeps what it has. Of digital outputs both are bit fields, one bit per line.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from canopen_control.od.model import Address, ObjectDictionary
    from canopen_control.profiles.device_signal import Signal

__all__ = ["ERROR_OBJECTS", "SafeOutput", "has_error_mode", "safe_outputs"]

ERROR_OBJECTS: Final = {
    0x6200: (0x6206, 0x6207),
    0x6300: (0x6306, 0x6307),
    0x6320: (0x6326, 0x6327),
    0x6410: (0x6443, 0x6444),
    0x6411: (0x6443, 0x6444),
    0x6412: (0x6443, 0x6444),
    0x6413: (0x6443, 0x6445),
    0x7300: (0x6340, 0x7341),
}
"""Object of outputs to those of their error mode and error value, which have the same subindices."""


@dataclass(frozen=True, slots=True)
class SafeOutput:
    """What one object of outputs is to be without a master: `mode` and `value` as they are written.

    Their addresses are None where the device has no such object.
    """

    output: Address
    mode_at: Address | None
    value_at: Address | None
    mode: int
    value: float


def safe_outputs(signals: Iterable[Signal], od: ObjectDictionary) -> Iterator[SafeOutput]:
    """Yield the objects of the outputs with the error values that their signals ask for; others are 0."""
    by_object: dict[Address, list[Signal]] = {}
    for signal in signals:
        if signal.output and signal.index in ERROR_OBJECTS:
            by_object.setdefault(signal.address, []).append(signal)
    for address, lines in by_object.items():
        mode_index, value_index = ERROR_OBJECTS[address[0]]
        mode_at, value_at = (mode_index, address[1]), (value_index, address[1])
        mode, value = _of_lines(lines) if lines[0].bit is not None else _of_value(lines[-1], od)
        yield SafeOutput(address, mode_at if mode_at in od else None, value_at if value_at in od else None, mode, value)


def has_error_mode(od: ObjectDictionary, signal: Signal) -> bool:
    """Whether a device can bring an output to a value by itself when its master is gone."""
    return signal.index not in ERROR_OBJECTS or (ERROR_OBJECTS[signal.index][0], signal.subindex) in od


def _of_lines(lines: list[Signal]) -> tuple[int, int]:
    """Return the bit fields of mode and value; of a line with two names the last one counts, which is bus.yml's."""
    safe = {line.bit or 0: line.safe for line in lines}
    mode = sum(1 << bit for bit, value in safe.items() if value is not None)
    return mode, sum(1 << bit for bit, value in safe.items() if value)


def _of_value(line: Signal, od: ObjectDictionary) -> tuple[int, float]:
    if line.safe is None:
        return 0, 0
    entry = od.get(*line.address)
    gain = line.gain({scale.address: scale.assumed for scale in line.scales})
    return 1, line.raw(line.safe, gain, whole=entry is None or entry.data_type.is_integer)
