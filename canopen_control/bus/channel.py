"""Channel names, and the opening of channels of every kind.

``local:NAME``      our bus between processes, without kernel CAN
``memory:NAME``     inside one process, for tests
``virtual:NAME``    python-can's virtual bus, inside one process
``can0``, ``vcan0`` a SocketCAN interface; one with an unusual name as ``socketcan:NAME``
``pcan:PCAN_USBBUS1``, ``slcan:/dev/ttyACM0@500000``  any python-can interface, with its bit rate after the @
``kvaser:0@500000,receive_own_messages=true``         with further keywords of its python-can class, after commas
``socketcand:HOST:PORT/can0``                         a CAN interface that socketcand serves; port 29536 if not given

The back end is imported when a channel of its kind is opened, and not before.
"""

from __future__ import annotations

import enum
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.bus.port import Port


_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")
_LIKE_SOCKETCAN = re.compile(r"(can|vcan|vxcan|slcan)\d+")
_INTERFACE = re.compile(r"[^\s/:\0]{1,15}")  # Linux: IFNAMSIZ without the terminating zero
NETWORK_CLASS = Path("/sys/class/net")
_ARPHRD_CAN = "280"  # linux/if_arp.h
_OPTION = re.compile(r",(?=[A-Za-z_]\w*=)")  # start of a keyword of python-can
_KEY_PLACES = {"channel": "before the comma", "interface": "before the colon", "bitrate": "after an @"}
_SOCKETCAND = "socketcand"
_SERVED = re.compile(r"(?P<host>[^\s:/]+)(?::(?P<port>\d{1,5}))?/(?P<channel>[^\s/]+)")
_SOCKETCAND_PORT = "29536"
SERVED: Final = frozenset({"remote", _SOCKETCAND, "udp_multicast"})
"""python-can interfaces that reach a bus through a server or a network; several processes can share such a bus."""


class ChannelKind(enum.Enum):
    """Kind of a channel, which determines how it is opened."""

    LOCAL = "local"
    MEMORY = "memory"
    VIRTUAL = "virtual"
    SOCKETCAN = "socketcan"
    PYTHON_CAN = "python-can"

    @property
    def in_process(self) -> bool:
        """Whether the bus exists only inside one process."""
        return self in (ChannelKind.MEMORY, ChannelKind.VIRTUAL)

    @property
    def shared(self) -> bool:
        """Whether several processes can open the bus; a python-can adapter has one owner."""
        return self in (ChannelKind.LOCAL, ChannelKind.SOCKETCAN)


@dataclass(frozen=True, slots=True)
class ChannelSpec:
    """Parts of a channel name; `interface`, `bitrate` (bit/s) and `options` are set for python-can only.

    `options` are pairs of a keyword and a value as text.
    """

    kind: ChannelKind
    name: str
    interface: str = ""
    bitrate: int | None = None
    options: tuple[tuple[str, str], ...] = ()

    def __str__(self) -> str:
        if self.kind is ChannelKind.SOCKETCAN:
            return self.name
        if self.kind is ChannelKind.PYTHON_CAN:
            rate = f"@{self.bitrate}" if self.bitrate else ""
            return f"{self.interface}:{self.name}{rate}" + "".join(f",{key}={value}" for key, value in self.options)
        return f"{self.kind.value}:{self.name}"


def parse_channel(text: str) -> ChannelSpec:
    """Return the parts of a channel name; raise ConfigError, with the valid forms, if it is invalid."""
    prefix, colon, name = text.partition(":")
    if not colon:
        return _network_interface(text)
    if prefix in _OWN_KINDS:
        kind = ChannelKind(prefix)
        if not _NAME.fullmatch(name):
            raise ConfigError(f"channel {text!r}: the name after {prefix}: is 1 to 32 letters, digits, - and _")
        return ChannelSpec(kind, name)
    if prefix == "socketcan" and _INTERFACE.fullmatch(name):
        return ChannelSpec(ChannelKind.SOCKETCAN, name)
    return _python_can(text, prefix, name)


_OWN_KINDS = frozenset(kind.value for kind in (ChannelKind.LOCAL, ChannelKind.MEMORY, ChannelKind.VIRTUAL))


def _network_interface(text: str) -> ChannelSpec:
    if _LIKE_SOCKETCAN.fullmatch(text) or (_INTERFACE.fullmatch(text) and _is_can_interface(text)):
        return ChannelSpec(ChannelKind.SOCKETCAN, text)
    hint = f"to use a bus without kernel CAN, write local:{text}" if _NAME.fullmatch(text) else "try local:robby"
    raise ConfigError(f"channel {text!r}: no such CAN interface; {hint}")


def _is_can_interface(name: str) -> bool:
    try:
        return (NETWORK_CLASS / name / "type").read_text().strip() == _ARPHRD_CAN
    except OSError:
        return False


