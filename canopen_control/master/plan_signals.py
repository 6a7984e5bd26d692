"""Signals of a device, by its profile and by `signals` in bus.yml, and the objects that the boot writes for them.

Outputs become safe when the master is lost: the error modes (0x6206 and similar) are set so that the outputs change
to their error values (0x6207), which are written too. Outputs that keep their values are reported. Analogue inputs
are enabled for transmission: they cause events only if 0x6423 is set. Values of the `sdo:` list or a file take
precedence. Initial input values and the scaling objects of the device are read.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.pdo import MappedObject
from canopen_control.cia402.objects import MOTION
from canopen_control.errors import nearest
from canopen_control.profiles import (
    AI_DELTA,
    AI_ENABLE,
    ANALOGUE_INPUTS,
    TYPES,
    Signal,
    object_of,
    profile_signals,
    safe_outputs,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.master.keys import SignalKeys
    from canopen_control.master.plan_builder import PlanBuilder
    from canopen_control.od.model import Address, Entry
    from canopen_control.profiles import Profile, SafeOutput


_SMALLEST_CHANGE: Final = 64  # default of the change that causes a message, of 32767
_EVENT_TYPES: Final = (254, 255)
_SAFE: Final = "outputs are safe when the master is lost"


def plan_signals(builder: PlanBuilder, profile: Profile, axes: tuple[int, ...]) -> dict[str, Signal]:
    """Return the signals of a node by name, and plan their writes and reads."""
    signals = profile_signals(builder.od, profile)
    moving = {index + offset for index in MOTION for offset in axes}
    named: set[str] = set()
    for number, keys in enumerate(builder.node.signals):
        if keys.name in named:
            builder.complain(f"signals[{number}].name", f"signal {keys.name!r} is defined twice; use each name once")
        named.add(keys.name)
        signal = _configured(builder, f"signals[{number}]", keys, signals.get(keys.name), tuple(signals))
        if signal is not None and signal.index in moving:
            builder.complain(f"signals[{number}].object", f"{signal.where} moves an axis; only a joint can command it")
        elif signal is not None:
            signals[keys.name] = signal
    _plan_outputs(builder, signals.values())
    _plan_analogue_inputs(builder)
    _plan_reads(builder, signals.values())
    return signals


def _configured(
    builder: PlanBuilder, key: str, keys: SignalKeys, known: Signal | None, names: tuple[str, ...]
) -> Signal | None:
    """Return a signal with the settings of bus.yml, or None if an error was reported."""
    if keys.object is None:
        if known is None:
            text = f"the device profile has no signal {keys.name!r}{nearest(keys.name, names)}; set `object`"
            builder.complain(f"{key}.name", text)
            return None
        signal = known
    else:
        address = _object(builder, f"{key}.object", keys.object)
        if address is None:
            return None
        entry, bit = address
        signal = Signal(keys.name, entry.index, entry.subindex, _is_output(builder, entry), bit)
    fits = [_fits_type(builder, key, keys, signal), _fits_numbers(builder, key, keys, signal)]
    return _with(keys, signal) if all(fits) else None


def _object(builder: PlanBuilder, key: str, text: int | str) -> tuple[Entry, int | None] | None:
    address = (text, 0, None) if isinstance(text, int) else object_of(text)
    if address is None:
        builder.complain(key, f"{text!r} is not an object; write 0x6401:01, or 0x6000:01.3 for bit 3")
        return None
    index, subindex, bit = address
    entry = builder.od.get(index, subindex)
    if entry is None:
        builder.complain(key, f"0x{index:04X}:{subindex:02X} is not in {builder.file}")
    elif (bits := entry.data_type.bits) is None:
        builder.complain(key, f"0x{index:04X}:{subindex:02X} {entry.name} is not a number")
    elif bit is not None and bit >= bits:
        builder.complain(key, f"0x{index:04X}:{subindex:02X} {entry.name} has only bits 0 to {bits - 1}")
    else:
        return entry, bit
    return None


def _is_output(builder: PlanBuilder, entry: Entry) -> bool:
    return entry.address in _mapped_signals(builder, "rpdo")


def _mapped_signals(builder: PlanBuilder, kind: str) -> set[Address]:
    return {(mapped.index, mapped.subindex) for layout in builder.layouts[kind] for mapped in layout.objects}


def _fits_type(builder: PlanBuilder, key: str, keys: SignalKeys, signal: Signal) -> bool:
    entry = builder.od.get(*signal.address)
    data_type = None if keys.type is None else TYPES[keys.type]
    if entry is None or data_type is None or data_type.bits == entry.data_type.bits:
        return True
    builder.complain(f"{key}.type", f"{keys.type} has {data_type.bits} bits, {signal.where} {entry.data_type.bits}")
    return False


def _fits_numbers(builder: PlanBuilder, key: str, keys: SignalKeys, signal: Signal) -> bool:
    wrong = []
    if keys.factor is not None and (keys.factor == 0 or not math.isfinite(keys.factor)):
        wrong.append(("factor", f"{keys.factor:g} cannot be used: expected a finite number other than 0"))
    if keys.offset is not None and not math.isfinite(keys.offset):
        wrong.append(("offset", f"{keys.offset:g} cannot be used: expected a finite number"))
    if keys.safe is not None and not signal.output:
        wrong.append(("safe", f"{signal.name} is an input; only an output has a safe value"))
    elif isinstance(keys.safe, float) and not math.isfinite(keys.safe):
        wrong.append(("safe", f"{keys.safe:g} is not a value: expected a finite number or keep"))
    if keys.max_rate is not None and signal.output:
        wrong.append(("max_rate", f"{signal.name} is an output; only an input has a maximum rate"))
    for name, text in wrong:
        builder.complain(f"{key}.{name}", text)
    return not wrong


def _with(keys: SignalKeys, signal: Signal) -> Signal:
    """Return a signal with the settings of bus.yml; a factor replaces the scaling objects of the device."""
    invalid = () if keys.invalid is None else keys.invalid
    return replace(
        signal,
        factor=signal.factor if keys.factor is None else keys.factor,
        scales=signal.scales if keys.factor is None else (),
        offset=signal.offset if keys.offset is None else keys.offset,
        unit=signal.unit if keys.unit is None else keys.unit,
        data_type=signal.data_type if keys.type is None else TYPES[keys.type],
        invalid=tuple(invalid) if isinstance(invalid, list | tuple) else (invalid,),
        safe=signal.safe if keys.safe is None else None if isinstance(keys.safe, str) else keys.safe,
        max_rate=keys.max_rate,
    )


# -- what the boot writes and reads


def _plan_outputs(builder: PlanBuilder, signals: Iterable[Signal]) -> None:
    """Plan the values of outputs when the master is lost; warn about outputs that would keep their current values."""
    live = _mapped_signals(builder, "rpdo")
    outputs = [safe_output for safe_output in safe_outputs(signals, builder.od) if safe_output.output in live]
    keeping = [output for output in outputs if not _plan_safe(builder, output)]
    if keeping:
        places = ", ".join(f"0x{safe.output[0]:04X}:{safe.output[1]:02X}" for safe in keeping)
        builder.warn(
            "dcf", f"the outputs {places} keep their values when the master is lost: nothing switches them off"
        )


def warn_of_unwatched_outputs(builder: PlanBuilder, signals: Iterable[Signal]) -> None:
    """Warn about outputs of a node that does not detect the loss of the master."""
    live = _mapped_signals(builder, "rpdo")
    if any(safe_output.output in live for safe_output in safe_outputs(signals, builder.od)):
        builder.warn(
            "dcf",
            "the outputs are not switched off when the master is lost: the node has no heartbeat consumer (0x1016)",
        )


def _plan_safe(builder: PlanBuilder, output: SafeOutput) -> bool:
    """Plan the error mode and error value of an output; return False if it would unintentionally keep its value."""
    if output.mode_at is None:
        return not output.mode  # bus.yml requests that all outputs keep their values
    mode = builder.requested_value(*output.mode_at)
    if mode is not None:
        return mode != 0
    builder.write(*output.mode_at, output.mode, "dcf", _SAFE, optional=True)
    if output.value_at is not None and builder.requested_value(*output.value_at) is None and output.mode:
        builder.write(*output.value_at, output.value, "dcf", _SAFE, optional=True)
    return builder.can_write(*output.mode_at) or bool(builder.default(*output.mode_at))


def _plan_analogue_inputs(builder: PlanBuilder) -> None:
    """Plan the event-driven transmission of analogue inputs: 0x6423, and a minimum change if none is set."""
    inputs = [
        mapped.subindex
        for layout in builder.layouts["tpdo"]
        if layout.transmission_type in _EVENT_TYPES and not layout.event_ms
        for mapped in layout.objects
        if mapped.index in ANALOGUE_INPUTS
    ]
    if not inputs:
        return
    if (AI_ENABLE, 0) in builder.od and not builder.is_requested(AI_ENABLE):
        builder.write(AI_ENABLE, 0, 1, "dcf", "analogue inputs are sent when they change", optional=True)
    for subindex in dict.fromkeys(inputs):
        unset = not builder.default(AI_DELTA, subindex) and not builder.is_requested(AI_DELTA)
        if unset and builder.can_write(AI_DELTA, subindex):
            reason = "analogue inputs are sent when they change by 0.2 %"
            builder.write(AI_DELTA, subindex, _SMALLEST_CHANGE, "dcf", reason, optional=True)


def _plan_reads(builder: PlanBuilder, signals: Iterable[Signal]) -> None:
    """Plan reads of the initial values of inputs, and of the scaling and status objects of signals."""
    sent = _mapped_signals(builder, "tpdo")
    addresses: dict[Address, None] = {}
    for signal in signals:
        objects = [*signal.needs, *([] if signal.status is None else [signal.status])]
        if not signal.output and signal.address in sent:
            objects.append(signal.address)
        addresses.update(dict.fromkeys(objects))
    for index, subindex in addresses:
        entry = builder.od.get(index, subindex)
        if entry is not None and entry.readable and (bits := entry.data_type.bits) is not None:
            builder.reads.append(MappedObject(index, subindex, bits, entry.data_type))
