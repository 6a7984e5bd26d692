"""Device models: differences between models of drives, as data.

The code implements the profile; each difference of a device is a field here. `GENERIC` is a drive that supports all
that its EDS lists; supported devices have a module with their own instance. `VENDOR_MODELS` are drives of which only
the handling of set-points is known, from the vendor's objects and public manuals.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Protocol, runtime_checkable

from canopen_control.profiles.device_type import Profile, profile_of
from canopen_control.profiles.profile_tables import profile_signals

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from canopen_control.od.model import Address, ObjectDictionary
    from canopen_control.rpc.messages.drive import SignalState
    from canopen_control.virtual.node_outbox import NodeClock, NodeOutbox
    from canopen_control.virtual.object_store import VirtualStore
    from canopen_control.virtual.shaft import ShaftWorld


# Functions of virtual devices other than drives: inputs and outputs at their terminals (CiA 401 to 419).
#
# The dictionary decides which function a node has; a drive, and a device of an unknown profile, has none and is a plain
# node. Inputs are set in the units of their signals by name, such as `di3` or `position`.


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

    def tpdos_checked(self) -> None:
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

    def follow(self, world: ShaftWorld, node_id: int) -> None:
        """Follow the shaft of a node in a world from now on."""


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


@dataclass(frozen=True, slots=True)
class Limit:
    """Report of a limit: EMCY code and manufacturer's bytes for the negative and the positive side."""

    code: int
    negative: bytes
    positive: bytes


@dataclass(frozen=True, slots=True)
class MissingSetPoint:
    """Reaction of a cyclic mode to a missing set-point; the default is to hold the last one.

    It goes on with its velocity for `cycles` interpolation periods (0x60C2), those of `cycles_object` where the
    dictionary has it; then it stands, or with a `fault` code that is its EMCY and fault.
    """

    cycles: int = 0
    cycles_object: tuple[int, int] | None = None
    fault: int = 0


@dataclass(frozen=True, slots=True)
class DeviceModel:
    """The differences. Ramps in counts/s^2, velocities in counts/s, times in ns.

    `unset_ramp` is the ramp of an object that is absent or 0. `delays` gives, by transition number, the object of axis
    0 that holds its delay in ms. `single_set_point`: PP has neither buffered nor immediate set-points, bit 12 shows
    that one is in process, and a new one replaces it. `homing_methods` None: all methods of `homing`.
    """

    name: str = ""  # empty: the file's product name
    boot_ns: int = 10_000_000  # from power-on or reset to the boot-up message
    unset_ramp: float = math.inf
    unset_velocity: float = 100_000.0  # of a profile velocity that is absent or 0
    velocity_ramp_both_ways: bool = False  # PV: 0x6083 also decelerates
    ramps_positions: bool = False  # in velocity modes too, as a stepper does: way that was lost is made up for
    single_set_point: bool = False
    homing_methods: frozenset[int] | None = None
    homing_halts: bool = True
    homes_without_power: bool = False  # methods 35 and 37, in every state of the power state machine
    max_velocity: float = math.inf
    counts_per_revolution: int = 4096  # without 0x608F
    delays: Mapping[int, int] = field(default_factory=dict)
    communication_data: bytes = b""  # the manufacturer's bytes of EMCY 0x8130
    rtr_supported: bool = True  # else the COB-IDs of its TPDOs must keep bit 30
    rpdo_error: tuple[int, bytes] | None = None  # EMCY code and bytes when an RPDO holds a value it refuses
    software_limit: Limit | None = None
    switch_limit: Limit | None = None
    switches_disabled: Callable[[VirtualStore], bool] = lambda _store: False
    missing: MissingSetPoint = MissingSetPoint()
    recovers_sync: bool = (
        True  # by a phase lock: it times its way to a set-point by the rhythm of SYNC, not by each one
    )
    follows_sync: bool = False  # measures the SYNC, so that a clock that drifts does not matter in cyclic modes
    velocity_bits: Callable[[float], int] | None = None  # of the statusword, from the measured velocity
    identity: Mapping[tuple[int, int], int | str] = field(default_factory=dict)  # where the file gives no default
    display: Mapping[tuple[int, int], Callable[[VirtualStore], int]] = field(default_factory=dict)


GENERIC = DeviceModel()

PLAIN: Final = DeviceModel(recovers_sync=False)
"""A drive that takes each SYNC as the exact time: one that comes late is a standstill, one that comes early a jump."""

INTERPOLATION_UNDERFLOW: Final = 0xFF02  # EMCY of Elmo
_EXTRAPOLATION_CYCLES: Final = (0x2F75, 0)

MAXON: Final = DeviceModel(missing=MissingSetPoint(), recovers_sync=False)
"""EPOS4: stands at the end of the interpolation; 0x60C2 is 0 in its files, a set-point is taken at once."""

ELMO: Final = DeviceModel(
    missing=MissingSetPoint(cycles=1, cycles_object=_EXTRAPOLATION_CYCLES, fault=INTERPOLATION_UNDERFLOW)
)
"""Gold: goes on for as many periods as its object says, then it faults; the motor stops as 0x605E says."""

VENDOR_MODELS: Final[Mapping[int, DeviceModel]] = MappingProxyType({0x9A: ELMO, 0xFB: MAXON})
"""Vendor id (0x1018:01) to the model of that vendor's drives."""


def vendor_model(od: ObjectDictionary) -> DeviceModel | None:
    """Return the model of a dictionary's vendor, None if unknown."""
    entry = od.get(0x1018, 1)
    vendor = None if entry is None else entry.value
    return VENDOR_MODELS.get(vendor) if isinstance(vendor, int) else None
