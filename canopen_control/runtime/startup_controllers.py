"""Loading, configuration and switching of a robot's controllers, as ROS 2 spawners do.

The controllers of the start are prepared before any channel is opened: an unknown type, a wrong parameter, and an
interface that does not exist or that two controllers claim are reported as errors in the file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.controllers.base import ALL_STATES, ControllerState
from canopen_control.controllers.types import make_controller
from canopen_control.errors import CanopenError, ControlError, InterfaceConflict, RobotConfigError, UnknownName, nearest
from canopen_control.urdf.robot_model import WheelGeometry

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.controllers.manager import ControllerManager
    from canopen_control.hardware.interfaces import InterfaceRegistry
    from canopen_control.runtime.setup import RobotSetup


UNLOADED = "unloaded"  # state of a controller that is only in the file


def load_controller(setup: RobotSetup, manager: ControllerManager, name: str, *, configure: bool = True) -> None:
    """Load and, by default, configure a controller of ros2_controllers.yaml; raise ControlError or ConfigError."""
    config = setup.controllers.controllers.get(name)
    if config is None:
        by_name = setup.controllers.controllers
        raise UnknownName(f"no controller {name!r} in {setup.files.controllers}{nearest(name, by_name)}")
    manager.load(name, config.type, config.params, config.fallbacks, config.node_options)
    if configure:
        configure_controller(setup, manager, name)


def configure_controller(setup: RobotSetup, manager: ControllerManager, name: str) -> None:
    """Configure a loaded controller, then load its missing fallback controllers; raise ControlError or ConfigError."""
    manager.configure(name)
    loaded, config = manager.states, setup.controllers.controllers.get(name)
    for fallback in () if config is None else config.fallbacks:
        if fallback not in loaded and fallback not in setup.to_activate:
            load_controller(setup, manager, fallback)


def switch_controllers(
    setup: RobotSetup,
    manager: ControllerManager,
    activate: Sequence[str],
    deactivate: Sequence[str],
    *,
    strict: bool,
    check: Callable[[Iterable[Controller]], None],
) -> None:
    """Switch controllers; new ones are loaded and configured first. `check` may refuse the activation.

    Without `strict`, unknown names are reported and left out. Raise ControlError or ConfigError if the switch fails;
    then newly loaded controllers are unloaded again.
    """
    before = manager.states
    names = {*before, *setup.controllers.controllers}
    if not strict and (unknown := [name for name in (*activate, *deactivate) if name not in names]):
        manager.leave_out(unknown)
        activate = [name for name in activate if name in names]
    try:
        for name in activate:
            if name not in before:
                load_controller(setup, manager, name)
        check(manager.get(name) for name in activate)
        manager.switch(activate=activate, deactivate=deactivate, strict=strict)
    except CanopenError:
        for name in manager.states:
            if name not in before:
                manager.unload(name)
        raise


def require_active(setup: RobotSetup, manager: ControllerManager, name: str) -> None:
    """Raise ControlError, with the command to activate it, if a controller of the file is not active."""
    state = manager.states.get(name, UNLOADED)
    if name in setup.controllers.controllers and state != ControllerState.ACTIVE.value:
        options = [f"--deactivate {' '.join(in_the_way)}"] if (in_the_way := _conflicting(setup, manager, name)) else []
        switch = " ".join((f"canopen-control controller switch --activate {name}", *options))
        raise ControlError(f"{name} is {state}, so it accepts no command; activate it: {switch}")


def _conflicting(setup: RobotSetup, manager: ControllerManager, name: str) -> list[str]:
    """Return the active controllers that own command interfaces which the controller `name`, loaded or not, needs."""
    config = setup.controllers.controllers[name]
    try:
        controller = make_controller(name, config.type)
        controller.description_joints, controller.geometry = (
            setup.description.movable_joints,
            WheelGeometry(setup.description.model),
        )
        controller.on_configure(config.params)
        owners = [manager.registry.command(interface).owner for interface in controller.command_interface_names()]
    except CanopenError:
        return []  # errors of the controller are reported on activation
    return [owner for owner in dict.fromkeys(owners) if owner is not None]


def prepare_controllers(setup: RobotSetup, manager: ControllerManager, registry: InterfaceRegistry) -> None:
    """Load and configure the controllers to activate at the start; a ConfigError names the file."""
    owners: dict[str, str] = {}
    for name in setup.to_activate:
        try:
            load_controller(setup, manager, name)
        except ControlError as error:
            raise RobotConfigError(f"{setup.files.controllers}: {error}") from error
    for name in setup.to_activate:  # after loading all: some export interfaces to others
        try:
            _check_interfaces(name, manager, registry, owners)
        except InterfaceConflict as error:
            config = setup.controllers.controllers[name]
            place = f"{config.path or setup.files.controllers}:{config.line}"
            raise RobotConfigError(
                f"{place}: {name} and {error.owner} cannot be active together: both command {error.interface}; choose "
                f"one for the start, with --controller {name} or --controller {error.owner}"
            ) from error
        except ControlError as error:
            raise RobotConfigError(f"{setup.files.controllers}: {name}: {error}") from error


def _check_interfaces(
    name: str, manager: ControllerManager, registry: InterfaceRegistry, owners: dict[str, str]
) -> None:
    controller = manager.get(name)
    for interface in controller.command_interface_names():
        registry.command(interface)
        if owners.setdefault(interface, name) != name:
            raise InterfaceConflict(interface, owners[interface])
    for interface in controller.state_interface_names():
        if interface != ALL_STATES:
            registry.state(interface)
