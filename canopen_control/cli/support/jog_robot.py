"""Robot for a jog or a tuning run: one drive on a bare bus, booted like any robot, or a drive of a running robot.

The boot is the normal one: `init` chooses mode, PDOs and supervision from the EDS; the runtime boots, monitors and
stops the drive on a bus without controllers. The drive detects the end of this process by heartbeat or guarding, within
`DEAD_MAN_S`. A drive that a controller of a running robot commands is refused.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.check.preflight_record import limit_speed
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
from canopen_control.client import find_robots
from canopen_control.commissioning.driven_axis import JogDrive
from canopen_control.controllers.params import Params
from canopen_control.errors import ConfigError, RobotConfigError
from canopen_control.runtime.background import BackgroundRobot
from canopen_control.runtime.robot_files import BUS, find_robot
from canopen_control.runtime.run_session import RunOptions
from canopen_control.runtime.setup import read_robot
from canopen_control.scaffold.bus_text import bus_text
from canopen_control.scaffold.new_robot import plan_robot
from canopen_control.scaffold.pdo_choice import PdoRequirement, choose_pdos

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.commissioning.jog_motion import JogKind
    from canopen_control.runtime.core import RobotCore
    from canopen_control.runtime.observer import RobotObserver
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.scaffold.drive_choice import AxisChoice, DriveChoice, Supervision
    from canopen_control.scaffold.new_robot import Device, NewNode, NewRobot


HEARTBEAT_MS: Final = 50
COMMAND_LIFE_S: Final = 0.4  # command timeout of the controllers
DEAD_MAN_S: Final = 5 * HEARTBEAT_MS / 1000


def choose_jog(device: Device, interface: str, *, allow_unsupervised: bool) -> NewRobot:
    """Plan a robot of one drive that is commanded by `interface`; raise RobotConfigError if it cannot be run."""
    name = f"jog_{device.node_id}"
    if name in find_robots():
        name = f"{name}_{os.getpid()}"
    planned = plan_robot(name, [device], allow_unsupervised=allow_unsupervised, interfaces=(interface,))
    if planned.problems:
        raise RobotConfigError("\n".join(planned.problems))
    return replace(planned, heartbeat_ms=HEARTBEAT_MS)


# Robot for `tune`: as for a jog, but preferably in a cyclic mode, and with the actual torque in a TPDO.


_CYCLIC: Final = {OperationMode.PV: OperationMode.CSV, OperationMode.TQ: OperationMode.CST}
"""Cyclic modes that command the same quantity as a profile mode, without a ramp of the drive."""
_WITH_SYNC: Final = 1
_FEEDBACK: Final = (MODES_OF_OPERATION_DISPLAY, POSITION_ACTUAL, VELOCITY_ACTUAL, TORQUE_ACTUAL, ERROR_CODE)


def choose_tuned(device: Device, kind: JogKind, period_us: int, *, allow_unsupervised: bool) -> NewRobot:
    """Plan a robot of one drive for tuning: preferably in a cyclic mode, with the actual torque in a TPDO."""
    robot = choose_jog(device, kind.value, allow_unsupervised=allow_unsupervised)
    return replace(robot, nodes=tuple(_tuned(device, node) for node in robot.nodes), sync_us=period_us)


def _tuned(device: Device, node: NewNode) -> NewNode:
    if node.drive is None:
        return node
    drive = _cyclic(device, node.drive)
    joints = tuple(replace(joint, axis=axis) for joint, axis in zip(node.joints, drive.axes, strict=True))
    return replace(node, drive=drive, joints=joints)


def _cyclic(device: Device, drive: DriveChoice) -> DriveChoice:
    listed = device.od.get(SUPPORTED_DRIVE_MODES, 0)
    modes = supported_modes(listed.value) if listed is not None and isinstance(listed.value, int) else ()
    axes = tuple(
        replace(axis, mode=_CYCLIC[axis.mode]) if _CYCLIC.get(axis.mode) in modes else axis for axis in drive.axes
    )

    def addresses(*indices: int) -> tuple[tuple[int, int], ...]:
        return tuple((axis.index(index), 0) for axis in axes for index in indices)

    tpdos, _ = choose_pdos(device.od, PdoRequirement(False, addresses(STATUSWORD), addresses(*_FEEDBACK)))
    rpdos = drive.rpdos
    if axes != drive.axes:
        rpdos = tuple(replace(use, transmission=_WITH_SYNC) if use.transmission else use for use in rpdos)
    return replace(drive, axes=axes, rpdos=rpdos, tpdos=tpdos)


def dead_man_words(supervision: Supervision) -> str:
    """Return a sentence about how the drive stops if this process ends."""
    if supervision.stops_alone and not supervision.reacts:
        return (
            "UNKNOWN: the drive monitors this computer, but has neither 0x6007 nor 0x1029:01, so it may move on when "
            "this computer fails; have an emergency stop within reach"
        )
    if supervision.consumer:
        return (
            "the drive monitors this computer's heartbeat (0x1016) and stops on its own "
            f"{DEAD_MAN_S:g} s after the last one"
        )
    if supervision.guarding:
        return f"the drive is guarded (0x100C, 0x100D) and stops on its own {DEAD_MAN_S:g} s after the last request"
    return "NONE: nothing stops the drive when this computer fails; have an emergency stop within reach"


@contextlib.contextmanager
def own_robot(
    robot: NewRobot, axis: AxisChoice, channel: str, speed: float, events: RobotObserver
) -> Iterator[JogDrive]:
    """Context in which a robot of one drive runs in this process, with speeds limited to `speed` rad/s."""
    with tempfile.TemporaryDirectory(prefix="canopen-control-jog-") as folder:
        path = Path(folder) / BUS
        path.write_text(bus_text(robot), encoding="utf-8")
        for node in robot.nodes:
            shutil.copyfile(node.device.eds, path.parent / robot.eds_name(node))
        setup = _short_lived(_read(robot, path, channel))
        joint = next(joint for joint in robot.joints if joint.axis is axis)
        names = [part.name for tag in setup.description.hardware for part in tag.joints]
        joint_name = names[robot.joints.index(joint)]

        def prepare(core: RobotCore) -> None:
            limit_speed(core, names, speed)
            core.observers.append(events)

        background = BackgroundRobot(setup, RunOptions(drives=False), prepare)
        try:
            background.start()
            yield JogDrive(robot.name, joint.node, joint_name, joint_name, axis.mode.name, alone=True)
        finally:
            background.shutdown()


def _read(robot: NewRobot, path: Path, channel: str) -> RobotSetup:
    """Read the generated robot; if it is invalid, raise RobotConfigError with the EDS in place of its files."""
    try:
        return read_robot(find_robot(None, bus=str(path)), name=robot.name, can=[channel], real=True)
    except ConfigError as error:
        lines = [line for line in str(error).split("\n") if not line.startswith("    ")]
        text = re.sub(re.escape(str(path)) + r"(:\d+)*: ", "", "\n".join(lines)).replace(f"{path.parent}{os.sep}", "")
        raise RobotConfigError(
            f"{robot.nodes[0].device.eds}: the robot generated from this EDS cannot run:\n{text}"
        ) from None


def _short_lived(setup: RobotSetup) -> RobotSetup:
    """Shorten the command timeout of the controllers, so that a stopped terminal stops the drive."""
    controllers = {
        name: replace(config, params=Params.of({"joint": name, "command_timeout": COMMAND_LIFE_S}, name))
        for name, config in setup.controllers.controllers.items()
    }
    return replace(setup, controllers=replace(setup.controllers, controllers=controllers))
