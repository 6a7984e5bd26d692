"""Keys of bus.yml as frozen dataclasses: those of ros2_canopen, and those that this package adds.

Every key that ros2_canopen reads is here: it is either used, or listed in `UNUSED_MASTER` or `UNUSED_NODE` with what
replaces it, and then reported once to the user. Times have the units of the format: us for SYNC, ms for heartbeats,
boot, timers and names ending in `_ms`.

`docs/words.py` describes each key; the reference of bus.yml is generated from there. The keys that this package adds to
those of ros2_canopen are optional, and a file with them still works with ros2_canopen, which ignores unknown keys.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from canopen_control.cia301.pdo import INVALID_BIT
from canopen_control.frame import MAX_NODE_ID
from canopen_control.od.model import BIT_RATES
from canopen_control.profiles import TYPES, object_of
from canopen_control.yamlfile.convert import derived, part, setting

DEFAULT_HEARTBEAT_MS = 100  # default without a key in bus.yml, so that a lost node or master is always detected
DEFAULT_BOOT_MS = 5000
DRIVE_DRIVERS = ("Cia402", "MotionController")
"""Parts of the names of ros2_canopen's drivers for drives, in current and earlier versions."""

SCALES = ("scale_pos_to_dev", "scale_pos_from_dev", "scale_vel_to_dev", "scale_vel_from_dev")

#: keys of ros2_canopen's `master` that have no effect here, and what replaces them
UNUSED_MASTER = {
    "driver": "the master is this package",
    "package": "the master is this package",
    "namespace": "options of the ROS bridge replace this key",
    "remappings": "options of the ROS bridge replace this key",
    "dcf_path": "no files are generated for the master",
    "vendor_id": "the master has no object dictionary of its own",
    "product_code": "the master has no object dictionary of its own",
    "revision_number": "the master has no object dictionary of its own",
    "serial_number": "the master has no object dictionary of its own",
    "time_cob_id": "the master sends no TIME",
    "emcy_inhibit_time": "the master sends no EMCY",
    "error_behavior": "the master never leaves OPERATIONAL by itself",
    "nmt_inhibit_time": "NMT commands are sent when they are due and confirmed by heartbeats",
    "heartbeat_consumer": "the heartbeats of all nodes are always monitored",
    "start": "the master always starts itself",
    "start_nodes": "the boot starts every node except those with `boot: false`",
    "start_all_nodes": "each node is started when it is ready",
    "reset_all_nodes": "`recovery` and the stop of the whole robot replace this key",
    "stop_all_nodes": "`recovery` and the stop of the whole robot replace this key",
}
#: keys that users write by mistake -> the correct key
MISNAMED_ROOT = {
    "can_interface_name": "`channel` under `master:`, or --can",
    "master_node_id": "`node_id` under `master:`",
    "node_id": "`node_id` under `master:`, or under a node",
    "sync_period": "`sync_period` under `master:`",
    "baudrate": "`baudrate` under `master:`",
    "bitrate": "`baudrate` under `master:`",
    "driver_name": "`driver` under `master:`",
    "package_name": "`package` under `master:`",
    "dcf_path": "`dcf_path` under `options:`",
    "slaves": "`nodes:`",
    "drives": "`nodes:`",
}
MISNAMED_OPTIONS = {
    **{name: f"`{name}:` at the margin; it is indented too far" for name in ("master", "defaults", "nodes")},
    "node_id": "`node_id` under `master:`",
    "sync_period": "`sync_period` under `master:`",
    "baudrate": "`baudrate` under `master:`",
    "boot_timeout_ms": "`boot_timeout_ms` of the nodes, under `defaults:`",
}
MISNAMED_MASTER = {
    "bitrate": "`baudrate`",
    "interface": "`channel`",
    "can_interface": "`channel`",
    "can_interface_name": "`channel`",
    "driver_name": "`driver`",
    "package_name": "`package`",
    "heartbeat_multiplyer": "`heartbeat_multiplier`",
    "sync_period_us": "`sync_period`, in us",
}
MISNAMED_NODE = {
    "driver_name": "`driver`",
    "package_name": "`package`",
    "eds": "`dcf`",
    "eds_file": "`dcf`",
    "dcf_file": "`dcf`",
    "id": "`node_id`",
    "nodes": "`nodes:` at the margin; it is indented too far",
    "baudrate": "`baudrate` under `master:`",
    "bitrate": "`baudrate` under `master:`",
    "sync_period": "`sync_period` under `master:`",
    "motor_channels": "`channels`, a list with the units of each axis",
    "state_switch_timeout_ms": "`transition_timeout_ms`",
    "heartbeat": "`heartbeat_producer`, in ms",
    "heartbeat_time": "`heartbeat_producer`, in ms",
    "heartbeat_period": "`heartbeat_producer`, in ms",
    "mode": "`position_mode`, `velocity_mode` or `effort_mode`",
    "operation_mode": "`position_mode`, `velocity_mode` or `effort_mode`",
    "default_operation_mode": "`position_mode`, `velocity_mode` or `effort_mode`",
    "mode_of_operation": "`position_mode`, `velocity_mode` or `effort_mode`",
}
#: keys of ros2_canopen's nodes that have no effect here, and what replaces them
UNUSED_NODE = {
    "package": "every node is driven by this package",
    "polling": "drives are read every SYNC",
    "period": "drives are read every SYNC",
    "non_transmit_timeout": "sending never blocks",
    "diagnostics": "diagnostics are always on",
    "enable_lazy_load": "nodes join when they appear",
    "num_channels": "axes are taken from the EDS",
    "channel": "a joint names its axis in the description",
    "joint_name": "the description defines which joint a node moves",
    "scale_eff_to_dev": "efforts are commanded in the unit of 0x6071, as in ros2_canopen",
    "enable_ros_interfaces": "options of the ROS bridge replace this key",
    "software_file": "firmware is never downloaded; a wrong software_version is boot error I",
}


