"""Outputs of devices that are no drives: from command interfaces to the RPDOs that carry them.

An output is never restored: when its node was lost or has restarted, what stands commanded counts no more, and the
output stays as the device has it (its error value, its default) until another value is commanded. It is sent when it is
commanded first and when it changes. Released by its controller it goes where that says, else it takes its safe value,
unless it is to keep what it has.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from canopen_control.hardware.interfaces import CommandInterface
    from canopen_control.master.cycle import Output
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.od.model import Entry
    from canopen_control.profiles.device_signal import Signal

__all__ = ["OutputSignal"]

_HALF: Final = 0.5


class OutputSignal:
    """One signal that is commanded; `output` is the object in the RPDOs, `entry` what the dictionary says of it."""

    def __init__(
        self,
        signal: Signal,
        command: CommandInterface,
        output: Output,
        node: RemoteNode,
        *,
        keeps: bool = False,
    ) -> None:
        self.signal, self.command = signal, command
        self._output, self._node = output, node
        entry = node.od[signal.address]
        self._whole = entry.data_type.is_integer
        self._lowest, self._highest = _bounds(entry)
        self._boots = -1
        self._gain = signal.gain({})
        self._void = math.nan  # what stood commanded when the node was not there
        self._commanded = math.nan  # what was sent last
        self.void = False  # its node was lost while it was commanded, and nobody has commanded it since
        command.enabled = False
        command.safe = math.nan if keeps or signal.safe is None else signal.safe
        command.lowest, command.highest = self._span()

    @property
    def commanded(self) -> bool:
        """Whether somebody has commanded it since its node was there."""
        return not math.isnan(self._commanded)

    def write(self) -> None:
        """Send what was commanded anew."""
        command, node = self.command, self._node
        value = command.value
        if not node.ready or node.boots != self._boots:
            self._away(value)
            return
        if math.isnan(value):
            self._void = math.nan  # the next one is new
        elif value != self._commanded and value != self._void and not math.isinf(value):
            first = math.isnan(self._commanded)
            self._void, self._commanded, self.void = math.nan, value, False
            self._send(value, always=first)

    def release(self) -> None:
        """Take the safe value, or that of the controller that lets go, being commanded by nobody any more."""
        self.command.value = math.nan
        commanded, self._commanded, self.void = self._commanded, math.nan, False
        told, self.command.let_go_at = self.command.let_go_at, None
        safe = self.command.safe if told is None else told
        if not math.isnan(commanded) and safe is not None and not math.isnan(safe) and self._node.ready:
            self._send(safe, always=False)

    def _away(self, value: float) -> None:
        """Void what is commanded while the node is not there; take how it is scaled when it is back."""
        self.void |= self.commanded
        self._commanded, self._void = math.nan, value
        self.command.value = math.nan  # a controller that goes on writes what it did before, which is void
        self.command.enabled = self._node.ready
        if self._node.ready:
            identity = self._node.identity
            self._boots = self._node.boots
            self._gain = self.signal.gain({} if identity is None else identity.presets)
            self.command.lowest, self.command.highest = self._span()

    def _span(self) -> tuple[float, float]:
        """Return the least and the greatest value that the object can hold."""
        if self.signal.bit is not None:
            return 0.0, 1.0
        ends = [self.signal.value(raw, self._gain) for raw in (self._lowest, self._highest)]
        return min(ends), max(ends)

    def _send(self, value: float, *, always: bool) -> None:
        output, signal = self._output, self.signal
        if signal.bit is not None:
            mask = 1 << signal.bit
            raw: float = int(output.value) | mask if value > _HALF else int(output.value) & ~mask
        else:
            raw = min(max(signal.raw(value, self._gain, whole=self._whole), self._lowest), self._highest)
        if always or raw != output.value:
            output.write(raw)


def _bounds(entry: Entry) -> tuple[float, float]:
    """Return what an object can hold by its type."""
    if entry.data_type.is_integer:
        return entry.data_type.minimum, entry.data_type.maximum
    return (-3.4e38, 3.4e38) if entry.data_type is DataType.REAL32 else (-1.7e308, 1.7e308)
