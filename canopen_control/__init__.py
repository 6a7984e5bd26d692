"""CANopen and CiA 402 drives for robots: master, virtual drives and the functions of ros2_control in Python.

`Robot.from_config("robby")` creates a robot in this process, `Robot.attach("robby")` connects to a running robot.
The names in `__all__` and the exceptions in `canopen_control.errors` are public; everything else is internal.
"""

from __future__ import annotations

import importlib

from canopen_control.version import __version__

TYPE_CHECKING = False  # the module typing takes longer to import than this one
if TYPE_CHECKING:
    from canopen_control.bus.channel import open_port
    from canopen_control.bus.port import BusEvent, Port
    from canopen_control.client import RobotClient
    from canopen_control.controllers.base import Controller
    from canopen_control.controllers.params import CommonParams, Params
    from canopen_control.errors import CanopenError
    from canopen_control.frame import CanFrame, frames_of, pack_records
    from canopen_control.hardware.interfaces import CommandInterface, ReturnType, StateInterface
    from canopen_control.host.sockets import find_robots
    from canopen_control.od.eds import EdsFile, read_eds
    from canopen_control.od.issues import Issue
    from canopen_control.od.model import ObjectDictionary
    from canopen_control.robot import Robot
    from canopen_control.rpc.messages.state import (
        AxisReading,
        ControllerReading,
        JointReading,
        NodeReading,
        RobotEvent,
        Status,
    )
    from canopen_control.yamlfile.convert import setting

__all__ = [
    "AxisReading",
    "BusEvent",
    "CanFrame",
    "CanopenError",
    "CommandInterface",
    "CommonParams",
    "Controller",
    "ControllerReading",
    "EdsFile",
    "Issue",
    "JointReading",
    "NodeReading",
    "ObjectDictionary",
    "Params",
    "Port",
    "ReturnType",
    "Robot",
    "RobotClient",
    "RobotEvent",
    "StateInterface",
    "Status",
    "__version__",
    "find_robots",
    "frames_of",
    "open_port",
    "pack_records",
    "read_eds",
    "setting",
]

_NAMES_OF = {
    "bus.channel": ("open_port",),
    "bus.port": ("BusEvent", "Port"),
    "client": ("RobotClient",),
    "controllers.base": ("Controller",),
    "controllers.params": ("CommonParams", "Params"),
    "errors": ("CanopenError",),
    "frame": ("CanFrame", "frames_of", "pack_records"),
    "hardware.interfaces": ("CommandInterface", "ReturnType", "StateInterface"),
    "host.sockets": ("find_robots",),
    "od.eds": ("EdsFile", "read_eds"),
    "od.issues": ("Issue",),
    "od.model": ("ObjectDictionary",),
    "robot": ("Robot",),
    "rpc.messages.state": (
        "AxisReading",
        "ControllerReading",
        "JointReading",
        "NodeReading",
        "RobotEvent",
        "Status",
    ),
    "yamlfile.convert": ("setting",),
}
_HOMES = {name: module for module, names in _NAMES_OF.items() for name in names}


def __dir__() -> list[str]:
    """Return the names of the module, including those imported on first use."""
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> object:
    """Import a public name on first use, since most processes need only a part of the package."""
    if name in _HOMES:
        return getattr(importlib.import_module(f"canopen_control.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
