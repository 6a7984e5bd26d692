"""Which mode serves a command interface on a certain drive, and whether its PDOs carry what that mode needs.

The law of this file: bus.yml decides where it says something, else the best mode that the drive lists (0x6502) and
whose target an RPDO carries; cyclic before profile. What cannot be is refused before anything is sent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.modes import (
    INTERFACE_MODES,
    OperationMode,
    mode_for_interface,
    require_mode,
    supported_modes,
)
from canopen_control.errors import DriveError, RobotConfigError
from canopen_control.hardware.axis_modes import target_address
from canopen_control.hardware.interfaces import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.hardware.axis import Axis
    from canopen_control.hardware.axis_parameters import AxisParameters

__all__ = ["DIGITAL_OUTPUTS", "MOTION", "choose_mode", "listed_modes", "require_targets"]

DIGITAL_OUTPUTS: Final = "digital_outputs"
MOTION: Final = (POSITION, VELOCITY, EFFORT)
_SERVED: Final = {
    POSITION: (*INTERFACE_MODES[POSITION], OperationMode.IP),
    VELOCITY: (*INTERFACE_MODES[VELOCITY], OperationMode.VL),
    EFFORT: INTERFACE_MODES[EFFORT],
}
"""Command interface to the modes that serve it; the last ones only where no better one is there."""


def listed_modes(axis: Axis, parameters: AxisParameters) -> tuple[OperationMode, ...]:
    """Return what 0x6502 lists: as read from the drive, else as the EDS has it; () where neither says."""
    listed = parameters.get(objects.SUPPORTED_DRIVE_MODES)
    identity = axis.node.identity
    if listed is None and identity is not None and len(axis.node.plan.axes) == 1:
        listed = identity.supported_modes
    if listed is None:
        entry = axis.node.od.get(axis.index(objects.SUPPORTED_DRIVE_MODES), 0)
        listed = entry.value if entry is not None and isinstance(entry.value, int) else 0
    return supported_modes(listed)


def choose_mode(axis: Axis, parameters: AxisParameters, interface: str) -> OperationMode:
    """Return the mode for a command interface; raises DriveError (UnsupportedMode) where there is none."""
    config = axis.node.config
    wanted = {POSITION: config.position_mode, VELOCITY: config.velocity_mode, EFFORT: config.effort_mode}[interface]
    listed = listed_modes(axis, parameters)
    if wanted is not None:
        if listed:
            require_mode(wanted, listed)
        _require_mapped(axis, OperationMode(wanted))
        return OperationMode(wanted)
    candidates = [mode for mode in _SERVED[interface] if mode in listed]
    for mode in candidates:
        if _is_mapped(axis, mode):
            return mode
    for mode in candidates[:1]:
        _require_mapped(axis, mode)
    return mode_for_interface(interface, listed)


def require_targets(axis: Axis, interfaces: Iterable[str]) -> None:
    """Raise RobotConfigError for a command interface that no RPDO could serve, whatever the drive lists."""
    for name in interfaces:
        if name == DIGITAL_OUTPUTS:
            if axis.digital_outputs is None:
                raise _unmapped(axis, name, "0x60FE:01")
        elif name not in _SERVED:
            raise RobotConfigError(
                f"joint {axis.joint}: no command interface {name!r}; there are: {', '.join((*MOTION, DIGITAL_OUTPUTS))}"
            )
        elif not any(_is_mapped(axis, mode) for mode in _SERVED[name]):
            index, _ = target_address(_SERVED[name][0]) or (0, 0)
            raise _unmapped(axis, name, f"0x{axis.index(index):04X}")


def _is_mapped(axis: Axis, mode: int) -> bool:
    address = target_address(mode)
    return address is not None and axis.output(*address) is not None


def _require_mapped(axis: Axis, mode: OperationMode) -> None:
    if not _is_mapped(axis, mode):
        index, subindex = target_address(mode) or (0, 0)
        raise DriveError(
            f"{axis.node.who}: no RPDO carries 0x{axis.index(index):04X}:{subindex:02X}, "
            f"the target of mode {mode.name}; map it in bus.yml"
        )


def _unmapped(axis: Axis, interface: str, what: str) -> RobotConfigError:
    return RobotConfigError(
        f"joint {axis.joint}: no RPDO of {axis.node.name} carries the target of its command interface {interface!r}; "
        f"map {what} in bus.yml or drop the interface"
    )