SHORTEST_SYNC_US = 250
"""SYNC period in us in which no two frames fit at 1 Mbit/s; a smaller number was probably meant in ms."""
_MICROSECONDS = "; write it in us, such as 20000"
_MILLISECONDS = "; write it in ms, such as 100"
_AUTO = "; write auto for the default COB-ID of the node, or the COB-ID as a number, such as 0x182"


@dataclass(frozen=True)
class PdoObjectKeys:
    """Object in the mapping of a PDO; `bits` is None if the key is absent."""

    index: int = setting(low=0x0001, high=0xFFFF)
    sub_index: int = setting(0, low=0, high=0xFF)
    bits: int | None = setting(None, low=1, high=64)  # compared with the EDS, which takes precedence


@dataclass(frozen=True)
class PdoConfig:
    """PDO section of bus.yml; None selects the default of the EDS. `inhibit_time` is in 100 us, other times in ms."""

    enabled: bool = True
    cob_id: int | Literal["auto"] | None = setting(None, low=1, high=0xFFFFFFFF, hint=_AUTO)
    transmission: int | None = setting(None, low=0, high=255)
    inhibit_time: int | None = setting(None, low=0, high=0xFFFF)
    event_timer: int | None = setting(None, low=0, high=0xFFFF, hint=_MILLISECONDS)
    event_deadline: int | None = setting(None, low=0, high=0xFFFF)
    sync_start: int | None = setting(None, low=0, high=240)
    mapping: list[PdoObjectKeys] | None = None

    @property
    def is_on(self) -> bool:
        """Whether the PDO is used: `enabled`, and not made invalid by bit 31 of `cob_id` (CiA 301, 7.5.2.35)."""
        return self.enabled and not (isinstance(self.cob_id, int) and self.cob_id & INVALID_BIT)


@dataclass(frozen=True)
class SdoEntry:
    """Object written at boot; `value` may be hex digits for bytes, or `save` and `load` for 0x1010 and 0x1011."""

    index: int = setting(low=0x1000, high=0xFFFF)
    sub_index: int = setting(0, low=0, high=0xFF)
    value: bool | int | float | str = 0


@dataclass(frozen=True)
class AxisUnitKeys:
    """Units of one axis of a multi-axis device (`channels`); None uses the value of the node."""

    scale_pos_to_dev: float | None = None
    scale_pos_from_dev: float | None = None
    scale_vel_to_dev: float | None = None
    scale_vel_from_dev: float | None = None
    scale_eff_from_dev: float | None = None
    offset_pos_to_dev: float | None = None
    offset_pos_from_dev: float | None = None


@dataclass(frozen=True)
class FileOptions:
    """Section `options` of bus.yml, which applies to the whole file."""

    dcf_path: str = ""
    heartbeat_multiplier: float = setting(3.0, low=1.0, high=100.0)
    retry_factor: int = setting(3, low=1, high=255)


_BY_KERNEL = {
    "kernel": ", by the kernel on a SocketCAN interface",
    "auto": ", by the kernel on a SocketCAN interface where joints are commanded in CSP or CSV",
}


