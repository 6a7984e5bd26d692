"""What sensors, batteries, inputs and outputs, and grippers told in a run: the least, the most and the last of each.

A value is named as its interface or field is; what is not known counts as nothing, and a value that was never known
has no row.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.rpc.messages.samples import (
    BatteriesSample,
    GpioSample,
    GripperSample,
    ImuSample,
    PoseSample,
    RangeSample,
    WrenchSample,
)
from canopen_control.rpc.messages.state import StateSample
from canopen_control.trace.report_facts import MeasuredFacts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from canopen_control.rpc.messages.samples import Sample
    from canopen_control.rpc.messages.state import TimedSnapshot

    Row = tuple[str, str, float | None]  # name, unit, value

__all__ = ["measured"]


def measured(states: Iterable[TimedSnapshot]) -> list[MeasuredFacts]:
    """Return a row for each value that was known once, by controller; each publication counts once."""
    told: dict[str, float] = {}
    found: dict[tuple[str, str], MeasuredFacts] = {}
    for state in states:
        for name, sample in state.samples.items() if isinstance(state, StateSample) else ():
            if told.get(name) == sample.time:
                continue
            told[name] = sample.time
            for what, unit, value in _rows(sample):
                if value is not None:
                    known = found.get((name, what))
                    found[name, what] = _seen(MeasuredFacts(name, what, unit, value, value, value), known)
    return list(found.values())


def _seen(now: MeasuredFacts, before: MeasuredFacts | None) -> MeasuredFacts:
    if before is None:
        return now
    least, most = min(before.least, now.last), max(before.most, now.last)
    return MeasuredFacts(now.controller, now.what, now.unit, least, most, now.last)


def _rows(sample: Sample) -> Iterator[Row]:
    for kind, rows in _KINDS.items():
        if isinstance(sample, kind):
            yield from rows(sample)


def _axes(what: str, axes: str, unit: str, values: Iterable[float | None]) -> Iterator[Row]:
    for axis, value in zip(axes, values, strict=False):
        yield f"{what}.{axis}", unit, value


def _imu(sample: ImuSample) -> Iterator[Row]:
    yield from _axes("orientation", "xyzw", "", sample.orientation)
    yield from _axes("angular_velocity", "xyz", "rad/s", sample.angular_velocity)
    yield from _axes("linear_acceleration", "xyz", "m/s²", sample.linear_acceleration)


def _range(sample: RangeSample) -> Iterator[Row]:
    yield "range", "m", sample.range


def _wrench(sample: WrenchSample) -> Iterator[Row]:
    yield from _axes("force", "xyz", "N", sample.force)
    yield from _axes("torque", "xyz", "Nm", sample.torque)


def _pose(sample: PoseSample) -> Iterator[Row]:
    yield from _axes("position", "xyz", "m", sample.position)
    yield from _axes("orientation", "xyzw", "", sample.orientation)


def _batteries(sample: BatteriesSample) -> Iterator[Row]:
    for battery in sample.batteries:
        yield f"{battery.name} voltage", "V", battery.voltage
        yield f"{battery.name} current", "A", battery.current
        yield f"{battery.name} temperature", "°C", battery.temperature
        yield f"{battery.name} percentage", "", battery.percentage


def _gpio(sample: GpioSample) -> Iterator[Row]:
    for part, values in sample.parts.items():
        for name, value in values.items():
            yield f"{part}/{name}", "", value


def _gripper(sample: GripperSample) -> Iterator[Row]:
    yield f"{sample.joint} position", "rad or m", sample.position
    yield f"{sample.joint} effort", "Nm or N", sample.effort
    yield f"{sample.joint} target", "rad or m", sample.target


_KINDS: Final[dict[type[Sample], Callable[..., Iterator[Row]]]] = {
    ImuSample: _imu,
    RangeSample: _range,
    WrenchSample: _wrench,
    PoseSample: _pose,
    BatteriesSample: _batteries,
    GpioSample: _gpio,
    GripperSample: _gripper,
}
