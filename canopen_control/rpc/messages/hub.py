"""Control socket of a ``local:`` bus: its members, and the injection of bus faults.

A label is the name of a member of the bus, such as ``drive 3``; an optional label "" means all members. The kind of an
error is a class in errors.py: ConfigError for an unknown label.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal, NoReturn

import msgspec

from canopen_control.rpc.messages.declare import Api, Done, Effect, Request

_MAX_BITRATE: Final = 1_000_000  # classic CAN
_MAX_DELAY: Final = 60_000

ErrorKind = Literal["bus-error", "error-passive", "error-active", "overrun"]
Identifier = Annotated[int, msgspec.Meta(ge=0, le=0xFFFFFFFF)]
Count = Annotated[int, msgspec.Meta(ge=1, le=1 << 31)]


class HubHello(msgspec.Struct, frozen=True):
    """Greeting of the hub of a local bus; `pid` is the process id of the hub."""

    bus: str
    protocol: int = 0
    pid: int = 0


HUB: Final[Api[HubHello, NoReturn]] = Api("hub", HubHello, {})  # the hub pushes no messages


# -- members


class Member(msgspec.Struct, frozen=True):
    """Member of the bus, with its numbers of received, sent, lost and waiting frames."""

    label: str
    pid: int
    rx: int = 0
    tx: int = 0
    lost: int = 0
    queued: int = 0


class DropState(msgspec.Struct, frozen=True):
    """Active `drop` rule, with the numbers of frames that matched (`seen`) and that were `lost`."""

    label: str = ""
    can_id: int | None = None
    every: int = 1
    count: int | None = None
    seen: int = 0
    lost: int = 0


class HubStatus(msgspec.Struct, frozen=True):
    """Status of a local bus; `load` (0 to 1) exists if a bit rate is simulated; faults are listed by label."""

    bus: str
    pid: int
    uptime_s: float
    bitrate: int | None
    load: float | None
    frames: int
    dropped: int
    members: list[Member]
    cut: list[str]
    bus_off: list[str]
    delays_ms: dict[str, float]
    drops: list[DropState]


@HUB.method("status", Effect.READS)
class GetHubStatus(Request[HubStatus], frozen=True):
    """Return the members, faults and traffic of the bus."""


# -- faults


@HUB.method("cut", Effect.CHANGES)
class Cut(Request[Done], frozen=True):
    """Cut the cable of a member: frames are lost in both directions without an error."""

    label: str


@HUB.method("uncut", Effect.CHANGES)
class Uncut(Request[Done], frozen=True):
    """Repair the cable of a member."""

    label: str


@HUB.method("bus_off", Effect.CHANGES)
class ForceBusOff(Request[Done], frozen=True):
    """Put the CAN controller of a member into bus-off; an error frame reports this to the member."""

    label: str


@HUB.method("restart", Effect.CHANGES)
class Restart(Request[Done], frozen=True):
    """Restart the CAN controller of a member after bus-off."""

    label: str


@HUB.method("error_frame", Effect.CHANGES)
class SendErrorFrame(Request[Done], frozen=True, kw_only=True):
    """Send an error frame from the CAN controller of a member, or of all members."""

    kind: ErrorKind = "bus-error"
    label: str = ""


@HUB.method("drop", Effect.CHANGES)
class DropFrames(Request[Done], frozen=True, kw_only=True):
    """Drop every `every`-th frame of a member (or of all) with `can_id` (or with any), `count` frames in total."""

    label: str = ""
    can_id: Identifier | None = None
    every: Count = 1
    count: Count | None = None


@HUB.method("delay", Effect.CHANGES)
class DelayFrames(Request[Done], frozen=True, kw_only=True):
    """Delay the frames of a member, or of all members, by `ms` milliseconds; 0 ends the delay."""

    ms: Annotated[int, msgspec.Meta(ge=0, le=_MAX_DELAY)]
    label: str = ""


@HUB.method("bitrate", Effect.CHANGES)
class SetBitrate(Request[Done], frozen=True):
    """Simulate a bit rate in bit/s with arbitration; null or 0 ends the simulation."""

    bitrate: Annotated[int, msgspec.Meta(ge=0, le=_MAX_BITRATE)] | None = None


@HUB.method("clear", Effect.CHANGES)
class ClearFaults(Request[Done], frozen=True):
    """Clear all faults; a simulated bit rate stays active."""