@dataclass(frozen=True)
class MasterConfig:
    """Section `master` of bus.yml; `boot_time` 0 means no limit, `boot_timeout` is the SDO timeout in a boot in ms."""

    node_id: int = setting(1, low=1, high=MAX_NODE_ID)
    channel: str = ""
    baudrate: int = setting(
        1000, choices=BIT_RATES, hint="; a number in kbit/s, such as 500"
    )  # `master/config.py` converts bit/s to kbit/s before
    sync_period: int = setting(0, low=0, high=10_000_000, hint=_MICROSECONDS)
    sync_window: int = setting(0, low=0, high=10_000_000, hint=_MICROSECONDS)
    sync_overflow: int = setting(0, choices=(0, *range(2, 241)))
    sync_order: Literal["auto", "first", "last"] = "auto"
    sync_producer: Literal["auto", "master", "kernel", "other"] = "auto"
    heartbeat_multiplier: float | None = setting(None, low=1.0, high=100.0)
    heartbeat_producer: int = setting(0, low=0, high=0xFFFF, off=True, hint=_MILLISECONDS)  # dcfgen reads false as 0
    boot_time: int = setting(DEFAULT_BOOT_MS, low=0, high=3_600_000, hint=_MILLISECONDS)
    boot_timeout: int | None = setting(None, low=1, high=600_000)

    @property
    def heartbeat_ms(self) -> int:
        """Period of the master's heartbeat in ms."""
        return self.heartbeat_producer or DEFAULT_HEARTBEAT_MS

    @property
    def sends_sync_first(self) -> bool:
        """Whether SYNC frames of this program precede the RPDOs of the cycle."""
        return self.sync_order == "first"

    @property
    def follows_closely(self) -> bool:
        """Whether the cycle starts an eighth of a period after another producer's SYNC, instead of half a period."""
        return self.sync_order != "last"

    def sync_words(self, *, by_kernel: bool | None = None) -> str:
        """Return a sentence about the SYNC producer, its period and the order of SYNC and RPDOs in a cycle."""
        if not self.sync_period:
            return "no SYNC"
        every = f"SYNC every {self.sync_period / 1000:g} ms"
        if by_kernel or self.sync_producer == "other":
            sender = "by the kernel" if by_kernel else "by another node"
            behind = "an eighth of" if self.follows_closely else "half"
            return f"{every} {sender}, the cycle follows {behind} a period after it"
        position, order = ("before", "first") if self.sends_sync_first else ("after", "last")
        can = "" if by_kernel is False else _BY_KERNEL.get(self.sync_producer, "")
        return f"{every}, {position} the RPDOs of its cycle (sync_order: {order}){can}"


_ANY = "; 0 accepts any"


@dataclass(frozen=True)
class IdentityKeys:
    """EDS file of the device, and its expected identity and firmware."""

    dcf: str
    dcf_path: str = ""
    vendor_id: int | None = setting(None, low=0, high=0xFFFFFFFF, hint=_ANY)
    product_code: int | None = setting(None, low=0, high=0xFFFFFFFF, hint=_ANY)
    revision_number: int | None = setting(None, low=0, high=0xFFFFFFFF, hint=_ANY)
    serial_number: int | None = setting(None, low=0, high=0xFFFFFFFF, hint=_ANY)
    software_file: str = ""
    software_version: int = setting(0, low=0, high=0xFFFFFFFF)


@dataclass(frozen=True)
class SupervisionKeys:
    """Heartbeat and node guarding of a node; `multiplier` and `life_factor` are the effective values.

    `multiplier` is the heartbeat_multiplier of the node, the master or the file; `life_factor` is the life_time_factor
    or retry_factor of the node, or the retry_factor of the file.
    """

    heartbeat_multiplier: float | None = setting(None, low=1.0, high=100.0)
    heartbeat_consumer: bool | None = setting(
        None, hint="; the time is that of the master, heartbeat_producer x heartbeat_multiplier"
    )
    heartbeat_producer: int = setting(0, low=0, high=0xFFFF, off=True, hint=_MILLISECONDS)  # dcfgen reads false as 0
    guard_time: int = setting(0, low=0, high=0xFFFF, hint=_MILLISECONDS)
    life_time_factor: int = setting(0, low=0, high=0xFF)
    retry_factor: int | None = setting(None, low=0, high=255)
    error_behavior: dict[int, int] = setting(factory=dict, low=0, high=0xFF)
    allow_unsupervised: bool = False
    missed_syncs: int = setting(3, low=1, high=1000)
    multiplier: float = derived(3.0)
    life_factor: int = derived(3)

    @property
    def heartbeat_ms(self) -> int:
        """Period of the node's heartbeat in ms; 0 with node guarding."""
        return self.heartbeat_producer or (0 if self.guarded else DEFAULT_HEARTBEAT_MS)

    @property
    def guarded(self) -> bool:
        """Whether the keys request node guarding for the node; a heartbeat takes precedence (CiA 301, 7.2.8.3)."""
        return bool(self.guard_time) and not self.heartbeat_producer

    @property
    def heartbeat_timeout_ns(self) -> int:
        """Time in ns without a heartbeat after which the node is considered lost; 0 with node guarding."""
        return round(self.heartbeat_ms * self.multiplier * 1e6)


