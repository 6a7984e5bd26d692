"""Who commands whom among controllers, and the order in which they must run.

The law of the file: a controller that claims another's reference interface runs before it, so that a command passes the
whole chain within one cycle; who reads what another exports starts after it, too; a chain stops as a whole.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.hardware.interfaces import CommandInterface

__all__ = ["ends_of", "in_order", "joints_of", "users_of"]


def _followers(controller: Controller, among: Sequence[Controller]) -> list[Controller]:
    """Return whom a controller commands."""
    wanted = set(controller.command_interface_names())
    return [each for each in among if any(reference.name in wanted for reference in each.reference_interfaces())]


def _below(controller: Controller, among: Sequence[Controller]) -> list[Controller]:
    """Return whom a controller commands, and whose exported states it reads."""
    read = set(controller.state_interface_names())
    commanded = _followers(controller, among)
    return [each for each in among if each in commanded or any(one.name in read for one in each.exported_states())]


def joints_of(controller: Controller, among: Sequence[Controller]) -> list[str]:
    """Return the joints that a controller commands, itself or by way of those of `among` that it commands."""
    chain = [controller]
    for each in chain:  # grows
        chain += [further for further in _followers(each, among) if further not in chain]
    references = {reference.name for each in chain for reference in each.reference_interfaces()}
    names = [name for each in chain for name in each.command_interface_names() if name not in references]
    return list(dict.fromkeys(name.rpartition("/")[0] for name in names))


def in_order(controllers: Sequence[Controller]) -> list[Controller]:
    """Return the controllers with each before those it commands, otherwise in the order given."""
    done: list[Controller] = []

    def add(controller: Controller, on_the_way: tuple[Controller, ...]) -> None:
        for each in controllers:
            if each not in on_the_way and controller in _below(each, controllers):
                add(each, (*on_the_way, controller))
        if controller not in done:
            done.append(controller)

    for controller in controllers:
        add(controller, (controller,))
    return done


def ends_of(controller: Controller, among: Iterable[Controller]) -> tuple[CommandInterface, ...]:
    """Return the hardware's command interfaces that an active controller moves, be it through those it commands."""
    below = {reference.name: each for each in among for reference in each.reference_interfaces()}
    found: dict[str, CommandInterface] = {}
    asked: list[Controller] = []
    todo = [controller]
    while todo:
        asked.append(each := todo.pop())
        for command in each.commands:
            follower = below.get(command.name)
            if follower is None:
                found[command.name] = command
            elif follower not in asked:
                todo.append(follower)
    return tuple(found.values())


def users_of(failed: Sequence[Controller], active: Sequence[Controller]) -> list[Controller]:
    """Return the failed ones and everybody chained to them, above or below, that is active, in running order."""
    group = [each for each in failed if each in active]
    grew = True
    while grew:
        further = [
            each
            for each in active
            if each not in group and any(each in _below(one, active) or one in _below(each, active) for one in group)
        ]
        group += further
        grew = bool(further)
    return in_order(group)
