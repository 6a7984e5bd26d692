"""The keys of bus.yml: those of ros2_canopen, and what this package adds, as frozen dataclasses.

The law of this file: every key that ros2_canopen reads stands here. It is either honoured, or listed in
`UNUSED_MASTER` or `UNUSED_NODE` with what takes its place, and then named once to the user; none is dropped silently.
Times have the format's own units: us where named sync, ms where named heartbeat, boot, timer or `_ms`.

What this package adds, all of it optional (ros2_canopen ignores unknown keys, so a file with them still serves it):

- `master`: `channel`, where the bus is (can0, local:NAME, ...); `--can` goes before it.
- A robot folder may hold more buses in files `bus_NAME.yml`, all with the SYNC period of `bus.yml`.
- `required`: the robot does not start without the node (default: what `mandatory` says, else true).
- `recovery`: how far a node that comes back goes by itself: `boot`, or `enable`d again too.
- `missed_syncs`: after how many SYNCs without its synchronous TPDOs a node's feedback is stale, and the robot stops.
- `following_error_action`: what bit 13 of the statusword leads to.
- `transition_timeout_ms`, `transition_timeouts_ms`: what a drive may take for a transition; the same by number.
- `heartbeat_multiplier` of a node holds for both directions of its supervision.
- `sync_overflow` of the master is written to the nodes (0x1019) too.
- `counts_per_revolution`, `gear_ratio`, `reversed`: the units by name, instead of the four scales.
- `allow_unsupervised`: accepts a drive that nothing would stop when the master dies.
- `save_configuration`: subindex of 0x1010 to store with, after a boot that changed something.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

from canopen_control.od.model import BIT_RATES
from canopen_control.yamltree import setting

__all__ = [
    "SCALES",
    "UNUSED_MASTER",
    "UNUSED_NODE",
    "AxisUnits",
    "MasterConfig",
    "NodeConfig",
    "NodeKeys",
    "Options",
    "PdoConfig",
    "PdoObject",
    "SdoEntry",
    "named_scales",
]

DEFAULT_HEARTBEAT_MS = 100  # where bus.yml asks for none: a dead partner is always noticed
SCALES = ("scale_pos_to_dev", "scale_pos_from_dev", "scale_vel_to_dev", "scale_vel_from_dev")

#: keys of ros2_canopen's `master` that have no effect here, and what takes their place
UNUSED_MASTER = {
    "driver": "the master is this package",
    "package": "the master is this package",
    "namespace": "the ROS bridge's business",
    "remappings": "the ROS bridge's business",
    "dcf_path": "no files are generated for the master",
    "vendor_id": "the master has no object dictionary of its own",
    "product_code": "the master has no object dictionary of its own",
    "revision_number": "the master has no object dictionary of its own",
    "serial_number": "the master has no object dictionary of its own",
    "time_cob_id": "the master sends no TIME",
    "emcy_inhibit_time": "the master sends no EMCY",
    "error_behavior": "the master never leaves OPERATIONAL by itself",
    "nmt_inhibit_time": "NMT commands are sent when they are due and confirmed by heartbeats",
    "heartbeat_consumer": "nodes are always watched",
    "start": "the master always starts itself",
    "start_nodes": "the boot starts every node; `boot: false` of a node leaves it alone",
    "start_all_nodes": "each node is started when it is ready",
    "reset_all_nodes": "`recovery` and the stop of the whole robot take its place",
    "stop_all_nodes": "`recovery` and the stop of the whole robot take its place",
}
#: the same for a node
UNUSED_NODE = {
    "driver": "every node is driven by this package",
    "package": "every node is driven by this package",
    "polling": "drives are read every SYNC",
    "period": "drives are read every SYNC",
    "non_transmit_timeout": "sending never blocks",
    "diagnostics": "diagnostics are always on",
    "enable_lazy_load": "nodes join when they appear",
    "switching_state": "modes change in any state the drive allows",
    "num_channels": "axes are taken from the EDS",
    "channel": "a joint names its axis in the description",
    "software_file": "firmware is never downloaded; a wrong software_version is boot error I",
}


@dataclass(frozen=True)
class PdoObject:
    """One mapped object."""

    index: int = setting(low=0x0001, high=0xFFFF)
    sub_index: int = setting(0, low=0, high=0xFF)


@dataclass(frozen=True)
class PdoConfig:
    """One PDO; what is None stays as the EDS has it. Times: `inhibit_time` in 100 us, the others in ms."""

    enabled: bool = True
    cob_id: int | Literal["auto"] | None = setting(None, low=1, high=0xFFFFFFFF)
    transmission: int | None = setting(None, low=0, high=255)
    inhibit_time: int | None = setting(None, low=0, high=0xFFFF)
    event_timer: int | None = setting(None, low=0, high=0xFFFF)
    event_deadline: int | None = setting(None, low=0, high=0xFFFF)
    sync_start: int | None = setting(None, low=0, high=240)
    mapping: list[PdoObject] | None = None


@dataclass(frozen=True)
class SdoEntry:
    """One object to be written at boot; hex digits for bytes, `save` and `load` for 0x1010 and 0x1011."""

    index: int = setting(low=0x1000, high=0xFFFF)
    sub_index: int = setting(0, low=0, high=0xFF)
    value: bool | int | float | str = 0


@dataclass(frozen=True)
class AxisUnits:
    """The units of one axis of a device with several (`channels`); None is the node's own."""

    scale_pos_to_dev: float | None = None
    scale_pos_from_dev: float | None = None
    scale_vel_to_dev: float | None = None
    scale_vel_from_dev: float | None = None
    scale_eff_from_dev: float | None = None
    offset_pos_to_dev: float | None = None
    offset_pos_from_dev: float | None = None


