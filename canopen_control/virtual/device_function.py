"""Functions of virtual devices other than drives: inputs and outputs at their terminals (CiA 401 to 419).

The dictionary decides which function a node has; a drive, and a device of an unknown profile, has none and is a plain
node. Inputs are set in the units of their signals by name, such as `di3` or `position`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Final, Protocol, runtime_checkable

from canopen_control.profiles.device_type import Profile, profile_of
from canopen_control.profiles.profile_tables import profile_signals

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from canopen_control.od.model import Address, ObjectDictionary
    from canopen_control.rpc.messages.drive import SignalState
    from canopen_control.virtual.node_outbox import NodeClock, NodeOutbox
    from canopen_control.virtual.object_store import VirtualStore


class DeviceFunction(Protocol):
    """Function of one device, and filter of its event-driven TPDOs."""

    overloaded: bool
    """Whether its protection has switched its outputs off, at the terminals."""

    def power_on(self, now: int) -> None:
        """Reset after a reset of the node."""

    def connection_lost(self, now: int) -> None:
        """React to a lost heartbeat or guarding."""

    def communication_stopped(self, now: int) -> None:
        """React to NMT STOPPED or a reset of the communication."""

    def tick(self, now: int) -> None:
        """Advance to a time."""

    def next_deadline(self) -> int | None:
        """Return the time of its next event, None without one."""

    def starts(self, mapped: Collection[Address]) -> bool:
        """Whether a TPDO with these objects is sent when the node becomes OPERATIONAL."""

    def passes(self, changed: Collection[Address]) -> bool:
        """Whether changes of these objects are an event that triggers a TPDO."""

    def told(self) -> None:
        """Process the end of a check of all TPDOs."""

    def set_signals(self, values: Mapping[str, float], now: int) -> None:
        """Set inputs by name, all or none; ConfigError for an unknown input."""

    def describe(self) -> tuple[SignalState, ...]:
        """Return the state of every signal, outputs as at the terminals."""

    def break_inputs(self, kind: str, *, on: bool, now: int) -> None:
        """Switch a fault of the inputs: stuck, noise or jump."""


@runtime_checkable
class ShaftFollower(Protocol):
    """Function that can be moved by a shaft."""

    def follow(self, shaft: Callable[[], float | None]) -> None:
        """Set the shaft position in rad (m); None if unknown."""


def make_function(
    od: ObjectDictionary, store: VirtualStore, outbox: NodeOutbox, clock: NodeClock
) -> DeviceFunction | None:
    """Return the function of a device by its dictionary; None if unknown."""
    profile = profile_of(od)
    kind = _KINDS.get(profile)
    if kind is None:
        return None
    module = importlib.import_module(f"canopen_control.virtual.{kind[0]}")  # a drive's process starts without it
    function: DeviceFunction = getattr(module, kind[1])(store, outbox, clock, profile_signals(od, profile).values())
    return function


_KINDS: Final = {
    Profile.IO: ("io_device", "IoDevice"),
    Profile.MEASURING: ("io_device", "MeasuringDevice"),
    Profile.ENCODER: ("io_device", "Encoder"),
    Profile.INCLINOMETER: ("io_device", "Inclinometer"),
    Profile.BATTERY: ("io_device", "BatteryDevice"),
    Profile.CHARGER: ("io_device", "Charger"),
}
