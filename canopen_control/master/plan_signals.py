"""The signals of a device that is no drive: its profile's and those of `signals` in bus.yml, and what its boot writes.

Outputs are made safe without the master: their error modes (0x6206 and its like) say that they take their error values
(0x6207), which are written too. Analogue inputs are made to be sent: by events they only are once 0x6423 is set. What
the `sdo:` list or a file writes is left to them. What the inputs begin with, and how the device scales them, is read.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.pdo import MappedObject
from canopen_control.cia402.objects import MOTION
from canopen_control.errors import nearest
from canopen_control.profiles.device_signal import TYPES, Signal, object_of
from canopen_control.profiles.error_modes import safe_outputs
from canopen_control.profiles.io_tables import AI_DELTA, AI_ENABLE, ANALOGUE_INPUTS
from canopen_control.profiles.profile_tables import profile_signals

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.master.keys import SignalKeys
    from canopen_control.master.plan_builder import PlanBuilder
    from canopen_control.od.model import Address, Entry
    from canopen_control.profiles.device_type import Profile
    from canopen_control.profiles.error_modes import SafeOutput

__all__ = ["plan_signals", "warn_of_unwatched_outputs"]

_SMALLEST_CHANGE: Final = 64  # of 32767, where neither the file nor the user says which change is worth a message
_EVENT_TYPES: Final = (254, 255)
_SAFE: Final = "outputs are safe when the master dies"


def plan_signals(builder: PlanBuilder, profile: Profile, axes: tuple[int, ...]) -> dict[str, Signal]:
    """Return the signals of a node by name, and plan what they need."""
    signals = profile_signals(builder.od, profile)
    moving = {index + offset for index in MOTION for offset in axes}
    named: set[str] = set()
    for number, keys in enumerate(builder.node.signals):
        if keys.name in named:
            builder.complain(f"signals[{number}].name", f"a second signal {keys.name!r}; name each once")
        named.add(keys.name)
        signal = _configured(builder, f"signals[{number}]", keys, signals.get(keys.name), tuple(signals))
        if signal is not None and signal.index in moving:
            builder.complain(f"signals[{number}].object", f"{signal.where} moves an axis; a joint commands it")
        elif signal is not None:
            signals[keys.name] = signal
    _plan_outputs(builder, signals.values())
    _plan_analogue_inputs(builder)
    _plan_reads(builder, signals.values())
    return signals


def _configured(
    builder: PlanBuilder, key: str, keys: SignalKeys, known: Signal | None, names: tuple[str, ...]
) -> Signal | None:
    """Return a signal as bus.yml has it, None after complaining of what is wrong with it."""
    if keys.object is None:
        if known is None:
            text = f"no signal {keys.name!r} of the device's profile{nearest(keys.name, names)}; give its object"
            builder.complain(f"{key}.name", text)
            return None
        signal = known
    else:
        found = _object(builder, f"{key}.object", keys.object)
        if found is None:
            return None
        entry, bit = found
        signal = Signal(keys.name, entry.index, entry.subindex, _is_output(builder, entry), bit)
    fits = [_fits_type(builder, key, keys, signal), _fits_numbers(builder, key, keys, signal)]
    return _with(keys, signal) if all(fits) else None


def _object(builder: PlanBuilder, key: str, text: int | str) -> tuple[Entry, int | None] | None:
    found = (text, 0, None) if isinstance(text, int) else object_of(text)
    if found is None:
        builder.complain(key, f"{text!r} is no object: 0x6401:01, or 0x6000:01.3 for bit 3 of one")
        return None
    index, subindex, bit = found
    entry = builder.od.get(index, subindex)
    if entry is None:
        builder.complain(key, f"0x{index:04X}:{subindex:02X} is not in {builder.file}")
    elif (bits := entry.data_type.bits) is None:
        builder.complain(key, f"0x{index:04X}:{subindex:02X} {entry.name} is no number")
    elif bit is not None and bit >= bits:
        builder.complain(key, f"0x{index:04X}:{subindex:02X} {entry.name} has the bits 0 to {bits - 1}")
    else:
        return entry, bit
    return None


def _is_output(builder: PlanBuilder, entry: Entry) -> bool:
    """Whether an object is commanded: an RPDO that will be live carries it."""
    return entry.address in _mapped(builder, "rpdo")


def _mapped(builder: PlanBuilder, kind: str) -> set[Address]:
    return {(mapped.index, mapped.subindex) for layout in builder.layouts[kind] for mapped in layout.objects}


def _fits_type(builder: PlanBuilder, key: str, keys: SignalKeys, signal: Signal) -> bool:
    entry = builder.od.get(*signal.address)
    wanted = None if keys.type is None else TYPES[keys.type]
    if entry is None or wanted is None or wanted.bits == entry.data_type.bits:
        return True
    builder.complain(f"{key}.type", f"{keys.type} has {wanted.bits} bits, {signal.where} {entry.data_type.bits}")
    return False


def _fits_numbers(builder: PlanBuilder, key: str, keys: SignalKeys, signal: Signal) -> bool:
    wrong = []
    if keys.factor is not None and (keys.factor == 0 or not math.isfinite(keys.factor)):
        wrong.append(("factor", f"{keys.factor:g} gives no value: finite and not 0 is wanted"))
    if keys.offset is not None and not math.isfinite(keys.offset):
        wrong.append(("offset", f"{keys.offset:g} gives no value: a finite number is wanted"))
    if keys.safe is not None and not signal.output:
        wrong.append(("safe", f"{signal.name} is an input; only an output has a value without the master"))
    elif isinstance(keys.safe, float) and not math.isfinite(keys.safe):
        wrong.append(("safe", f"{keys.safe:g} is no value: a finite number or keep is wanted"))
    if keys.max_rate is not None and signal.output:
        wrong.append(("max_rate", f"{signal.name} is an output; only an input can jump"))
    for name, text in wrong:
        builder.complain(f"{key}.{name}", text)
    return not wrong


def _with(keys: SignalKeys, signal: Signal) -> Signal:
    """Return a signal with what bus.yml says of it; a factor replaces all that the device says of its scale."""
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
    """Let outputs be safe without the master, and tell those that cannot be."""
    live = _mapped(builder, "rpdo")
    outputs = [each for each in safe_outputs(signals, builder.od) if each.output in live]
    keeping = [each for each in outputs if not _plan_safe(builder, each)]
    if keeping:
        where = ", ".join(f"0x{each.output[0]:04X}:{each.output[1]:02X}" for each in keeping)
        builder.warn("dcf", f"the outputs {where} keep their values when the master dies: nothing switches them off")


def warn_of_unwatched_outputs(builder: PlanBuilder, signals: Iterable[Signal]) -> None:
    """Warn that a node which does not notice the death of its master has outputs."""
    live = _mapped(builder, "rpdo")
    if any(each.output in live for each in safe_outputs(signals, builder.od)):
        builder.warn(
            "dcf", "the outputs are not switched off when the master dies: the node has no heartbeat consumer (0x1016)"
        )


def _plan_safe(builder: PlanBuilder, output: SafeOutput) -> bool:
    """Write error mode and error value of one object; return whether it leaves no output as it was by accident."""
    if output.mode_at is None:
        return not output.mode  # bus.yml says of each of them that it keeps what it has
    asked = builder.asked_value(*output.mode_at)
    if asked is not None:
        return asked != 0
    builder.write(*output.mode_at, output.mode, "dcf", _SAFE, optional=True)
    if output.value_at is not None and builder.asked_value(*output.value_at) is None and output.mode:
        builder.write(*output.value_at, output.value, "dcf", _SAFE, optional=True)
    return builder.can_write(*output.mode_at) or bool(builder.default(*output.mode_at))


def _plan_analogue_inputs(builder: PlanBuilder) -> None:
    """Let analogue inputs be sent that only come when they change: 0x6423, and a least change where none is set."""
    inputs = [
        mapped.subindex
        for layout in builder.layouts["tpdo"]
        if layout.transmission_type in _EVENT_TYPES and not layout.event_ms
        for mapped in layout.objects
        if mapped.index in ANALOGUE_INPUTS
    ]
    if not inputs:
        return
    if (AI_ENABLE, 0) in builder.od and not builder.asked_for(AI_ENABLE):
        builder.write(AI_ENABLE, 0, 1, "dcf", "analogue inputs are sent when they change", optional=True)
    for subindex in dict.fromkeys(inputs):
        unset = not builder.default(AI_DELTA, subindex) and not builder.asked_for(AI_DELTA)
        if unset and builder.can_write(AI_DELTA, subindex):
            reason = "analogue inputs are sent when they change by 0.2 %"
            builder.write(AI_DELTA, subindex, _SMALLEST_CHANGE, "dcf", reason, optional=True)


def _plan_reads(builder: PlanBuilder, signals: Iterable[Signal]) -> None:
    """Read what inputs in TPDOs begin with, and the objects that say how a signal is scaled."""
    sent = _mapped(builder, "tpdo")
    wanted: dict[Address, None] = {}
    for signal in signals:
        objects = [*signal.needs, *([] if signal.status is None else [signal.status])]
        if not signal.output and signal.address in sent:
            objects.append(signal.address)
        wanted.update(dict.fromkeys(objects))
    for index, subindex in wanted:
        entry = builder.od.get(index, subindex)
        if entry is not None and entry.readable and (bits := entry.data_type.bits) is not None:
            builder.reads.append(MappedObject(index, subindex, bits, entry.data_type))