@dataclass(frozen=True)
class BootKeys:
    """Boot options of a node, and the objects written during boot."""

    enabled: bool = setting(True, key="boot")
    mandatory: bool | None = None
    required: bool | None = None
    reset_communication: bool = True
    configuration_file: str = ""
    restore_configuration: int = setting(0, low=0, high=0x7F)
    save_configuration: int = setting(0, low=0, high=0x7F)
    sdo_timeout_ms: int = setting(500, low=1, high=60_000)
    boot_timeout_ms: int = setting(1000, low=1, high=600_000)
    time_cob_id: int | None = setting(None, low=0, high=0xFFFFFFFF)
    rpdo: dict[int, PdoConfig] = field(default_factory=dict)
    tpdo: dict[int, PdoConfig] = field(default_factory=dict)
    sdo: list[SdoEntry] = field(default_factory=list)

    @property
    def insists(self) -> bool:
        """Whether bus.yml explicitly declares the node as required or mandatory."""
        return bool(self.required or self.mandatory)

    def pdos(self, kind: str) -> dict[int, PdoConfig]:
        """Return the PDOs that bus.yml configures, by number; `kind` is "rpdo" or "tpdo"."""
        return self.rpdo if kind == "rpdo" else self.tpdo


@dataclass(frozen=True)
class UnitKeys:
    """Units of the device: scales from and to device units, or counts per revolution with a gear ratio.

    `given` contains the scales that bus.yml gives for the node; a given scale may equal the default of ros2_canopen.
    """

    scale_pos_to_dev: float = 1000.0
    scale_pos_from_dev: float = 0.001
    scale_vel_to_dev: float = 1000.0
    scale_vel_from_dev: float = 0.001
    scale_eff_from_dev: float = 0.001
    offset_pos_to_dev: float = 0.0
    offset_pos_from_dev: float = 0.0
    channels: list[AxisUnitKeys] = field(default_factory=list)
    counts_per_revolution: float | None = setting(None, low=1e-9, high=1e12)
    gear_ratio: float | list[int] | None = setting(None, low=1e-9, high=1e9)
    reversed: bool | None = None
    guesses: list[str] = field(default_factory=list)
    given: frozenset[str] = derived(frozenset())

    def with_scale(self, to_device: float) -> UnitKeys:
        """Return a copy with all four scales derived from `to_device`, in device units per SI unit."""
        back = 1 / to_device
        return replace(
            self,
            scale_pos_to_dev=to_device,
            scale_pos_from_dev=back,
            scale_vel_to_dev=to_device,
            scale_vel_from_dev=back,
            given=self.given.union(SCALES),
        )

    def gives(self, axis: int, *scales: str) -> bool:
        """Whether bus.yml gives one of the scales for an axis, in `channels` or for the node."""
        channel = self.channels[axis] if axis < len(self.channels) else None
        return any(key in self.given or getattr(channel, key, None) is not None for key in scales)

    def of_axis(self, axis: int) -> dict[str, float]:
        """Return the arguments of `units.Scale` for an axis; values in `channels` override those of the node."""
        channel = self.channels[axis] if axis < len(self.channels) else AxisUnitKeys()
        names = (*SCALES, "scale_eff_from_dev", "offset_pos_to_dev", "offset_pos_from_dev")
        chosen = {
            name: getattr(channel, name) if getattr(channel, name) is not None else getattr(self, name)
            for name in names
        }
        return {name.removeprefix("scale_"): value for name, value in chosen.items()}


