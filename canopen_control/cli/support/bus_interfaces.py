"""What `bus status` tells of CAN interfaces: their state and counters, how much goes over them, who has them open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.bus.listeners import Listener, count_hearing, find_listeners
from canopen_control.bus.traffic import measure
from canopen_control.rpc.messages.declare import Document

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.bus.can_interfaces import CanInterface
    from canopen_control.bus.traffic import Traffic

__all__ = ["InterfaceDocument", "InterfaceStatus", "document_of", "render_interface", "status_of_interfaces"]

LOOK_S = 0.5
_COMMAND_LENGTH = 60


@dataclass(frozen=True, slots=True)
class InterfaceStatus:
    """A CAN interface; `traffic` is None of one that is down, `unnamed_listeners` are sockets of other users."""

    link: CanInterface
    traffic: Traffic | None
    listeners: list[Listener]
    unnamed_listeners: int


class InterfaceDocument(Document, frozen=True, kw_only=True):
    """A CAN interface as `bus status --json` prints it; see CanInterface, Traffic and Listener. Null is not known."""

    name: str
    kind: str
    is_up: bool
    queue_length: int
    state: str | None
    bitrate: int | None
    sample_point: float | None
    restart_ms: int | None
    error_counters: tuple[int, int] | None
    counters: dict[str, int]
    traffic: dict[str, int]
    frames_per_second: float | None
    load: float | None
    listeners: list[Listener]
    unnamed_listeners: int


def document_of(status: InterfaceStatus) -> InterfaceDocument:
    """Return the status of an interface as `--json` prints it."""
    link, traffic = status.link, status.traffic
    return InterfaceDocument(
        name=link.name,
        kind=link.kind,
        is_up=link.is_up,
        queue_length=link.queue_length,
        state=link.state,
        bitrate=link.bitrate,
        sample_point=link.sample_point,
        restart_ms=link.restart_ms,
        error_counters=link.error_counters,
        counters=dict(link.counters),
        traffic=dict(link.traffic),
        frames_per_second=None if traffic is None else traffic.frames_per_second,
        load=None if traffic is None else traffic.load,
        listeners=status.listeners,
        unnamed_listeners=status.unnamed_listeners,
    )


def status_of_interfaces(links: Sequence[CanInterface]) -> dict[str, InterfaceStatus]:
    """Return the status of interfaces by name; takes half a second to see what goes over those that are up."""
    traffic = measure(links, LOOK_S)
    return {link.name: _status(link, traffic.get(link.name)) for link in links}


def _status(link: CanInterface, traffic: Traffic | None) -> InterfaceStatus:
    listeners = find_listeners(link.name)
    named = sum(each.interface is not None and each.identifiers != 0 for each in listeners)
    return InterfaceStatus(link, traffic, listeners, max(0, count_hearing(link.name) - named))


def render_interface(status: InterfaceStatus) -> list[str]:
    """Return the lines for people."""
    link, traffic = status.link, status.traffic
    words = [link.kind, "up" if link.is_up else "down"]
    words += [link.state] if link.state else []
    words += [f"{link.bitrate} bit/s"] if link.bitrate else []
    if link.error_counters:
        words.append("transmit errors {}, receive errors {}".format(*link.error_counters))
    words += [] if traffic is None else [f"{traffic.frames_per_second:.0f} frames/s"]
    words += [] if traffic is None or traffic.load is None else [f"load {100 * traffic.load:.0f} %"]
    lines = [f"{link.name}: {', '.join(words)}"]
    for counters in (link.counters, link.traffic):
        seen = [f"{name} {number}" for name, number in counters.items() if number]
        lines += [f"  {', '.join(seen)}"] if seen else []
    return lines + [f"  {line}" for line in _listeners(status)]


def _listeners(status: InterfaceStatus) -> list[str]:
    lines = [_listener(each) for each in status.listeners]
    more = status.unnamed_listeners
    return lines + ([f"{more} more, of other users: type it with sudo to see them named"] if more else [])


def _listener(listener: Listener) -> str:
    command = listener.command
    if len(command) > _COMMAND_LENGTH:
        command = command[: _COMMAND_LENGTH - 3] + "..."
    return f"{command} (pid {listener.pid}) {', '.join(_does(listener))}"


def _does(listener: Listener) -> list[str]:
    """Say what a socket hears or lets the kernel send, and where, if not on this interface alone."""
    tasks = [f"lets the kernel send 0x{can_id:03X} every {us / 1000:g} ms" for can_id, us in listener.tasks]
    if tasks or listener.protocol == "CAN_BCM":
        return tasks or ["uses the kernel's broadcast manager"]
    if listener.protocol != "CAN_RAW":
        return [f"has a socket of {listener.protocol}"]
    identifiers = listener.identifiers
    words = [_HEARS.get(identifiers, f"hears {identifiers} identifiers")]
    where = {None: "on an interface that only root is told", "": "of all interfaces"}.get(listener.interface)
    return words + ([where] if where else [])


_HEARS = {None: "hears some identifiers", -1: "hears everything", 0: "only sends", 1: "hears one identifier"}
