"""CAN interfaces of the kernel: state, settings, traffic and open sockets.

State and settings are read through iproute2's JSON (``ip -json``). Bringing an interface up is a list of commands,
computed from its state and the requested settings, so that they can be shown, run, or omitted if nothing differs.
Changing an interface needs root; without it the error contains the commands to type.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import json
import os
import re
import shlex
import shutil
import socket
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Required, TypedDict

from canopen_control.bus.rawsocket import CAN_RAW_FILTER, EVERYTHING, FILTER_SIZE, NETWORK_CLASS, SOL_CAN_RAW
from canopen_control.errors import ConfigError
from canopen_control.frame import FRAME_BITS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    Run = Callable[[Sequence[str]], "CommandResult"]
    """Function that runs a command to its end; OSError if it cannot be started."""


# Open CAN sockets of an interface: processes, identifiers and cyclic transmissions. The kernel has no table of raw CAN
# sockets with their owners. The protocol comes from the socket's descriptor in /proc (``system.sockprotoname``),
# interface and filters from a copy of the descriptor (pidfd_getfd), tasks of the broadcast manager from
# /proc/net/can-bcm by the socket's inode. The receive lists in /proc/net/can give the number of sockets with filters,
# and thus how many only root can identify.


PROC = Path("/proc")
_PIDFD_GETFD = 438  # system call number on all architectures
_INODE = re.compile(r"socket:\[(\d+)\]")
_BOUND = re.compile(r"bound (\S+)")
_TASK = re.compile(r"^tx_op: ([0-9A-Fa-f]+)\S* .*\bt2=(\d+)", re.MULTILINE)
_MAX_SHOWN = 128  # number of filters: Python reads socket options of up to 1 KiB
_VERB = ("-m", "canopen_control")  # interpreter options may precede it
_RAW, _BCM = "CAN_RAW", "CAN_BCM"
_RECEIVE_LISTS = (
    "all",
    "fil",
    "inv",
    "sff",
    "eff",
)  # the list of error frames also has sockets that receive no frames


@dataclass(frozen=True, slots=True)
class Listener:
    """Open CAN socket of a process.

    `protocol` is the kernel's name, such as ``CAN_RAW``; `interface` is empty for all interfaces, None if the
    descriptor cannot be copied. `identifiers` is the number of received identifiers, -1 for all, 0 for none, None if
    unknown. `tasks` are (identifier, period in us) of the frames that the kernel sends for the socket.
    """

    pid: int
    command: str
    protocol: str
    interface: str | None
    identifiers: int | None = None
    tasks: tuple[tuple[int, int], ...] = ()


def find_listeners(interface: str, proc: Path = PROC) -> list[Listener]:
    """Return the open CAN sockets of an interface, ordered by process id.

    Sockets whose interface this user cannot read are included.
    """
    listeners = (listener for pid in _processes(proc) for listener in _sockets_of(pid, proc))
    return [listener for listener in listeners if listener.interface in (interface, "", None)]


def count_hearing(interface: str, proc: Path = PROC) -> int:
    """Return the number of receivers of an interface's frames: sockets, and tasks of the broadcast manager."""
    receivers = set()
    for path in (proc / "net" / "can" / f"rcvlist_{name}" for name in _RECEIVE_LISTS):
        with contextlib.suppress(OSError):
            for line in path.read_text().splitlines():
                words = line.split()
                if len(words) == 7 and words[0] in (interface, "any"):
                    receivers.add((words[4], words[6]))  # userdata (the socket or the task); ident
    return len(receivers)


def _processes(proc: Path) -> list[int]:
    return sorted(int(entry.name) for entry in proc.iterdir() if entry.name.isdecimal())


def _sockets_of(pid: int, proc: Path) -> Iterator[Listener]:
    folder = proc / str(pid) / "fd"
    inodes = set()
    try:
        descriptors = sorted(folder.iterdir(), key=lambda entry: int(entry.name))
    except OSError:
        return  # the process ended, or belongs to another user
    for entry in descriptors:
        with contextlib.suppress(OSError):
            match = _INODE.fullmatch(os.readlink(entry))
            if match is None or match[1] in inodes:
                continue
            inodes.add(match[1])
            protocol = os.getxattr(entry, "system.sockprotoname").rstrip(b"\0").decode()
            if protocol.startswith("CAN"):
                yield _listener(pid, int(entry.name), match[1], protocol, proc)


