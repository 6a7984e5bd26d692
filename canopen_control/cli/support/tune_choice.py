"""Excitation of a drive on a bare bus for `tune`: as for a jog, preferably in a cyclic mode and with its torque."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.modes import OperationMode, supported_modes
from canopen_control.cia402.objects import (
    ERROR_CODE,
    MODES_OF_OPERATION_DISPLAY,
    POSITION_ACTUAL,
    STATUSWORD,
    SUPPORTED_DRIVE_MODES,
    TORQUE_ACTUAL,
    VELOCITY_ACTUAL,
)
from canopen_control.cli.support.jog_robot import choose_jog

if TYPE_CHECKING:
    from canopen_control.commissioning.jog_motion import JogKind
    from canopen_control.scaffold.drive_choice import DriveChoice
    from canopen_control.scaffold.new_robot import Device, NewRobot


_CYCLIC: Final = {OperationMode.PV: OperationMode.CSV, OperationMode.TQ: OperationMode.CST}
"""What commands the same without a ramp of the drive's own."""
_WITH_SYNC: Final = 1
_FEEDBACK: Final = (MODES_OF_OPERATION_DISPLAY, POSITION_ACTUAL, VELOCITY_ACTUAL, TORQUE_ACTUAL, ERROR_CODE)


def choose_tuned(device: Device, kind: JogKind, period_us: int, *, allow_unsupervised: bool) -> NewRobot:
    """Choose the excitation of a drive: as for a jog, preferably in a cyclic mode, with its torque in a TPDO."""
    robot = choose_jog(device, kind.value, allow_unsupervised=allow_unsupervised)
    nodes = tuple(
        node if node.drive is None else replace(node, drive=_cyclic(device, node.drive)) for node in robot.nodes
    )
    nodes = tuple(
        node
        if node.drive is None
        else replace(
            node,
            joints=tuple(replace(joint, axis=axis) for joint, axis in zip(node.joints, node.drive.axes, strict=True)),
        )
        for node in nodes
    )
    return replace(robot, nodes=nodes, sync_us=period_us)


def _cyclic(device: Device, drive: DriveChoice) -> DriveChoice:
    from canopen_control.scaffold.pdo_choice import PdoRequirement, choose_pdos

    listed = device.od.get(SUPPORTED_DRIVE_MODES, 0)
    modes = supported_modes(listed.value) if listed is not None and isinstance(listed.value, int) else ()
    axes = tuple(
        replace(axis, mode=_CYCLIC[axis.mode]) if _CYCLIC.get(axis.mode) in modes else axis for axis in drive.axes
    )

    def each(*indices: int) -> tuple[tuple[int, int], ...]:
        return tuple((axis.index(index), 0) for axis in axes for index in indices)

    tpdos, _ = choose_pdos(device.od, PdoRequirement(False, each(STATUSWORD), each(*_FEEDBACK)))
    rpdos = drive.rpdos
    if axes != drive.axes:
        rpdos = tuple(replace(use, transmission=_WITH_SYNC) if use.transmission else use for use in rpdos)
    return replace(drive, axes=axes, rpdos=rpdos, tpdos=tpdos)
