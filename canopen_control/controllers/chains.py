"""Chains of controllers, and the order in which they run.

A controller that claims a reference interface of another controller runs before that controller, so that a command
passes the whole chain within one cycle. A reader of exported states starts after their exporter. A chain stops as a
whole.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.hardware.interfaces import CommandInterface


def _followers(controller: Controller, among: Sequence[Controller]) -> list[Controller]:
    """Return the controllers whose reference interfaces a controller claims."""
    names = set(controller.command_interface_names())
    return [other for other in among if any(reference.name in names for reference in other.reference_interfaces())]


def _below(controller: Controller, among: Sequence[Controller]) -> list[Controller]:
    """Return the controllers whose reference interfaces or exported states a controller uses."""
    read = set(controller.state_interface_names())
    commanded = _followers(controller, among)
    return [other for other in among if other in commanded or any(one.name in read for one in other.exported_states())]


def joints_of(controller: Controller, among: Sequence[Controller]) -> list[str]:
    """Return the joints that a controller commands, directly or through controllers in `among`."""
    chain = [controller]
    for member in chain:  # the list grows in the loop
        chain += [further for further in _followers(member, among) if further not in chain]
    references = {reference.name for member in chain for reference in member.reference_interfaces()}
    names = [name for member in chain for name in member.command_interface_names() if name not in references]
    return list(dict.fromkeys(name.rpartition("/")[0] for name in names))


def in_order(controllers: Sequence[Controller]) -> list[Controller]:
    """Sort controllers stably so that each precedes the controllers that it commands or reads."""
    done: list[Controller] = []

    def add(controller: Controller, pending: tuple[Controller, ...]) -> None:
        for upper in controllers:
            if upper not in pending and controller in _below(upper, controllers):
                add(upper, (*pending, controller))
        if controller not in done:
            done.append(controller)

    for controller in controllers:
        add(controller, (controller,))
    return done


def hardware_interfaces_of(controller: Controller, among: Iterable[Controller]) -> tuple[CommandInterface, ...]:
    """Return the hardware command interfaces that an active controller commands, directly or through a chain."""
    below = {reference.name: lower for lower in among for reference in lower.reference_interfaces()}
    interfaces: dict[str, CommandInterface] = {}
    visited: list[Controller] = []
    todo = [controller]
    while todo:
        visited.append(controller := todo.pop())
        for command in controller.commands:
            follower = below.get(command.name)
            if follower is None:
                interfaces[command.name] = command
            elif follower not in visited:
                todo.append(follower)
    return tuple(interfaces.values())


def users_of(failed: Sequence[Controller], active: Sequence[Controller]) -> list[Controller]:
    """Return the failed controllers that are active, and all active controllers chained to them, in update order."""
    group = [controller for controller in failed if controller in active]
    grew = True
    while grew:
        further = [
            controller
            for controller in active
            if controller not in group
            and any(controller in _below(one, active) or one in _below(controller, active) for one in group)
        ]
        group += further
        grew = bool(further)
    return in_order(group)