def _listener(pid: int, descriptor: int, inode: str, protocol: str, proc: Path) -> Listener:
    command = _command(pid, proc)
    if protocol == _BCM:
        interface, tasks = _bcm(inode, proc)
        return Listener(pid, command, protocol, interface, 0 if tasks else None, tasks)
    try:
        interface, identifiers = _borrowed(pid, descriptor, protocol)
    except OSError:
        interface, identifiers = None, None
    return Listener(pid, command, protocol, interface, identifiers)


def _command(pid: int, proc: Path) -> str:
    """Return the command line of a process; commands of this package are shown as `canopen-control VERB`."""
    words = (proc / str(pid) / "cmdline").read_bytes().decode(errors="replace").split("\0")
    words = [word for word in words if word]
    if len(words) == 1:  # a fork overwrites its command line with one string, see `canopen_control.host.fork`
        words = words[0].split(" ")
    if _VERB in itertools.pairwise(words[1:4]):
        return " ".join(["canopen-control", *words[words.index("canopen_control") + 1 :]])
    if len(words) > 1 and Path(words[0]).name.startswith("python") and not words[1].startswith("-"):
        words = words[1:]
    return " ".join([Path(words[0]).name, *words[1:]]) if words else f"process {pid}"


def _bcm(inode: str, proc: Path) -> tuple[str | None, tuple[tuple[int, int], ...]]:
    try:
        text = (proc / "net" / "can-bcm" / inode).read_text()
    except OSError:
        return None, ()
    bound = _BOUND.search(text)
    tasks = tuple((int(identifier, 16), int(period)) for identifier, period in _TASK.findall(text))
    return (None if bound is None else bound[1].replace("any", "")), tasks


def _borrowed(pid: int, descriptor: int, protocol: str) -> tuple[str, int | None]:
    """Return the interface and the number of identifiers of another process's socket; raise OSError if denied."""
    process = os.pidfd_open(pid)
    try:
        number = _pidfd_getfd(process, descriptor)
    finally:
        os.close(process)
    with socket.socket(fileno=number) as sock:
        interface = str(sock.getsockname()[0])
        return interface, _identifiers(sock) if protocol == _RAW else None


def _pidfd_getfd(process: int, descriptor: int) -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    number = int(libc.syscall(_PIDFD_GETFD, process, descriptor, 0))
    if number < 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))
    return number


def _identifiers(sock: socket.socket) -> int | None:
    try:
        filters = sock.getsockopt(SOL_CAN_RAW, CAN_RAW_FILTER, _MAX_SHOWN * FILTER_SIZE)
    except OSError:  # there are more filters
        return None
    return -1 if filters == EVERYTHING else len(filters) // FILTER_SIZE


# Frame rates and bus load from the counters of the kernel's interfaces. A virtual interface counts its frames in both
# directions, so that only one direction is used. The load is computed without stuff bits, as in `runtime.robot_bus`;
# the true load is up to a fifth higher.


_LOOPED = ("vcan",)
_COUNTERS = ("packets", "bytes")


@dataclass(frozen=True, slots=True)
class Traffic:
    """Traffic of an interface; `load` is the bus load, or None if the interface has no bit rate."""

    frames_per_second: float
    load: float | None


def measure(
    links: Iterable[CanInterface],
    seconds: float,
    *,
    sleep: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
    network_class: Path = NETWORK_CLASS,
) -> dict[str, Traffic]:
    """Measure the traffic of all active interfaces for `seconds`; return it by name, except for removed ones."""
    before = {link.name: (link, _counted(link, network_class)) for link in links if link.is_up}
    since = clock()
    if before:
        sleep(seconds)
    traffic = {}
    for name, (link, first) in before.items():
        last = _counted(link, network_class)
        if first is not None and last is not None:
            traffic[name] = _traffic(link, last[0] - first[0], last[1] - first[1], clock() - since)
    return traffic


def _traffic(link: CanInterface, frames: int, size: int, seconds: float) -> Traffic:
    bits = FRAME_BITS * frames + 8 * size
    return Traffic(frames / seconds, bits / seconds / link.bitrate if link.bitrate else None)


def _counted(link: CanInterface, network_class: Path) -> tuple[int, int] | None:
    """Return the numbers of frames and data bytes since the interface was created, or None if it is gone."""
    folder = network_class / link.name / "statistics"
    directions = ("tx",) if link.kind in _LOOPED else ("rx", "tx")
    try:
        frames, size = (
            sum(int((folder / f"{direction}_{counter}").read_text()) for direction in directions)
            for counter in _COUNTERS
        )
    except (OSError, ValueError):
        return None
    return frames, size


