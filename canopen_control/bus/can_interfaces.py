"""CAN interfaces of the kernel, seen and set through iproute2's JSON (``ip -json``), never through text for people.

Bringing one up is a list of commands, made from what is there and what is wanted, so that they can be shown, run, or
found to be none. Changing an interface needs root; without it the error holds the commands to type.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Required, TypedDict

from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    Run = Callable[[Sequence[str]], "Result"]
    """Runs a command to its end; OSError if it cannot be started."""

__all__ = [
    "CanInterface",
    "Command",
    "Result",
    "bring_down",
    "bring_up",
    "find_can_interface",
    "list_can_interfaces",
    "parse_can_interfaces",
    "run_command",
    "up_commands",
]

QUEUE_LENGTH = 1000
_VIRTUAL = ("vcan", "vxcan")
_TIMEOUT_S = 15.0


@dataclass(frozen=True, slots=True)
class CanInterface:
    """A CAN interface; None where the kernel does not say, as with virtual ones.

    `bitrate` in bit/s, `restart_ms` 0 for no automatic restart after bus-off, `state` such as ``ERROR-ACTIVE``.
    """

    name: str
    kind: str
    is_up: bool
    queue_length: int = 0
    state: str | None = None
    bitrate: int | None = None
    sample_point: float | None = None
    restart_ms: int | None = None
    error_counters: tuple[int, int] | None = None  # transmit, receive
    counters: Mapping[str, int] = field(default_factory=dict)  # what the controller counted: bus_error, bus_off, ...
    traffic: Mapping[str, int] = field(default_factory=dict)  # rx_packets, rx_dropped, tx_packets, ...


class Result(NamedTuple):
    """How a command ended."""

    returncode: int
    output: str
    error: str


class Command(NamedTuple):
    """One step, with why in a word or two; an `optional` one may fail, because a later one would tell."""

    argv: tuple[str, ...]
    purpose: str
    optional: bool = False

    def __str__(self) -> str:
        return shlex.join(self.argv)


def run_command(argv: Sequence[str]) -> Result:
    """Run a command to its end; OSError if it cannot be started."""
    done = subprocess.run(argv, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
    return Result(done.returncode, done.stdout, done.stderr.strip())


# Seeing ------------------------------------------------------------------------------------------------------------


class _Timing(TypedDict, total=False):
    bitrate: int
    sample_point: float | str  # a text in some versions


class _Counters(TypedDict, total=False):
    tx: int
    rx: int


class _Controller(TypedDict, total=False):
    state: str
    bittiming: _Timing
    bittiming_bitrate: int
    restart_ms: int
    berr_counter: _Counters


class _LinkInfo(TypedDict, total=False):
    info_kind: str
    info_data: _Controller
    info_xstats: dict[str, int]


class _Entry(TypedDict, total=False):
    """An interface as ``ip -json`` tells it, as far as it is used here."""

    ifname: Required[str]
    link_type: str
    flags: list[str]
    txqlen: int
    linkinfo: _LinkInfo
    stats64: dict[str, dict[str, int]]  # by way, rx and tx


def parse_can_interfaces(text: str) -> list[CanInterface]:
    """Return the CAN interfaces in the output of ``ip -json -details -statistics link show``."""
    entries: list[_Entry] = json.loads(text or "[]")
    return [_link(entry) for entry in entries if entry.get("link_type") == "can"]


def _link(entry: _Entry) -> CanInterface:
    info = entry.get("linkinfo", _LinkInfo())
    data = info.get("info_data", _Controller())
    timing = data.get("bittiming", _Timing())
    counters = data.get("berr_counter")
    sample_point = timing.get("sample_point")
    return CanInterface(
        name=entry["ifname"],
        kind=info.get("info_kind", "can"),
        is_up="UP" in entry.get("flags", ()),
        queue_length=entry.get("txqlen", 0),
        state=data.get("state"),
        bitrate=timing.get("bitrate") or data.get("bittiming_bitrate"),
        sample_point=None if sample_point is None else float(sample_point),
        restart_ms=data.get("restart_ms"),
        error_counters=None if counters is None else (counters.get("tx", 0), counters.get("rx", 0)),
        counters=dict(info.get("info_xstats", {})),
        traffic={f"{way}_{name}": n for way, each in entry.get("stats64", {}).items() for name, n in each.items()},
    )


def list_can_interfaces(run: Run = run_command) -> list[CanInterface]:
    """Return all CAN interfaces; raise `ConfigError` where iproute2 is missing or fails."""
    try:
        result = run(("ip", "-json", "-details", "-statistics", "link", "show"))
    except OSError as error:
        raise ConfigError(f"ip cannot be run ({error.strerror}); install iproute2") from error
    if result.returncode:
        raise ConfigError(f"ip link show failed: {result.error}")
    return parse_can_interfaces(result.output)


def find_can_interface(name: str, run: Run = run_command) -> CanInterface | None:
    """Return the CAN interface of this name, None if there is none."""
    return next((link for link in list_can_interfaces(run) if link.name == name), None)


# Setting -----------------------------------------------------------------------------------------------------------


def _ip(purpose: str, *words: str) -> Command:
    return Command(("ip", "link", *words), purpose)


def _up_virtual(name: str, kind: str, link: CanInterface | None) -> list[Command]:
    commands = []
    if link is None:
        commands = [
            Command(("modprobe", kind), f"load the {kind} module", optional=True),  # it may be built in
            _ip("make the interface", "add", "dev", name, "type", kind),
        ]
    if link is None or link.queue_length != QUEUE_LENGTH:
        commands.append(_ip("lengthen its queue", "set", name, "txqueuelen", str(QUEUE_LENGTH)))
    if link is None or not link.is_up:
        commands.append(_ip("bring it up", "set", name, "up"))
    return commands


def _up_real(
    link: CanInterface, bitrate: int | None, restart_ms: int | None, sample_point: float | None
) -> list[Command]:
    wanted: dict[str, float | None] = {"bitrate": bitrate, "sample-point": sample_point, "restart-ms": restart_ms}
    present: dict[str, float | None] = {
        "bitrate": link.bitrate,
        "sample-point": link.sample_point,
        "restart-ms": link.restart_ms,
    }
    changed = {key: value for key, value in wanted.items() if value is not None and value != present[key]}
    rate = bitrate or link.bitrate
    if rate is not None and "sample-point" in changed:
        changed["bitrate"] = rate  # the kernel computes the timing from both
    commands = []
    if link.is_up and link.state == "BUS-OFF" and not changed and not link.restart_ms:  # else the kernel does it
        commands.append(_ip("restart it after bus-off", "set", link.name, "type", "can", "restart"))
    if changed and link.is_up:
        commands.append(_ip("take it down to change it", "set", link.name, "down"))
    if changed:
        words = [word for key in wanted if key in changed for word in (key, str(changed[key]))]
        commands.append(_ip("set the controller", "set", link.name, "type", "can", *words))
    if link.queue_length != QUEUE_LENGTH:
        commands.append(_ip("lengthen its queue", "set", link.name, "txqueuelen", str(QUEUE_LENGTH)))
    if changed or not link.is_up:
        commands.append(_ip("bring it up", "set", link.name, "up"))
    return commands


def up_commands(
    name: str,
    link: CanInterface | None,
    *,
    bitrate: int | None = None,
    restart_ms: int | None = None,
    sample_point: float | None = None,
) -> list[Command]:
    """Return what has to be done to bring an interface up as wanted, nothing if it is; `link` is what is there."""
    kind = link.kind if link is not None else next((kind for kind in _VIRTUAL if name.startswith(kind)), "can")
    if kind in _VIRTUAL:
        if bitrate is not None or sample_point is not None:
            raise ConfigError(f"{name} is a {kind} interface and has no bit rate; leave the option away")
        return _up_virtual(name, kind, link)
    if link is None:
        raise ConfigError(
            f"no CAN interface {name!r}; is the adapter plugged in? What there is: canopen-control bus list"
        )
    if bitrate is None and link.bitrate is None and kind == "can":
        raise ConfigError(f"{name} has no bit rate yet; add --bitrate 1000000, or what your drives are set to")
    return _up_real(link, bitrate, restart_ms, sample_point)


def bring_up(
    name: str,
    say: Callable[[str], None],
    *,
    bitrate: int | None = None,
    restart_ms: int | None = None,
    sample_point: float | None = None,
    run: Run = run_command,
) -> None:
    """Bring an interface up as wanted, and say each step; nothing to do is said too.

    Raise `ConfigError` with the commands to type where rights are missing, or with what is missing or refused.
    """
    link = find_can_interface(name, run)
    commands = up_commands(name, link, bitrate=bitrate, restart_ms=restart_ms, sample_point=sample_point)
    if not commands:
        say(f"{name} is up already")
    _run_all(name, commands, say, run)


def bring_down(name: str, say: Callable[[str], None], *, run: Run = run_command) -> None:
    """Bring an interface down; a virtual one stays and can be brought up again. Errors as with `bring_up`."""
    link = find_can_interface(name, run)
    if link is None:
        raise ConfigError(f"no CAN interface {name!r}; what there is: canopen-control bus list")
    if not link.is_up:
        say(f"{name} is down already")
        return
    _run_all(name, [_ip("take it down", "set", name, "down")], say, run)


def _run_all(name: str, commands: Sequence[Command], say: Callable[[str], None], run: Run) -> None:
    prefix = _privilege(name, commands, run) if commands else ()
    for command in commands:
        whole = command._replace(argv=(*prefix, *command.argv))
        say(f"{whole}   # {command.purpose}")
        problem = _problem(whole, run)
        if problem and not command.optional:
            raise ConfigError(f"{name}: {whole} failed: {problem}")


def _problem(command: Command, run: Run) -> str:
    """Run a command and return what went wrong, with advice; empty if nothing did."""
    try:
        result = run(command.argv)
    except OSError as error:
        return f"{error.strerror}; install iproute2"
    if result.returncode == 0:
        return ""
    said = result.error.removeprefix("Error: ").rstrip(".")
    return said + next((f"; {advice}" for text, advice in _ADVICE.items() if text in said), "")


def _privilege(name: str, commands: Sequence[Command], run: Run) -> tuple[str, ...]:
    """Return the words before a command that make it run as root; raise `ConfigError` where there is no way."""
    if os.geteuid() == 0:
        return ()
    if shutil.which("sudo") and run(("sudo", "-n", "true")).returncode == 0:
        return ("sudo", "-n")
    typed = " && ".join(f"sudo {command}" for command in commands)
    raise ConfigError(f"{name}: this needs root; type: {typed}")


_ADVICE = {
    "Operation not permitted": "it needs the right CAP_NET_ADMIN; in a container, run it on the host",
    "Numerical argument out of domain": "the controller cannot make this bit rate or sample point",
    "Invalid argument": "a CAN interface needs a bit rate first: --bitrate 1000000",
    "Unknown device type": "this kernel has none; the bus without kernel CAN is local:NAME",
    "Operation not supported": "this kernel has none; the bus without kernel CAN is local:NAME",
}
