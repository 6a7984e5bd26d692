"""Device models: the differences between drive models, as data.

The code implements the profile; each difference of a device is a field here. `GENERIC` is a drive that supports
everything in its EDS; a supported device has its own instance. `VENDOR_MODELS` are drives of which only the handling
of set-points is known, from the vendor's objects and public manuals.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Protocol, runtime_checkable

from canopen_control.profiles import Profile, profile_of, profile_signals

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from canopen_control.od.model import Address, ObjectDictionary
    from canopen_control.rpc.messages.drive import SignalState
    from canopen_control.virtual.node_outbox import NodeClock, NodeOutbox
    from canopen_control.virtual.object_store import VirtualStore
    from canopen_control.virtual.shaft import ShaftWorld


# Functions of virtual devices other than drives: inputs and outputs at their terminals (CiA 401 to 419).
#
# The dictionary decides which function a node has; a drive, or a device with an unknown profile, has none. Inputs are
# set by name, such as `di3` or `position`, in the units of their signals.


class DeviceFunction(Protocol):
    """Function of a device that is not a drive: signals, and the filter of event-driven TPDOs."""

    overloaded: bool
    """Whether the overload protection has switched the outputs off at the terminals."""

    def power_on(self, now: int) -> None:
        """Reset the function at power-on or at a reset of the node."""

    def connection_lost(self, now: int) -> None:
        """Set the outputs to their error values after a lost heartbeat or guarding, or after bus-off."""

    def communication_stopped(self, now: int) -> None:
        """Set the outputs to their error values at NMT STOPPED or a reset of communication."""

    def tick(self, now: int) -> None:
        """Update values that change over time, such as noise, up to `now`."""

    def next_deadline(self) -> int | None:
        """Return the time in ns at which `tick` is next due, or None if no value changes over time."""

    def starts(self, mapped: Collection[Address]) -> bool:
        """Whether a TPDO with these objects is sent when the node becomes OPERATIONAL."""

    def passes(self, changed: Collection[Address]) -> bool:
        """Whether changes of these objects are an event that triggers a TPDO."""

    def tpdos_checked(self) -> None:
        """Discard the pending events after all TPDOs were checked for changes."""

    def set_signals(self, values: Mapping[str, float], now: int) -> None:
        """Set inputs by name, either all or none; raise ConfigError for an unknown input or an output."""

    def describe(self) -> tuple[SignalState, ...]:
        """Return the state of every signal; for outputs the state at the terminals."""

    def break_inputs(self, kind: str, *, on: bool, now: int) -> None:
        """Inject or clear a fault of the inputs; `kind` is "stuck", "noise" or "jump"."""


@runtime_checkable
class ShaftFollower(Protocol):
    """Device function, such as an encoder, whose shaft is turned by a drive."""

    def follow(self, world: ShaftWorld, node_id: int) -> None:
        """Follow the shaft of node `node_id` in `world`."""


def make_function(
    od: ObjectDictionary, store: VirtualStore, outbox: NodeOutbox, clock: NodeClock
) -> DeviceFunction | None:
    """Return the device function described by a dictionary; None for a drive or an unknown profile."""
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
    """EMCY that reports a limit: error code, and manufacturer-specific bytes for the negative and the positive side."""

    code: int
    negative: bytes
    positive: bytes


@dataclass(frozen=True, slots=True)
class MissingSetPoint:
    """Reaction of a cyclic mode to a missing set-point; by default the axis stops at the last set-point.

    The axis continues at its velocity for `cycles` interpolation periods (0x60C2), or for the number of periods in
    `cycles_object` if the dictionary has that object. Then the axis stops or, if `fault` is not 0, raises a fault with
    that EMCY code.
    """

    cycles: int = 0
    cycles_object: tuple[int, int] | None = None
    fault: int = 0


@dataclass(frozen=True, slots=True)
class DeviceModel:
    """Differences of a drive model from a generic drive, in counts/s^2, counts/s and ns.

    `unset_ramp` is the ramp of an object that is absent or 0. `delays` maps the number of a transition to the
    index, on axis 0, of the object with its delay in ms. With `single_set_point`, PP has neither buffered nor immediate
    set-points: bit 12 shows that a set-point is in process, and a new set-point replaces it. `homing_methods` None
    means all methods.
    """

    name: str = ""  # empty: the product name in the EDS
    boot_ns: int = 10_000_000  # time from power-on or reset to the boot-up message
    unset_ramp: float = math.inf
    unset_velocity: float = 100_000.0  # value of a profile velocity that is absent or 0
    velocity_ramp_both_ways: bool = False  # PV: 0x6083 also decelerates
    ramps_positions: bool = False  # also in velocity modes, as in steppers: a lost distance is caught up
    single_set_point: bool = False
    homing_methods: frozenset[int] | None = None
    homing_halts: bool = True
    homes_without_power: bool = False  # methods 35 and 37, in every state of the power state machine
    max_velocity: float = math.inf
    counts_per_revolution: int = 4096  # value without 0x608F
    delays: Mapping[int, int] = field(default_factory=dict)
    communication_data: bytes = b""  # the manufacturer's bytes of EMCY 0x8130
    rtr_supported: bool = True  # if False, the COB-IDs of its TPDOs must keep bit 30
    rpdo_error: tuple[int, bytes] | None = None  # EMCY code and bytes when a value in an RPDO is refused
    software_limit: Limit | None = None
    switch_limit: Limit | None = None
    switches_disabled: Callable[[VirtualStore], bool] = lambda _store: False
    missing: MissingSetPoint = MissingSetPoint()
    recovers_sync: bool = (
        True  # phase lock: set-points are timed by the recovered period of SYNC, not by each single SYNC
    )
    follows_sync: bool = False  # measures the SYNC, so that clock drift does not matter in cyclic modes
    velocity_bits: Callable[[float], int] | None = None  # bits of the statusword, from the measured velocity
    # values of identity objects without a default in the EDS
    identity: Mapping[tuple[int, int], int | str] = field(default_factory=dict)
    display: Mapping[tuple[int, int], Callable[[VirtualStore], int]] = field(default_factory=dict)


GENERIC = DeviceModel()

PLAIN: Final = DeviceModel(recovers_sync=False)
"""Drive that treats every SYNC as exactly on time: a late SYNC causes a standstill, an early SYNC a jump."""

INTERPOLATION_UNDERFLOW: Final = 0xFF02  # EMCY of Elmo
_EXTRAPOLATION_CYCLES: Final = (0x2F75, 0)

MAXON: Final = DeviceModel(missing=MissingSetPoint(), recovers_sync=False)
"""maxon EPOS4: stops at the end of the interpolation; 0x60C2 is 0 in its EDS, so a set-point applies at once."""

ELMO: Final = DeviceModel(
    missing=MissingSetPoint(cycles=1, cycles_object=_EXTRAPOLATION_CYCLES, fault=INTERPOLATION_UNDERFLOW)
)
"""Elmo Gold: continues for 0x2F75 interpolation periods, then faults and stops according to 0x605E."""

VENDOR_MODELS: Final[Mapping[int, DeviceModel]] = MappingProxyType({0x9A: ELMO, 0xFB: MAXON})
"""Device models by vendor-ID (0x1018:01)."""


def vendor_model(od: ObjectDictionary) -> DeviceModel | None:
    """Return the device model for the vendor-ID in a dictionary, or None if the vendor is unknown."""
    entry = od.get(0x1018, 1)
    vendor = None if entry is None else entry.value
    return VENDOR_MODELS.get(vendor) if isinstance(vendor, int) else None
