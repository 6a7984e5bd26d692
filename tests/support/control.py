"""Hardware and a manager for the tests of controllers, and the golden vectors."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from canopen_control.controllers.base import Controller, EnableStatus
from canopen_control.controllers.manager import ControllerManager
from canopen_control.controllers.params import Params
from canopen_control.hardware.interfaces import (
    CommandInterface,
    InterfaceRegistry,
    LifecycleState,
    ReturnType,
    StateInterface,
)

DATA = Path(__file__).parents[1] / "data"
S = 1_000_000_000
FORWARD = "forward_command_controller/ForwardCommandController"
BROADCASTER = "joint_state_broadcaster/JointStateBroadcaster"
DIFF_DRIVE = "diff_drive_controller/DiffDriveController"


class Hardware:
    """A component that records what it is asked; `refuse` and `broken` make it say no and fail."""

    changeable = False

    def __init__(self, *commands: str, states: tuple[str, ...] = (), name: str = "robot") -> None:
        self.name = name
        self.state, self.simulated_ns = LifecycleState.ACTIVE, None
        self.command_interfaces = [CommandInterface(*command.rsplit("/", 1)) for command in commands]
        self.state_interfaces = [StateInterface(*state.rsplit("/", 1)) for state in states]
        self.calls: list[tuple[str, tuple[str, ...], tuple[str, ...]]] = []
        self.refuse: Exception | None = None

    def configure(self) -> None:
        self.state = LifecycleState.INACTIVE

    def activate(self) -> None:
        self.state = LifecycleState.ACTIVE

    def deactivate(self) -> None:
        self.state = LifecycleState.INACTIVE

    def cleanup(self) -> None:
        self.state = LifecycleState.UNCONFIGURED

    def shutdown(self) -> None:
        self.state = LifecycleState.FINALIZED

    def prepare_command_mode_switch(self, start, stop) -> None:
        self.calls.append(("prepare", tuple(start), tuple(stop)))
        if self.refuse is not None:
            raise self.refuse

    def perform_command_mode_switch(self, start, stop) -> None:
        self.calls.append(("perform", tuple(start), tuple(stop)))

    def read(self, now, period) -> ReturnType:
        return ReturnType.OK

    def write(self, now, period) -> ReturnType:
        return ReturnType.OK

    def values(self) -> list[float]:
        return [interface.value for interface in self.command_interfaces]

    def set(self, name: str, value: float) -> None:
        next(interface for interface in self.state_interfaces if interface.name == name).value = value


def manager(
    *hardware: Hardware,
    rate: int = 100,
    joints: tuple[str, ...] | None = None,
    cycle: float | None = None,
    enable_status: EnableStatus | None = None,
) -> ControllerManager:
    """Return a manager over components."""
    registry = InterfaceRegistry()
    for component in hardware:
        registry.register(component)
    return ControllerManager(registry, rate, joints=joints, cycle=cycle, enable_status=enable_status)


class Scripted(Controller):
    """Does what the test says: `result` is returned or raised, `runs` are the (now, period) it was called with."""

    def __init__(self, name: str, wheel: str = "l", result: object = ReturnType.OK) -> None:
        super().__init__(name, "test/Scripted")
        self.wheel, self.result, self.start_error, self.runs = wheel, result, None, []

    def command_interface_names(self) -> list[str]:
        return [f"{self.wheel}/velocity"]

    def on_activate(self, commands, states, now) -> None:
        super().on_activate(commands, states, now)
        if self.start_error is not None:
            raise self.start_error

    def update(self, now: int, period: float) -> ReturnType:
        self.runs.append((now, period))
        if isinstance(self.result, Exception):
            raise self.result
        for command in self.commands:
            command.value = 5.0
        return self.result


def put(control: ControllerManager, controller: Controller, rate: int = 0) -> Controller:
    """Put a controller in as loaded and configured."""
    control._controllers[controller.name] = controller
    control._params[controller.name] = Params.of({"update_rate": rate})
    control.configure(controller.name)
    return controller


def wheels() -> Hardware:
    return Hardware("l/velocity", "r/velocity", states=("l/position", "r/position"), name="base")


def three_on_two_wheels() -> tuple[Hardware, ControllerManager]:
    """Return wheels, and a manager with one controller for both, one for each, and a broadcaster."""
    hardware = wheels()
    control = manager(hardware)
    for name, joints in (("both", ["l", "r"]), ("left", ["l"]), ("right", ["r"])):
        add(control, name, FORWARD, joints=joints, interface_name="velocity")
    add(control, "states", BROADCASTER)
    return hardware, control


def add(control: ControllerManager, name: str, type_name: str, **params: Any) -> Any:
    """Load and configure a controller; `a__b` in a name is `a.b`."""
    controller = control.load(
        name, type_name, Params.of({key.replace("__", "."): parameter for key, parameter in params.items()})
    )
    control.configure(name)
    return controller


def vectors(group: str, file: str = "controllers.json") -> list[Any]:
    """Return the cases of a group of the golden vectors, with nan and inf as numbers."""
    groups = json.loads((DATA / file).read_text(encoding="utf-8"))["groups"]
    return next(_numbers(entry["cases"]) for entry in groups if entry["id"] == group)


def _numbers(value: Any) -> Any:
    if isinstance(value, list):
        return [_numbers(element) for element in value]
    if isinstance(value, dict):
        return {key: _numbers(element) for key, element in value.items()}
    return {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}.get(value, value) if isinstance(value, str) else value


def same(found: Any, wanted: Any, tolerance: float = 1e-9) -> bool:
    """Whether numbers are equal within a tolerance, nan being equal to itself."""
    if math.isnan(wanted) or math.isnan(found):
        return math.isnan(wanted) and math.isnan(found)
    return bool(math.isclose(found, wanted, rel_tol=tolerance, abs_tol=tolerance))