def _python_can(text: str, interface: str, name: str) -> ChannelSpec:
    name, *words = _OPTION.split(name)
    channel, at, rate = name.rpartition("@")
    if not at:
        channel, rate = name, ""
    if not interface or not channel or (at and not rate.isdecimal()):
        raise ConfigError(
            f"channel {text!r}: write INTERFACE:CHANNEL or INTERFACE:CHANNEL@BITRATE, as in pcan:PCAN_USBBUS1@500000; "
            "other keywords of python-can follow as ,KEY=VALUE"
        )
    options = tuple((key, value) for key, _, value in (word.partition("=") for word in words))
    keys = [key for key, _ in options]
    for key in keys:
        if key in _KEY_PLACES:
            raise ConfigError(f"channel {text!r}: write {key} {_KEY_PLACES[key]}, as in pcan:PCAN_USBBUS1@500000")
        if keys.count(key) > 1:
            raise ConfigError(f"channel {text!r}: {key} is given twice; omit one of them")
    spec = ChannelSpec(ChannelKind.PYTHON_CAN, channel, interface, int(rate) if rate else None, options)
    if interface == _SOCKETCAND:
        _check_socketcand(spec, text)
    return spec


def _check_socketcand(spec: ChannelSpec, text: str) -> None:
    """Raise ConfigError unless a socketcand channel has a server, as HOST:PORT/CHANNEL or as keywords."""
    keys = {key for key, _ in spec.options}
    if not _SERVED.fullmatch(spec.name) and not {"host", "port"} <= keys:
        raise ConfigError(
            f"channel {text!r}: write socketcand:HOST:PORT/CHANNEL, as in socketcand:192.168.0.7:29536/can0"
        )


def _for_python_can(spec: ChannelSpec) -> ChannelSpec:
    """Convert the host and port of a socketcand channel to python-can keywords; return other channels unchanged."""
    served = _SERVED.fullmatch(spec.name) if spec.interface == _SOCKETCAND else None
    if served is None:
        return spec
    settings = {"host": served["host"], "port": served["port"] or _SOCKETCAND_PORT}
    return replace(spec, name=served["channel"], options=tuple({**settings, **dict(spec.options)}.items()))


def name_and_channel(text: str) -> tuple[str, str]:
    """Split ``[BUS=]CHANNEL``; the name is empty without BUS=. The channel may contain ``=`` in its keywords."""
    name, equals, channel = text.partition("=")
    return (name, channel) if equals and name and not any(sign in name for sign in ":,/@") else ("", text)


def may_host_virtual_drives(channel: str) -> bool:
    """Whether a channel can only have virtual drives: ``local:``, ``memory:``, ``virtual:`` and ``vcan*``."""
    spec = parse_channel(channel)
    if spec.kind is ChannelKind.SOCKETCAN:
        return spec.name.startswith("vcan")
    return spec.kind is not ChannelKind.PYTHON_CAN


def open_port(channel: str, *, label: str = "", join: bool = False) -> Port:
    """Open a channel; `label` names the port to the other ports of a ``local:`` or ``memory:`` bus.

    With `join` a ``local:`` bus that is not open raises `BusNotOpen` instead of being created, for callers that only
    listen or query. Raise ConfigError for an invalid name, or BusError (`InterfaceNotFound`, `InterfaceDown`, …).
    """
    spec = parse_channel(channel)
    if join and spec.kind is ChannelKind.LOCAL:
        from canopen_control.bus.local import join_local

        return join_local(spec.name, label)
    return _OPENERS[spec.kind](spec, label)


def _open_memory(spec: ChannelSpec, label: str) -> Port:
    from canopen_control.bus.memory import bus_of_channel

    return bus_of_channel(spec.name).open(label)


def _open_local(spec: ChannelSpec, label: str) -> Port:
    from canopen_control.bus.local import open_local

    return open_local(spec.name, label)


def _open_socketcan(spec: ChannelSpec, label: str) -> Port:  # noqa: ARG001 - SocketCAN has no labels
    from canopen_control.bus.socketcan import open_socketcan

    return open_socketcan(spec.name)


def _open_python_can(spec: ChannelSpec, label: str) -> Port:  # noqa: ARG001 - python-can has no labels
    from canopen_control.bus.pythoncan import open_python_can

    interface = "virtual" if spec.kind.in_process else spec.interface
    converted = _for_python_can(spec)
    return open_python_can(
        str(spec), interface, converted.name, converted.bitrate, converted.options, served=interface in SERVED
    )


_OPENERS: dict[ChannelKind, Callable[[ChannelSpec, str], Port]] = {
    ChannelKind.LOCAL: _open_local,
    ChannelKind.MEMORY: _open_memory,
    ChannelKind.VIRTUAL: _open_python_can,
    ChannelKind.SOCKETCAN: _open_socketcan,
    ChannelKind.PYTHON_CAN: _open_python_can,
}
