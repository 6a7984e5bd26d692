"""Modes of operation of one axis: the existing ones, the active one (0x6061), and its change (0x6060)."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import TARGET_OBJECTS, OperationMode
from canopen_control.virtual.cyclic_modes import CyclicPosition, CyclicVelocity, InterpolatedPosition, Torque
from canopen_control.virtual.injection_point import InjectionPoint
from canopen_control.virtual.mode_base import GatedMode, Mode, ModeGate
from canopen_control.virtual.node_events import ModeChanged
from canopen_control.virtual.profile_modes import HomingMode, ProfilePosition, ProfileVelocity, VelocityMode

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.virtual.axis_objects import AxisObjects
    from canopen_control.virtual.device_model import DeviceModel
    from canopen_control.virtual.mode_base import AxisParts


MODES: dict[int, Callable[[AxisParts], Mode]] = {
    OperationMode.PP: ProfilePosition,
    OperationMode.VL: VelocityMode,
    OperationMode.PV: ProfileVelocity,
    OperationMode.TQ: Torque,
    OperationMode.HM: HomingMode,
    OperationMode.IP: InterpolatedPosition,
    OperationMode.CSP: CyclicPosition,
    OperationMode.CSV: CyclicVelocity,
    OperationMode.CST: partial(Torque, cyclic=True),
    OperationMode.CSTCA: partial(Torque, cyclic=True),
}
_VELOCITY_MODES: Final = frozenset({OperationMode.VL, OperationMode.PV, OperationMode.CSV})
_NEEDED: Final[dict[int, tuple[int, int]]] = {**TARGET_OBJECTS, OperationMode.HM: (o.HOMING_METHOD, 0)}


def possible_modes(objects: AxisObjects) -> int:
    """Return the default 0x6502: every mode whose objects are in the dictionary."""
    return sum(1 << (mode - 1) for mode, address in _NEEDED.items() if objects.has(*address))


class DriveModes:
    """Modes of one axis: `number` is 0x6061, `active` its motion.

    It changes only while all `conditions` hold. Seams: `stuck`, it never changes; `delay_ns`, how late it changes;
    `homing.fails`.
    """

    def __init__(self, axis: AxisParts) -> None:
        self._axis = axis
        self._all = {number: make(axis) for number, make in MODES.items()}
        homing, interpolated = self._all[OperationMode.HM], self._all[OperationMode.IP]
        assert isinstance(homing, HomingMode)
        assert isinstance(interpolated, InterpolatedPosition)
        self.homing: HomingMode = homing
        self.interpolated: InterpolatedPosition = interpolated
        self._none = Mode(axis)
        self.number: int = 0
        self.active: Mode = self._none
        self.stuck: InjectionPoint[bool] = InjectionPoint(False)
        self.delay_ns: InjectionPoint[int] = InjectionPoint(0)
        self.conditions: tuple[Callable[[], bool], ...] = ()
        self.gate: ModeGate | None = None

    def add(self, number: int, like: int) -> None:
        """Add a manufacturer-specific mode that moves like another one."""
        self._all[number] = MODES[like](self._axis)

    def remove(self, number: int) -> None:
        """Remove a manufacturer-specific mode."""
        self._all.pop(number, None)

    def set_gate(self, gate: ModeGate | None) -> None:
        """Set a gate before every mode; None removes it."""
        self.gate = gate
        for number, mode in self._all.items():
            inner = mode.inner if isinstance(mode, GatedMode) else mode
            self._all[number] = inner if gate is None else GatedMode(inner, gate)
        if self.active is not self._none:
            self.active = self._all.get(self.number, self._none)

    def set_model(self, model: DeviceModel) -> None:
        """Apply another device model."""
        for mode in (self._none, *self._all.values()):
            mode.set_model(model)

    def clear(self) -> None:
        """Clear the mode after power-on."""
        self.number, self.active = 0, self._none

    def reset(self) -> None:
        """Reset every mode, because the motor has no power."""
        for mode in self._all.values():
            mode.reset()

    def select(self, now: int) -> None:
        """Apply 0x6060 immediately in every state; if enabled, the new mode starts with the present motion."""
        mover, delay = self._axis.mover, self.delay_ns.value
        if self.stuck.value or (self.conditions and not all(holds() for holds in self.conditions)):
            return
        if not delay:
            self._take(now)
        elif "mode" not in mover.timers:  # written again, it is still under way
            mover.at("mode", now + delay, self._take)

    def _take(self, now: int) -> None:
        axis = self._axis
        number = axis.objects.number(o.MODES_OF_OPERATION)
        if number != self.number:
            axis.outbox.publish(ModeChanged(axis.objects.axis, number))
        self.active.reset()
        axis.mover.cancel("homing", "window")
        axis.mover.velocity_mode = number in _VELOCITY_MODES and not axis.objects.model.ramps_positions
        self.number, self.active = number, self._all.get(number, self._none)
        if axis.power.running and not axis.power.halted:
            self.active.start(now)
        axis.outbox.values_changed()
