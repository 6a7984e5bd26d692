"""Inputs of devices that are no drives: from a TPDO or by SDO to a state interface in units, nan while not known.

A value counts from the boot on, which reads it, until the node is lost, its TPDO is overdue (three event timers, or the
SYNCs that bus.yml allows), or the device calls it invalid. An input that only comes when it changes has no age: the
heartbeat decides. What no TPDO carries is asked for by SDO, each object once a second at most.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.od.codec import decode
from canopen_control.profiles.device_signal import retyped

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_client import SdoRequest
    from canopen_control.hardware.interfaces import StateInterface
    from canopen_control.master.cycle import Input, ProcessImage
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.od.model import Address, DataType, Value
    from canopen_control.profiles.device_signal import Signal

__all__ = ["POLL_NS", "InputSignal", "NodeInputs", "RawInput"]

POLL_NS: Final = 1_000_000_000
_POLLED_AGE_NS: Final = 5 * POLL_NS
_SHORTEST_NS: Final = 50_000_000  # frames that come together were not sent together
_STANDSTILL_NS: Final = 500_000_000  # of an input that only comes when it changes


class RawInput:
    """The raw number of one object: `value`, `known` whether it counts now."""

    __slots__ = ("_asked", "_began_with", "_input", "_node", "address", "data_type", "known", "read_at", "value")

    def __init__(self, node: RemoteNode, address: Address, data_type: DataType, mapped: Input | None) -> None:
        self.address, self.data_type = address, data_type
        self.value: Value = 0
        self.known = False
        self.read_at = -1  # of the last answer by SDO, -1: none since the boot
        self._node, self._input = node, mapped
        self._began_with = False
        self._asked = -POLL_NS

    @property
    def polled(self) -> bool:
        """Whether no TPDO carries it."""
        return self._input is None

    @property
    def comes_by_change(self) -> bool:
        """Whether it is sent when it changes and at no other time, so that silence is standstill."""
        return self._input is not None and self._input.pdo.age_limit_ns == 0

    def begin(self, now: int) -> None:
        """Take what the boot has read."""
        presets = {} if self._node.identity is None else self._node.identity.presets
        self._began_with = self.address in presets
        self.read_at = -1
        if self._began_with:
            self.value, self.read_at = presets[self.address], now

    def read(self, now: int) -> None:
        """Look what it is at `now`, the node being there."""
        source = self._input
        if source is None:
            self.known = self.read_at >= 0 and now - self.read_at <= _POLLED_AGE_NS
            return
        pdo = source.pdo
        since = pdo.stamp if pdo.stamp >= 0 else self.read_at
        self.known = since >= 0 and not pdo.overdue and not 0 < pdo.age_limit_ns < now - since
        if pdo.stamp >= 0:
            self.value = source.value

    @property
    def stamp(self) -> int:
        """When the value came, in ns."""
        return self.read_at if self._input is None or self._input.pdo.stamp < 0 else self._input.pdo.stamp

    def poll(self, now: int) -> bool:
        """Ask for it by SDO where it is time to; return whether that was done."""
        if self._input is not None or now - self._asked < POLL_NS:
            return False
        self._asked = now
        self._node.read(*self.address, lambda request: self._answered(request, now))
        return True

    def _answered(self, request: SdoRequest, now: int) -> None:
        if request.error is None:
            try:
                self.value, self.read_at = decode(request.data, self.data_type), now
            except ValueError:
                return


class NodeInputs:
    """The raw inputs of one node, each object once, whoever shows it."""

    def __init__(self, node: RemoteNode, image: ProcessImage) -> None:
        self.node, self._image = node, image
        self._inputs: dict[Address, RawInput] = {}
        self.boots = -1
        self.ready = self.lost = False  # lost: since somebody was told
        self.jumps: list[str] = []  # sentences, until somebody tells them
        self._jumped: dict[str, int] = {}  # signals, by the boot since which that was told

    def of(self, address: Address) -> RawInput:
        """Return the raw input of an object of the dictionary."""
        found = self._inputs.get(address)
        if found is None:
            entry = self.node.od[address]
            mapped = self._image.input(self.node.node_id, *address)
            found = self._inputs[address] = RawInput(self.node, address, entry.data_type, mapped)
        return found

    def read(self, now: int) -> None:
        """Look at all of them."""
        node = self.node
        self.lost |= self.ready and not node.ready
        self.ready = node.ready
        if not node.ready:
            return
        if node.boots != self.boots:
            self.boots = node.boots
            for each in self._inputs.values():
                each.begin(now)
        for each in self._inputs.values():
            each.read(now)

    def tell_jump(self, signal: str, text: str) -> None:
        """Take that a signal jumped: once for each boot, however many interfaces it is shown in."""
        if self._jumped.get(signal) != self.boots:
            self._jumped[signal] = self.boots
            self.jumps.append(text)

    def poll(self, now: int) -> None:
        """Ask for one of those that no TPDO carries."""
        if self.ready:
            for each in self._inputs.values():
                if each.polled and each.poll(now):
                    return


class InputSignal:
    """One signal shown in a state interface."""

    def __init__(self, signal: Signal, state: StateInterface, inputs: NodeInputs) -> None:
        self.signal, self.state = signal, state
        self._inputs = inputs
        self._raw = inputs.of(signal.address)
        self._status = None if signal.status is None else inputs.of(signal.status)
        self._boots = -1
        self._type = None if signal.data_type is self._raw.data_type else signal.data_type
        self._retyped: tuple[Value | None, Value] = (None, 0)
        self._gain = signal.gain({})
        self._range = 0
        self._turned = 0.0
        self._last: float | None = None
        self._before, self._came = math.nan, 0  # what was shown last, and when that came
        self._jumped = False

    def read(self, now: int) -> None:
        """Show the value at `now`, nan where there is none."""
        del now
        inputs, raw = self._inputs, self._raw
        if not inputs.ready or not raw.known or not self._valid():
            self.state.value = math.nan
            self._last = None
            return
        if self._boots != inputs.boots:
            self._renew()
        number = raw.value
        if self._type is not None:
            if number != self._retyped[0]:
                self._retyped = (number, retyped(number, raw.data_type, self._type))
            number = self._retyped[1]
        if isinstance(number, int | float):
            value = self.signal.value(self._unwrapped(number), self._gain)
            self.state.value = math.nan if self.signal.max_rate is not None and self._jumps(value) else value

    def _valid(self) -> bool:
        status = self._status
        return status is None or (status.known and status.value == 0)

    def _renew(self) -> None:
        """Take how the device scales the signal, as its boot has read it."""
        identity = self._inputs.node.identity
        numbers = {} if identity is None else identity.presets
        self._boots, self._gain = self._inputs.boots, self.signal.gain(numbers)
        wraps = numbers.get(self.signal.unwrap, 0) if self.signal.unwrap is not None else 0
        self._range = wraps if isinstance(wraps, int) and wraps > 1 else 0
        self._last = None
        self._before, self._jumped = math.nan, False

    def _jumps(self, value: float) -> bool:
        """Whether the value has changed faster than it can, since the node has booted."""
        stamp, signal = self._raw.stamp, self.signal
        if self._jumped or stamp == self._came:
            return self._jumped
        passed = max(stamp - self._came, _SHORTEST_NS)
        if passed > _STANDSTILL_NS and self._raw.comes_by_change:
            passed = _SHORTEST_NS  # it stood until now, and has not had the whole time for its way
        limit = (signal.max_rate or 0.0) * passed / 1e9
        if abs(value - self._before) > limit:  # false for the first one, which is compared with nan
            self._jumped = True
            text = f"{self.state.name} jumped from {self._before:g} to {value:g} {signal.unit}".rstrip()
            self._inputs.tell_jump(signal.name, f"{text}: it is nan until the node is booted again")
        self._before, self._came = value, stamp
        return self._jumped

    def _unwrapped(self, raw: float) -> float:
        """Return a position without end: what a device counts modulo its total range goes on."""
        if not self._range:
            return raw
        if self._last is None:
            self._turned = 0.0
        else:
            step = raw - self._last
            self._turned -= self._range * round(step / self._range)
        self._last = raw
        return raw + self._turned
