"""What a running virtual drive is doing, as lines for people: states, motion, faults, quality of its set-points."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.rpc.messages.drive import AxisState, DriveState, SetPointQuality, SignalState, Spread

__all__ = ["state_lines"]


def state_lines(state: DriveState) -> Iterator[str]:
    """Yield what a node is doing, a line for it and some for each axis."""
    errors = "".join(f", error 0x{code:04X}" for code in state.errors)
    faults = f"; faults that are on: {', '.join(state.faults)}" if state.faults else ""
    yield f"node {state.node_id}, {state.name}: {state.nmt_state}{errors}{faults}"
    for axis in state.axes:
        yield _axis_line(axis)
        if axis.set_points is not None:
            yield from (f"    {line}" for line in quality_lines(axis.set_points))
    for output, word in ((False, "inputs"), (True, "outputs")):
        shown = [_signal(each) for each in state.signals if each.output is output]
        if shown:
            yield f"  {word}: {', '.join(shown)}"


def _signal(signal: SignalState) -> str:
    return f"{signal.name} {signal.value:g}{f' {signal.unit}' if signal.unit else ''}"


def _axis_line(axis: AxisState) -> str:
    where = f"position {axis.position}, velocity {axis.velocity}"
    return f"  axis {axis.axis}: {axis.state}, {axis.mode}, {where}, torque {axis.plant.torque / 10:.0f} %"


def quality_lines(quality: SetPointQuality) -> Iterator[str]:
    """Yield how the set-points of a cyclic mode came, and what they made of the motion."""
    yield (
        f"set-points: {quality.taken} taken, {quality.missed} missed, {quality.doubled} doubled, "
        f"{quality.overwritten} overwritten"
    )
    if quality.velocity is not None:
        yield f"velocity demand: {_spread(quality.velocity)}, ripple {_percent(quality.velocity_ripple)}"
    if quality.acceleration is not None:
        ripple = _percent(quality.acceleration_ripple)
        yield f"acceleration ripple: {quality.acceleration:.4g} units/s^2, in relation to the velocity {ripple}"
    if quality.phase_us is not None:
        yield f"RPDO after SYNC: {_spread(quality.phase_us)} us"


def _spread(spread: Spread) -> str:
    return f"{spread.mean:.6g} ({spread.min:.6g} to {spread.max:.6g})"


def _percent(ratio: float | None) -> str:
    return "-" if ratio is None else f"{100 * ratio:.1f} %"