@dataclass(frozen=True)
class Options:
    """What concerns the file as a whole."""

    dcf_path: str = ""
    heartbeat_multiplier: float = setting(3.0, low=1.0, high=100.0)
    retry_factor: int = setting(3, low=1, high=255)


@dataclass(frozen=True)
class MasterConfig:
    """The master; `boot_time` 0 waits for required nodes for ever, `boot_timeout` is that of a boot's SDO answers."""

    node_id: int = setting(1, low=1, high=127)
    channel: str = ""
    baudrate: int = setting(1000, choices=BIT_RATES)
    sync_period: int = setting(0, low=0, high=10_000_000)
    sync_window: int = setting(0, low=0, high=10_000_000)
    sync_overflow: int = setting(0, choices=(0, *range(2, 241)))
    heartbeat_multiplier: float | None = setting(None, low=1.0, high=100.0)
    heartbeat_producer: int = setting(0, low=0, high=0xFFFF)
    boot_time: int = setting(5000, low=0, high=3_600_000)
    boot_timeout: int | None = setting(None, low=1, high=600_000)
    heartbeat_consumer: bool = True
    vendor_id: int = setting(0, low=0, high=0xFFFFFFFF)
    product_code: int = setting(0, low=0, high=0xFFFFFFFF)
    revision_number: int = setting(0, low=0, high=0xFFFFFFFF)
    serial_number: int = setting(0, low=0, high=0xFFFFFFFF)
    time_cob_id: int = setting(0x100, low=0, high=0xFFFFFFFF)
    emcy_inhibit_time: int = setting(0, low=0, high=0xFFFF)
    error_behavior: dict[int, int] = field(default_factory=dict)
    nmt_inhibit_time: int = setting(0, low=0, high=0xFFFF)
    start: bool = True
    start_nodes: bool = True
    start_all_nodes: bool = False
    reset_all_nodes: bool = False
    stop_all_nodes: bool = False
    driver: str = ""
    package: str = ""
    namespace: str = ""
    remappings: Any = None
    dcf_path: str = ""

    @property
    def heartbeat_ms(self) -> int:
        """Period of the master's own heartbeat."""
        return self.heartbeat_producer or DEFAULT_HEARTBEAT_MS


