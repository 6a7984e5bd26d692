"""What a switch request would do, checked as a whole before anything changes.

The law of the file (ros2_control jazzy, switch_controller): an unknown name, an activation of what is active or not
configured, a deactivation of what is not active refuses a strict request and is dropped from a best-effort one; a
command interface that is missing, owned by somebody who stays, wanted twice, or whose component is not ACTIVE refuses
both. A swap is one request: what the leaving controllers release is free for the entering ones. A chain is never torn:
whoever commands a controller that leaves must leave too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.controllers.base import ALL_STATES, ControllerState
from canopen_control.controllers.chain import in_order
from canopen_control.errors import ControlError, InterfaceConflict, UnknownName, nearest
from canopen_control.hardware.interfaces import LifecycleState

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.hardware.interfaces import CommandInterface, HardwareComponent, InterfaceRegistry

__all__ = ["Plan", "make_plan"]


@dataclass(frozen=True)
class Plan:
    """Who stops and who starts, in order, and what each hardware component is asked: (component, start, stop)."""

    activate: tuple[Controller, ...]
    deactivate: tuple[Controller, ...]
    switches: tuple[tuple[HardwareComponent, tuple[str, ...], tuple[str, ...]], ...]


def make_plan(
    controllers: Mapping[str, Controller],
    registry: InterfaceRegistry,
    activate: Sequence[str],
    deactivate: Sequence[str],
    *,
    strict: bool,
) -> Plan:
    """Return what to do, or raise ControlError, InterfaceConflict or UnknownInterface with nothing changed."""
    leaving = _possible(controllers, deactivate, (ControllerState.ACTIVE,), "deactivate", strict=strict)
    allowed = (ControllerState.INACTIVE,)
    again = [name for name in activate if name in controllers and controllers[name] in leaving]
    entering = _possible(
        controllers, [name for name in activate if name not in again], allowed, "activate", strict=strict
    )
    entering += [controllers[name] for name in again]
    _check_chains(controllers, registry, entering, leaving)
    _check_claims(registry, entering, leaving)
    # the commanded start first and stop last, so that a reference always has somebody behind it
    start, stop = tuple(reversed(in_order(entering[::-1]))), tuple(in_order(leaving))
    return Plan(start, stop, _switches(registry, start, stop))


def _possible(
    controllers: Mapping[str, Controller],
    names: Sequence[str],
    states: tuple[ControllerState, ...],
    verb: str,
    *,
    strict: bool,
) -> list[Controller]:
    found: list[Controller] = []
    for name in dict.fromkeys(names):
        controller = controllers.get(name)
        if controller is not None and controller.state in states:
            found.append(controller)
        elif strict and controller is None:
            raise UnknownName(
                f"cannot {verb} {name!r}: no controller of this name is loaded{nearest(name, controllers)}"
            )
        elif strict and controller is not None:
            raise ControlError(f"cannot {verb} {name}: it is {controller.state.value}")
    return found


def _check_chains(
    controllers: Mapping[str, Controller],
    registry: InterfaceRegistry,
    entering: list[Controller],
    leaving: list[Controller],
) -> None:
    stay = [each for each in controllers.values() if each.state is ControllerState.ACTIVE and each not in leaving]
    then = [*stay, *entering]
    available = {reference.name for each in then for reference in each.reference_interfaces()}
    known = {state.name for each in then for state in each.exported_states()}
    for controller in then:
        verb = "deactivate" if controller in stay else "activate"
        for name in controller.command_interface_names():
            if registry.component_of(name) is None and name not in available:
                raise _torn(controller.name, "commands", name, verb)
        for name in controller.state_interface_names():
            if registry.is_exported_state(name) and name not in known:
                raise _torn(controller.name, "reads", name, verb)


def _torn(controller: str, uses: str, name: str, verb: str) -> ControlError:
    with_it = f"{verb} {controller} and {name.partition('/')[0]} together"
    return ControlError(f"{controller} {uses} {name}, whose controller would not be active; {with_it}")


def _check_claims(registry: InterfaceRegistry, entering: list[Controller], leaving: list[Controller]) -> None:
    free = {each.name for each in leaving}
    wanted: dict[str, str] = {}
    for controller in entering:
        for name in controller.command_interface_names():
            interface = registry.command(name)
            _check_component(registry.component_of(name), interface, controller)
            if interface.owner is not None and interface.owner not in free:
                raise InterfaceConflict(name, interface.owner)
            if name in wanted:
                raise InterfaceConflict(name, wanted[name])
            wanted[name] = controller.name
        for name in controller.state_interface_names():
            if name != ALL_STATES:
                registry.state(name)


def _check_component(component: HardwareComponent | None, interface: CommandInterface, controller: Controller) -> None:
    if component is not None and component.state is not LifecycleState.ACTIVE:
        raise ControlError(
            f"cannot activate {controller.name}: {interface.name} belongs to hardware {component.name!r}, "
            f"which is {component.state.value}; it must be active"
        )


def _switches(
    registry: InterfaceRegistry, entering: Sequence[Controller], leaving: Sequence[Controller]
) -> tuple[tuple[HardwareComponent, tuple[str, ...], tuple[str, ...]], ...]:
    result = []
    for component in registry.components:
        own = {each.name for each in component.command_interfaces}
        start = tuple(name for each in entering for name in each.command_interface_names() if name in own)
        stop = tuple(name for each in leaving for name in each.command_interface_names() if name in own)
        if start or stop:
            result.append((component, start, stop))
    return tuple(result)
