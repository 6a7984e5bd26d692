"""The controllers that are to be activated, made ready before anything is opened.

The law of this file: a type nobody knows, a parameter that is wrong, an interface that no joint has or that two
controllers want is a mistake in a file, and told before the first frame is sent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.controllers.base import ALL_STATES
from canopen_control.errors import ControlError, InterfaceConflict, RobotConfigError, UnknownName
from canopen_control.yamltree import nearest

if TYPE_CHECKING:
    from canopen_control.controllers.manager import ControllerManager
    from canopen_control.hardware.interfaces import InterfaceRegistry
    from canopen_control.runtime.setup import RobotSetup

__all__ = ["load_controller", "prepare_controllers"]


def load_controller(setup: RobotSetup, manager: ControllerManager, name: str) -> None:
    """Load and configure a controller of the file, and its fallbacks; raises ControlError or ConfigError."""
    config = setup.controllers.controllers.get(name)
    if config is None:
        known = setup.controllers.controllers
        raise UnknownName(f"no controller {name!r} in {setup.files.controllers}{nearest(name, known)}")
    loaded = manager.states
    manager.load(name, config.type, config.params, config.fallbacks)
    manager.configure(name)
    for fallback in config.fallbacks:
        if fallback not in loaded and fallback not in setup.wanted:
            load_controller(setup, manager, fallback)


def prepare_controllers(setup: RobotSetup, manager: ControllerManager, registry: InterfaceRegistry) -> None:
    """Load and configure what the robot starts with; raises ConfigError with the file that is wrong."""
    owners: dict[str, str] = {}
    for name in setup.wanted:
        try:
            load_controller(setup, manager, name)
        except ControlError as error:
            raise RobotConfigError(f"{setup.files.controllers}: {error}") from error
    for name in setup.wanted:  # with all of them loaded: some export interfaces to others
        try:
            _check_interfaces(name, manager, registry, owners)
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