@dataclass(frozen=True)
class NodeKeys:
    """The keys of a node after `defaults` were merged in; scales are SI per device unit (from) and back (to)."""

    dcf: str
    node_id: int = setting(0, low=1, high=127)
    dcf_path: str = ""
    revision_number: int | None = setting(None, low=0, high=0xFFFFFFFF)
    serial_number: int | None = setting(None, low=0, high=0xFFFFFFFF)
    heartbeat_multiplier: float | None = setting(None, low=1.0, high=100.0)
    heartbeat_consumer: bool | None = None
    heartbeat_producer: int = setting(0, low=0, high=0xFFFF)
    guard_time: int = setting(0, low=0, high=0xFFFF)
    life_time_factor: int = setting(0, low=0, high=0xFF)
    retry_factor: int | None = setting(None, low=1, high=255)
    error_behavior: dict[int, int] = setting(factory=dict, low=0, high=0xFF)  # noqa: RUF009 - makes a field
    time_cob_id: int | None = setting(None, low=0, high=0xFFFFFFFF)
    rpdo: dict[int, PdoConfig] = field(default_factory=dict)
    tpdo: dict[int, PdoConfig] = field(default_factory=dict)
    sdo: list[SdoEntry] = field(default_factory=list)
    boot: bool = True
    mandatory: bool | None = None
    required: bool | None = None
    allow_unsupervised: bool = False
    reset_communication: bool = True
    software_file: str = ""
    software_version: int = setting(0, low=0, high=0xFFFFFFFF)
    configuration_file: str = ""
    restore_configuration: int = setting(0, low=0, high=0x7F)
    save_configuration: int = setting(0, low=0, high=0x7F)
    sdo_timeout_ms: int = setting(500, low=1, high=60_000)
    boot_timeout_ms: int = setting(1000, low=1, high=600_000)
    position_mode: int | None = setting(None, low=-128, high=127)
    velocity_mode: int | None = setting(None, low=-128, high=127)
    effort_mode: int | None = setting(None, low=-128, high=127)
    torque_mode: int | None = setting(None, low=-128, high=127)  # what the other documentation calls effort_mode
    scale_pos_to_dev: float = 1000.0
    scale_pos_from_dev: float = 0.001
    scale_vel_to_dev: float = 1000.0
    scale_vel_from_dev: float = 0.001
    scale_eff_from_dev: float = 0.001
    offset_pos_to_dev: float = 0.0
    offset_pos_from_dev: float = 0.0
    channels: list[AxisUnits] = field(default_factory=list)
    counts_per_revolution: float | None = setting(None, low=1e-9, high=1e12)
    gear_ratio: float | list[int] | None = setting(None, low=1e-9, high=1e9)  # noqa: RUF009 - makes a field
    reversed: bool | None = None
    homing_timeout_seconds: float = setting(10.0, low=0.001, high=3600.0)
    recovery: Literal["boot", "enable"] = "boot"
    missed_syncs: int = setting(3, low=1, high=1000)
    following_error_action: Literal["stop", "warn", "ignore"] = "stop"
    transition_timeout_ms: int = setting(5000, low=1, high=600_000)
    transition_timeouts_ms: dict[int, int] = setting(factory=dict, low=1, high=600_000)  # noqa: RUF009 - makes a field
    driver: str = ""
    package: str = ""
    namespace: str = ""
    remappings: Any = None
    polling: bool | None = None
    period: int | None = None
    non_transmit_timeout: int | None = None
    diagnostics: Any = None
    enable_lazy_load: bool | None = None
    switching_state: int | None = None
    num_channels: int | None = None
    channel_names: list[str] | None = None
    channel: int | None = None


@dataclass(frozen=True)
class NodeConfig(NodeKeys):
    """A node as the rest of the package sees it: its keys, and what follows from them and the other sections."""

    required: bool = True
    name: str = ""
    line: int = 0
    multiplier: float = 3.0  # heartbeat_multiplier: the node's, the master's, the file's
    life_factor: int = 3  # life_time_factor, retry_factor of the node, of the file

    @property
    def heartbeat_ms(self) -> int:
        """Period of the node's heartbeat; 0 where it is watched by guarding instead."""
        return self.heartbeat_producer or (0 if self.guarded else DEFAULT_HEARTBEAT_MS)

    @property
    def guarded(self) -> bool:
        """Whether the node is watched by node guarding; a heartbeat goes before it (CiA 301, 7.2.8.3)."""
        return bool(self.guard_time) and not self.heartbeat_producer

    @property
    def heartbeat_timeout_ns(self) -> int:
        """After which silence the node counts as lost; 0 for a guarded one."""
        return round(self.heartbeat_ms * self.multiplier * 1e6)

    def units_of(self, axis: int) -> dict[str, float]:
        """Return the arguments of `units.Scale` for an axis, those of `channels` before the node's own."""
        own = self.channels[axis] if axis < len(self.channels) else AxisUnits()
        names = (*SCALES, "scale_eff_from_dev", "offset_pos_to_dev", "offset_pos_from_dev")
        chosen = {name: getattr(own, name) if getattr(own, name) is not None else getattr(self, name) for name in names}
        return {name.removeprefix("scale_"): value for name, value in chosen.items()}


def named_scales(
    counts_per_revolution: float, gear_ratio: float | list[int] | None, mirrored: bool
) -> dict[str, float]:
    """Return the four scales of `counts_per_revolution` of the motor, `gear_ratio` motor turns per turn of the joint.

    ValueError for a gear ratio that is none.
    """
    if isinstance(gear_ratio, list):
        if len(gear_ratio) != 2 or not all(part > 0 for part in gear_ratio):
            raise ValueError("gear_ratio is a number above 0, or [motor turns, joint turns]")
        gear_ratio = gear_ratio[0] / gear_ratio[1]
    to_device = counts_per_revolution * (gear_ratio or 1.0) / (2 * math.pi) * (-1 if mirrored else 1)
    return {name: to_device if name.endswith("to_dev") else 1 / to_device for name in SCALES}