@dataclass(frozen=True)
class MotionKeys:
    """Motion options of the axes: modes, targets, timeouts and reactions to errors."""

    position_mode: int | None = setting(None, low=-128, high=127, hint="; a number, such as 8 for CSP or 1 for PP")
    velocity_mode: int | None = setting(None, low=-128, high=127, hint="; a number, such as 3 for PV or 9 for CSV")
    effort_mode: int | None = setting(None, low=-128, high=127, hint="; a number, such as 4 for TQ or 10 for CST")
    torque_mode: int | None = setting(None, low=-128, high=127)  # another name for effort_mode
    position_target: int | str | None = None
    velocity_target: int | str | None = None
    effort_target: int | str | None = None
    motor_subindices: list[int] | None = setting(None, low=1, high=254)  # subindex for each axis, in one object set
    feed_forward: list[Literal["velocity", "effort"]] = field(default_factory=list)
    homing_timeout_seconds: float = setting(10.0, low=0.001, high=3600.0)
    recovery: Literal["boot", "enable"] = "boot"
    following_error_action: Literal["stop", "warn", "ignore"] = "stop"
    ignore_remote: bool = False
    mode_timeout_ms: int = setting(2000, low=1, high=600_000)
    switching_state: int = setting(5, choices=(2, 3, 4, 5), hint="; 5 is OPERATION ENABLED, 2 SWITCH ON DISABLED")
    fault_reset_timeout_ms: int = setting(2000, low=1, high=600_000)
    enable_settle_ms: int = setting(0, low=0, high=60_000)
    transition_timeout_ms: int = setting(5000, low=1, high=600_000)
    transition_timeouts_ms: dict[int, int] = setting(factory=dict, low=1, high=600_000)

    def own_target(self, interface: str) -> tuple[int, int] | None:
        """Return the target object that bus.yml sets for a command interface, as (index, subindex), or None."""
        text = getattr(self, f"{interface}_target")
        if isinstance(text, int):
            return (text, 0) if 0 < text <= 0xFFFF else None
        address = None if text is None else object_of(text)
        return None if address is None else address[:2]


@dataclass(frozen=True)
class SignalKeys:
    """Signal of a device, with its scale; None keeps the value of the device's profile.

    The value is the raw number times `factor` plus `offset`; raw numbers in `invalid` are read as nan. `safe` is the
    value of an output after the loss of the master, `max_rate` the maximum rate of change of an input.
    """

    name: str
    object: int | str | None = None
    type: str | None = setting(None, choices=tuple(TYPES))
    factor: float | None = None
    offset: float | None = None
    unit: str | None = None
    invalid: float | list[float] | None = None
    safe: bool | int | float | Literal["keep"] | None = None
    max_rate: float | None = setting(None, low=1e-12, high=1e12)


@dataclass(frozen=True)
class RosKeys:
    """Names of the node and its axes in the ROS bridge."""

    driver: str = ""
    namespace: str = ""
    remappings: Any = None
    channel_names: list[str] | None = None


@dataclass(frozen=True)
class NodeConfig:
    """Keys of a node in bus.yml with `defaults` merged in; `line` is the line of the node in the file.

    `required` is set if the robot waits for the node. If `node_id` is missing, the node-ID of the EDS or DCF is used.
    """

    identity: IdentityKeys = part()  # noqa: RUF009 - makes a field
    supervision: SupervisionKeys = part()  # noqa: RUF009 - makes a field
    boot: BootKeys = part()  # noqa: RUF009 - makes a field
    units: UnitKeys = part()  # noqa: RUF009 - makes a field
    motion: MotionKeys = part()  # noqa: RUF009 - makes a field
    ros: RosKeys = part()  # noqa: RUF009 - makes a field
    profile: Literal[401, 402, 404, 406, 410, 418, 419, 454] | None = None
    signals: list[SignalKeys] = field(default_factory=list)
    node_id: int = setting(0, low=1, high=MAX_NODE_ID)
    name: str = derived("")
    line: int = derived(0)
    required: bool = derived(True)


def named_scale(counts_per_revolution: float, gear_ratio: float | list[int] | None, mirrored: bool) -> float:
    """Return the counts per radian of a joint; `gear_ratio` is motor turns per joint turn, or [motor, joint] turns.

    Negative if `mirrored`; raise ValueError for an invalid gear ratio.
    """
    if isinstance(gear_ratio, list):
        if len(gear_ratio) != 2 or not all(part > 0 for part in gear_ratio):
            raise ValueError("gear_ratio is a number above 0, or [motor turns, joint turns]")
        gear_ratio = gear_ratio[0] / gear_ratio[1]
    return counts_per_revolution * (gear_ratio or 1.0) / (2 * math.pi) * (-1 if mirrored else 1)
