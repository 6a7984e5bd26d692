"""The modes of operation of one axis: which there are, which one is active (0x6061), and its change (0x6060)."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import TARGET_OBJECTS, OperationMode
from canopen_control.virtual.cyclic_modes import CyclicPosition, CyclicVelocity, InterpolatedPosition, Torque
from canopen_control.virtual.injection_point import InjectionPoint
from canopen_control.virtual.mode_base import Mode
from canopen_control.virtual.node_events import ModeChanged
from canopen_control.virtual.profile_modes import HomingMode, ProfilePosition, ProfileVelocity, VelocityMode

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.virtual.axis_objects import AxisObjects
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
    """Return 0x6502 for a drive whose file does not tell it: every mode whose object its dictionary has."""
    return sum(1 << (mode - 1) for mode, address in _NEEDED.items() if objects.has(*address))


class DriveModes:
    """The modes of one axis: `number` is 0x6061, `active` its motion.

    Seams: `stuck`, the mode never changes; `delay_ns`, how late it changes; `homing.fails`.
    """

    def __init__(self, axis: AxisParts) -> None:
        self._axis = axis
        self._all = {number: make(axis) for number, make in MODES.items()}
        self._none = Mode(axis)
        self.number: int = 0
        self.active: Mode = self._none
        self.stuck: InjectionPoint[bool] = InjectionPoint(False)
        self.delay_ns: InjectionPoint[int] = InjectionPoint(0)

    @property
    def homing(self) -> HomingMode:
        """The homing mode."""
        homing = self._all[OperationMode.HM]
        assert isinstance(homing, HomingMode)
        return homing

    @property
    def interpolated(self) -> InterpolatedPosition:
        """The interpolated position mode."""
        interpolated = self._all[OperationMode.IP]
        assert isinstance(interpolated, InterpolatedPosition)
        return interpolated

    def clear(self) -> None:
        """Have no mode: power-on."""
        self.number, self.active = 0, self._none

    def reset(self) -> None:
        """Let every mode forget what it remembers: the motor has no power."""
        for mode in self._all.values():
            mode.reset()

    def select(self, now: int) -> None:
        """Take 0x6060: at once in every state; in operation the new mode goes on from the present motion."""
        mover, delay = self._axis.mover, self.delay_ns.value
        if self.stuck.value:
            return
        if not delay:
            self._take(now)
        elif "mode" not in mover.timers:  # written again, it is still under way
            mover.at("mode", now + delay, self._take)

    def _take(self, now: int) -> None:
        axis = self._axis
        number = axis.objects.number(o.MODES_OF_OPERATION)
        if number != self.number:
            axis.outbox.tell(ModeChanged(axis.objects.axis, number))
        self.active.reset()
        axis.mover.cancel("homing", "window")
        axis.mover.velocity_mode = number in _VELOCITY_MODES and not axis.objects.model.ramps_positions
        self.number, self.active = number, self._all.get(number, self._none)
        if axis.power.running and not axis.power.halted:
            self.active.start(now)
        axis.outbox.values_changed()
