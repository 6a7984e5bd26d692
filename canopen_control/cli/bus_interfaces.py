"""What `bus status` tells of CAN interfaces: their state and counters, how much goes over them, who has them open."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from canopen_control.bus.listeners import count_hearing, find_listeners
from canopen_control.bus.traffic import measure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.bus.link import Link

__all__ = ["render_interface", "status_of_interfaces"]

LOOK_S = 0.5
_COMMAND_LENGTH = 60


def status_of_interfaces(links: Sequence[Link]) -> dict[str, dict[str, Any]]:
    """Return the status of interfaces by name; takes half a second to see what goes over those that are up."""
    traffic = measure(links, LOOK_S)
    found = {}
    for link in links:
        status = dataclasses.asdict(link)
        seen = traffic.get(link.name)
        status |= {"frames_per_second": None, "load": None} if seen is None else dataclasses.asdict(seen)
        listeners = find_listeners(link.name)
        status["listeners"] = [dataclasses.asdict(each) for each in listeners]
        named = sum(each.interface is not None and each.identifiers != 0 for each in listeners)
        status["unnamed_listeners"] = max(0, count_hearing(link.name) - named)
        found[link.name] = status
    return found


def render_interface(status: dict[str, Any]) -> list[str]:
    """Return the lines for people."""
    words = [status["kind"], "up" if status["is_up"] else "down"]
    words += [status["state"]] if status["state"] else []
    words += [f"{status['bitrate']} bit/s"] if status["bitrate"] else []
    if status["error_counters"]:
        words.append("transmit errors {}, receive errors {}".format(*status["error_counters"]))
    if status["frames_per_second"] is not None:
        words.append(f"{status['frames_per_second']:.0f} frames/s")
    words += [] if status["load"] is None else [f"load {100 * status['load']:.0f} %"]
    lines = [f"{status['name']}: {', '.join(words)}"]
    for counters in (status["counters"], status["traffic"]):
        seen = [f"{name} {number}" for name, number in counters.items() if number]
        lines += [f"  {', '.join(seen)}"] if seen else []
    return lines + [f"  {line}" for line in _listeners(status)]


def _listeners(status: dict[str, Any]) -> list[str]:
    lines = [_listener(each) for each in status["listeners"]]
    more = status["unnamed_listeners"]
    return lines + ([f"{more} more, of other users: type it with sudo to see them named"] if more else [])


def _listener(listener: dict[str, Any]) -> str:
    command = listener["command"]
    if len(command) > _COMMAND_LENGTH:
        command = command[: _COMMAND_LENGTH - 3] + "..."
    return f"{command} (pid {listener['pid']}) {', '.join(_does(listener))}"


def _does(listener: dict[str, Any]) -> list[str]:
    """Say what a socket hears or lets the kernel send, and where, if not on this interface alone."""
    tasks = [f"lets the kernel send 0x{can_id:03X} every {us / 1000:g} ms" for can_id, us in listener["tasks"]]
    if tasks or listener["protocol"] == "CAN_BCM":
        return tasks or ["uses the kernel's broadcast manager"]
    if listener["protocol"] != "CAN_RAW":
        return [f"has a socket of {listener['protocol']}"]
    identifiers = listener["identifiers"]
    words = [_HEARS.get(identifiers, f"hears {identifiers} identifiers")]
    where = {None: "on an interface that only root is told", "": "of all interfaces"}.get(listener["interface"])
    return words + ([where] if where else [])


_HEARS = {None: "hears some identifiers", -1: "hears everything", 0: "only sends", 1: "hears one identifier"}