QUEUE_LENGTH = 1000
_VIRTUAL = ("vcan", "vxcan")
_TIMEOUT_S = 15.0
_LIST = "list the interfaces with: canopen-control bus list"


@dataclass(frozen=True, slots=True)
class CanInterface:
    """State of a CAN interface; attributes unknown to the kernel, as for virtual interfaces, are None.

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
    counters: Mapping[str, int] = field(default_factory=dict)  # counters of the controller: bus_error, bus_off, ...
    traffic: Mapping[str, int] = field(default_factory=dict)  # rx_packets, rx_dropped, tx_packets, ...


class CommandResult(NamedTuple):
    """Exit status and output of a command."""

    returncode: int
    output: str
    error: str


class InterfaceCommand(NamedTuple):
    """Command that changes an interface, with its reason.

    A failure of an `optional` command is ignored: if the command was necessary, a later one fails too.
    """

    argv: tuple[str, ...]
    purpose: str
    optional: bool = False

    def __str__(self) -> str:
        return shlex.join(self.argv)


def run_command(argv: Sequence[str]) -> CommandResult:
    """Run a command to its end; raise OSError if it cannot be started, TimeoutExpired after 15 s."""
    done = subprocess.run(argv, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
    return CommandResult(done.returncode, done.stdout, done.stderr.strip())


# -- state


class _Timing(TypedDict, total=False):
    bitrate: int
    sample_point: float | str  # text in some versions of iproute2


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
    """Interface in the output of ``ip -json``, limited to the keys used here."""

    ifname: Required[str]
    link_type: str
    flags: list[str]
    txqlen: int
    linkinfo: _LinkInfo
    stats64: dict[str, dict[str, int]]  # by direction, rx and tx


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
        traffic={
            f"{direction}_{name}": n
            for direction, counters in entry.get("stats64", {}).items()
            for name, n in counters.items()
        },
    )


def list_can_interfaces(run: Run = run_command) -> list[CanInterface]:
    """Return all CAN interfaces; raise ConfigError if iproute2 is missing or fails."""
    try:
        result = run(("ip", "-json", "-details", "-statistics", "link", "show"))
    except OSError as error:
        raise ConfigError(f"ip cannot be run ({error.strerror}); install iproute2") from error
    if result.returncode:
        raise ConfigError(f"ip link show failed: {result.error}")
    return parse_can_interfaces(result.output)


def find_can_interface(name: str, run: Run = run_command) -> CanInterface | None:
    """Return the CAN interface of this name, or None."""
    return next((link for link in list_can_interfaces(run) if link.name == name), None)


# -- settings


def _ip(purpose: str, *words: str) -> InterfaceCommand:
    return InterfaceCommand(("ip", "link", *words), purpose)


def _up_virtual(name: str, kind: str, link: CanInterface | None) -> list[InterfaceCommand]:
    commands = []
    if link is None:
        commands = [
            InterfaceCommand(("modprobe", kind), f"load the {kind} module", optional=True),  # or built in
            _ip("create the interface", "add", "dev", name, "type", kind),
        ]
    if link is None or link.queue_length != QUEUE_LENGTH:
        commands.append(_ip("lengthen the transmit queue", "set", name, "txqueuelen", str(QUEUE_LENGTH)))
    if link is None or not link.is_up:
        commands.append(_ip("bring it up", "set", name, "up"))
    return commands


def _up_real(
    link: CanInterface, bitrate: int | None, restart_ms: int | None, sample_point: float | None
) -> list[InterfaceCommand]:
    settings: dict[str, float | None] = {"bitrate": bitrate, "sample-point": sample_point, "restart-ms": restart_ms}
    present: dict[str, float | None] = {
        "bitrate": link.bitrate,
        "sample-point": link.sample_point,
        "restart-ms": link.restart_ms,
    }
    changed = {key: value for key, value in settings.items() if value is not None and value != present[key]}
    rate = bitrate or link.bitrate
    if rate is not None and "sample-point" in changed:
        changed["bitrate"] = rate  # the kernel computes the bit timing from both
    commands = []
    # in the other cases the kernel restarts the interface
    if link.is_up and link.state == "BUS-OFF" and not changed and not link.restart_ms:
        commands.append(_ip("restart it after bus-off", "set", link.name, "type", "can", "restart"))
    if changed and link.is_up:
        commands.append(_ip("bring it down to change the settings", "set", link.name, "down"))
    if changed:
        words = [word for key in settings if key in changed for word in (key, str(changed[key]))]
        commands.append(_ip("configure the controller", "set", link.name, "type", "can", *words))
    if link.queue_length != QUEUE_LENGTH:
        commands.append(_ip("lengthen the transmit queue", "set", link.name, "txqueuelen", str(QUEUE_LENGTH)))
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
) -> list[InterfaceCommand]:
    """Return the commands that bring an interface up with these settings; [] if nothing needs to be done.

    `link` is the current state of the interface, None if there is no such interface. Raise ConfigError if a CAN adapter
    or its bit rate is missing, or if a virtual interface is given a bit rate or sample point.
    """
    kind = link.kind if link is not None else next((kind for kind in _VIRTUAL if name.startswith(kind)), "can")
    if kind in _VIRTUAL:
        if bitrate is not None or sample_point is not None:
            raise ConfigError(f"{name} is a {kind} interface and has no bit rate; omit the option")
        return _up_virtual(name, kind, link)
    if link is None:
        raise ConfigError(f"no CAN interface {name!r}; check that the adapter is plugged in; {_LIST}")
    if bitrate is None and link.bitrate is None and kind == "can":
        raise ConfigError(f"{name} has no bit rate yet; add --bitrate 1000000, or the bit rate of the drives")
    return _up_real(link, bitrate, restart_ms, sample_point)


def bring_up(
    name: str,
    report: Callable[[str], None],
    *,
    bitrate: int | None = None,
    restart_ms: int | None = None,
    sample_point: float | None = None,
    run: Run = run_command,
) -> None:
    """Bring an interface up with these settings and report each step.

    Raise ConfigError if rights are missing (with the commands to type), or if a setting is missing or refused.
    """
    link = find_can_interface(name, run)
    commands = up_commands(name, link, bitrate=bitrate, restart_ms=restart_ms, sample_point=sample_point)
    if not commands:
        report(f"{name} is up already")
    _run_all(name, commands, report, run)


def bring_down(name: str, report: Callable[[str], None], *, run: Run = run_command) -> None:
    """Bring an interface down; a virtual interface continues to exist. Raise ConfigError as `bring_up` does."""
    link = find_can_interface(name, run)
    if link is None:
        raise ConfigError(f"no CAN interface {name!r}; {_LIST}")
    if not link.is_up:
        report(f"{name} is down already")
        return
    _run_all(name, [_ip("bring it down", "set", name, "down")], report, run)


def _run_all(name: str, commands: Sequence[InterfaceCommand], report: Callable[[str], None], run: Run) -> None:
    prefix = _privilege(name, commands, run) if commands else ()
    for command in commands:
        full_command = command._replace(argv=(*prefix, *command.argv))
        report(f"{full_command}   # {command.purpose}")
        problem = _problem(full_command, run)
        if problem and not command.optional:
            raise ConfigError(f"{name}: {full_command} failed: {problem}")


def _problem(command: InterfaceCommand, run: Run) -> str:
    """Run a command; return "", or a message with advice if it failed."""
    try:
        result = run(command.argv)
    except OSError as error:
        return f"{error.strerror}; install iproute2"
    if result.returncode == 0:
        return ""
    reason = result.error.removeprefix("Error: ").rstrip(".")
    return reason + next((f"; {advice}" for text, advice in _ADVICE.items() if text in reason), "")


def _privilege(name: str, commands: Sequence[InterfaceCommand], run: Run) -> tuple[str, ...]:
    """Return the command prefix for root permissions (empty for root); raise ConfigError if none is available."""
    if os.geteuid() == 0:
        return ()
    if shutil.which("sudo") and run(("sudo", "-n", "true")).returncode == 0:
        return ("sudo", "-n")
    commands_as_root = " && ".join(f"sudo {command}" for command in commands)
    raise ConfigError(f"{name}: root permissions are needed; run: {commands_as_root}")


_ADVICE = {
    "Operation not permitted": "CAP_NET_ADMIN is required; in a container, run the command on the host",
    "Numerical argument out of domain": "the controller does not support this bit rate or sample point",
    "Invalid argument": "a CAN interface needs a bit rate first: --bitrate 1000000",
    "Unknown device type": "this kernel does not support it; to use a bus without kernel CAN, write local:NAME",
    "Operation not supported": "this kernel does not support it; to use a bus without kernel CAN, write local:NAME",
}
