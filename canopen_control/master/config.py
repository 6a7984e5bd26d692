"""bus.yml, as ros2_canopen defines it, read at start into frozen dataclasses.

The law of the file: both shapes are read (`options`, `master`, `defaults`, `nodes`; or the flat one where every other
top-level key is a node), a node's own keys win over `defaults` at every depth, and every mistake of the file is
reported at once with its place. Keys that only the other stack uses are accepted and named in `notes`.

Beside the format's own keys a node may have `required` (true: the robot does not start without it), `strict` is the
`revision_number` given, and `allow_unsupervised` accepts a drive that nothing would stop when the master dies.
`recovery` says how far a node that comes back goes by itself (booted, or enabled again too), `following_error_action`
what bit 13 leads to, `transition_timeout_ms` how long a drive may take for a transition, `transition_timeouts_ms` the
same by number of the transition.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from canopen_control import yamltree
from canopen_control.data_files import data_path
from canopen_control.errors import BusConfigError, EdsError
from canopen_control.master.plan import NodePlan, make_plan
from canopen_control.od.eds import read_eds
from canopen_control.yamltree import Node, Problems, setting

if TYPE_CHECKING:
    from canopen_control.od.model import ObjectDictionary

__all__ = ["BusConfig", "MasterConfig", "NodeConfig", "Options", "PdoConfig", "PdoObject", "SdoEntry", "read_bus"]

DEFAULT_HEARTBEAT_MS = 100  # where bus.yml asks for none: a dead partner is always noticed
_MERGED_AT_BUILD = "@BUS_CONFIG_PATH@"  # replaced by the other stack's build; here the folder of the file itself
_SECTIONS = ("options", "master", "defaults", "nodes")
#: keys of ros2_canopen that have no meaning here, and what takes their place
FOREIGN = {
    "driver": "every node is driven by this package",
    "package": "every node is driven by this package",
    "namespace": "the ROS bridge's business",
    "remappings": "the ROS bridge's business",
    "polling": "drives are read every SYNC",
    "period": "drives are read every SYNC",
    "non_transmit_timeout": "sending never blocks",
    "diagnostics": "diagnostics are always on",
    "enable_lazy_load": "nodes join when they appear",
    "switching_state": "modes change in any state the drive allows",
    "num_channels": "axes are taken from the EDS",
    "channel_names": "axes are taken from the EDS",
    "channels": "axes are taken from the EDS",
    "retry_factor": "requests are retried by rule",
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
    cob_id: int | str | None = None  # a number, or "auto" for the predefined one
    transmission: int | None = setting(None, low=0, high=255)
    inhibit_time: int | None = setting(None, low=0, high=0xFFFF)
    event_timer: int | None = setting(None, low=0, high=0xFFFF)
    event_deadline: int | None = setting(None, low=0, high=0xFFFF)
    sync_start: int | None = setting(None, low=0, high=240)
    mapping: list[PdoObject] | None = None


@dataclass(frozen=True)
class SdoEntry:
    """One object to be written at boot."""

    index: int = setting(low=0x1000, high=0xFFFF)
    sub_index: int = setting(0, low=0, high=0xFF)
    value: bool | int | float | str = 0


@dataclass(frozen=True)
class Options:
    """What concerns the file as a whole."""

    dcf_path: str = ""
    heartbeat_multiplier: float = setting(3.0, low=1.0, high=100.0)
    retry_factor: int | None = None


@dataclass(frozen=True)
class MasterConfig:
    """The master; periods in us where named sync, in ms where named heartbeat."""

    node_id: int = setting(1, low=1, high=127)
    baudrate: int = 1000
    vendor_id: int = 0
    product_code: int = 0
    revision_number: int = 0
    serial_number: int = 0
    sync_period: int = setting(0, low=0, high=10_000_000)
    sync_window: int = 0
    sync_overflow: int = setting(0, low=0, high=240)
    time_cob_id: int = 0x100
    emcy_inhibit_time: int = 0
    heartbeat_multiplier: float | None = setting(None, low=1.0, high=100.0)
    heartbeat_consumer: bool = True
    heartbeat_producer: int = setting(0, low=0, high=0xFFFF)
    error_behavior: dict[int, int] = field(default_factory=dict)
    nmt_inhibit_time: int = 0
    start: bool = True
    start_nodes: bool = True
    start_all_nodes: bool = False
    reset_all_nodes: bool = False
    stop_all_nodes: bool = False
    boot_time: int = setting(5000, low=0, high=3_600_000)
    boot_timeout: int | None = None
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
class NodeConfig:
    """One node after `defaults` were merged in; scales are SI per device unit (from) and back (to)."""

    dcf: str
    node_id: int = setting(low=1, high=127)
    dcf_path: str = ""
    revision_number: int | None = None
    serial_number: int | None = None
    heartbeat_multiplier: float | None = setting(None, low=1.0, high=100.0)
    heartbeat_consumer: bool | None = None
    heartbeat_producer: int = setting(0, low=0, high=0xFFFF)
    guard_time: int = setting(0, low=0, high=0xFFFF)
    life_time_factor: int = setting(0, low=0, high=0xFF)
    error_behavior: dict[int, int] = field(default_factory=dict)
    time_cob_id: int | None = None
    rpdo: dict[int, PdoConfig] = field(default_factory=dict)
    tpdo: dict[int, PdoConfig] = field(default_factory=dict)
    sdo: list[SdoEntry] = field(default_factory=list)
    boot: bool = True
    mandatory: bool = False
    required: bool = True
    allow_unsupervised: bool = False
    reset_communication: bool = True
    software_file: str = ""
    software_version: int = 0
    configuration_file: str = ""
    restore_configuration: int = 0
    sdo_timeout_ms: int = setting(500, low=1, high=60_000)
    boot_timeout_ms: int = setting(1000, low=1, high=600_000)
    position_mode: int | None = setting(None, low=-128, high=127)
    velocity_mode: int | None = setting(None, low=-128, high=127)
    effort_mode: int | None = setting(None, low=-128, high=127)
    scale_pos_to_dev: float = 1000.0
    scale_pos_from_dev: float = 0.001
    scale_vel_to_dev: float = 1000.0
    scale_vel_from_dev: float = 0.001
    scale_eff_from_dev: float = 0.001
    offset_pos_to_dev: float = 0.0
    offset_pos_from_dev: float = 0.0
    homing_timeout_seconds: float = 10.0
    recovery: Literal["boot", "enable"] = "boot"
    following_error_action: Literal["stop", "warn", "ignore"] = "stop"
    transition_timeout_ms: int = setting(5000, low=1, high=600_000)
    transition_timeouts_ms: dict[int, int] = field(default_factory=dict)
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
    channel_names: Any = None
    channels: Any = None
    retry_factor: int | None = None
    name: str = ""
    line: int = 0
    multiplier: float = 3.0  # resolved: the node's, the master's, the file's

    @property
    def heartbeat_ms(self) -> int:
        """Period of the node's heartbeat; 0 where it is watched by guarding instead."""
        return self.heartbeat_producer or (0 if self.guard_time and self.life_time_factor else DEFAULT_HEARTBEAT_MS)

    @property
    def heartbeat_timeout_ns(self) -> int:
        """After which silence the node counts as lost."""
        return round(self.heartbeat_ms * self.multiplier * 1e6)


@dataclass(frozen=True)
class BusConfig:
    """A bus: its master, its nodes by name, and for each node the dictionary and the plan."""

    path: str
    options: Options
    master: MasterConfig
    nodes: dict[str, NodeConfig]
    dictionaries: dict[str, ObjectDictionary]
    plans: dict[str, NodePlan]
    eds_paths: dict[str, Path]
    notes: tuple[str, ...]


def read_bus(path: str | Path) -> BusConfig:
    """Read a bus.yml with the EDS files it names; raises `BusConfigError` or `EdsError` with every mistake."""
    root = yamltree.tree(path)
    problems = root.problems
    options = root.get("options")
    reader = _Reader(Path(path), root, problems, options.convert(Options, Options()) if options else Options())
    config = reader.read()
    problems.raise_if_any(BusConfigError)
    return replace(config, notes=tuple(str(warning) for warning in problems.warnings) + config.notes)


class _Reader:
    """One reading of one file; mistakes are collected in `problems`."""

    def __init__(self, path: Path, root: Node, problems: Problems, options: Options) -> None:
        self._path, self._root, self._problems, self._options = path, root, problems, options
        self._files: dict[tuple[Path, int], ObjectDictionary] = {}
        self._foreign: dict[str, str] = {}

    def read(self) -> BusConfig:
        section = self._root.get("master")
        master = MasterConfig()
        if section is None:
            self._root.error("no `master` section; it needs at least node_id and sync_period")
        else:
            master = section.convert(MasterConfig, master)
            self._note_foreign(section)
        nodes = self._nodes(master)
        self._check_node_ids(master, nodes)
        paths = {
            name: eds for name, (config, node) in nodes.items() if (eds := self._eds_path(config, node)) is not None
        }
        dictionaries = {name: self._dictionary(paths[name], nodes[name][0]) for name in paths}
        plans = {name: self._plan(master, *nodes[name], dictionaries[name], paths[name]) for name in paths}
        return BusConfig(
            str(self._path),
            self._options,
            master,
            {name: config for name, (config, _) in nodes.items()},
            dictionaries,
            plans,
            paths,
            tuple(f"{self._path}: {key}: {why}" for key, why in sorted(self._foreign.items())),
        )

    def _nodes(self, master: MasterConfig) -> dict[str, tuple[NodeConfig, Node]]:
        """Find the nodes in either shape and merge `defaults` below each."""
        section, defaults = self._root.get("nodes"), self._root.get("defaults")
        pairs = section.items() if section is not None else self._root.items()
        found = {}
        for name, node in pairs:
            if section is None and (name in _SECTIONS or name.startswith(".")):
                continue
            merged = node.over(defaults) if defaults is not None else node
            config = merged.convert(NodeConfig)
            if config is None:
                continue
            multiplier = (
                config.heartbeat_multiplier or master.heartbeat_multiplier or self._options.heartbeat_multiplier
            )
            found[name] = (replace(config, name=name, line=node.line, multiplier=multiplier), merged)
            self._note_foreign(merged)
        if not found:
            self._root.error("no nodes; list the drives under `nodes:`")
        return found

    def _note_foreign(self, node: Node) -> None:
        for key in node.keys():  # noqa: SIM118 - a Node is no mapping
            if key in FOREIGN:
                self._foreign.setdefault(key, f"has no meaning here: {FOREIGN[key]}")

    def _check_node_ids(self, master: MasterConfig, nodes: dict[str, tuple[NodeConfig, Node]]) -> None:
        owner = {master.node_id: "the master"}
        for name, (config, node) in nodes.items():
            place = node.get("node_id") or node
            if config.node_id in owner:
                place.error(f"node id {config.node_id} is already that of {owner[config.node_id]}; give {name} another")
            owner.setdefault(config.node_id, name)

    def _eds_path(self, config: NodeConfig, node: Node) -> Path | None:
        """Seek the file in dcf_path, beside bus.yml and among the bundled ones."""
        wanted = Path(os.path.expandvars(config.dcf)).expanduser()
        folders = [self._folder(text) for text in (config.dcf_path, self._options.dcf_path) if text]
        places = [folder / wanted for folder in [*folders, self._path.parent]] + [data_path("eds", wanted.name)]
        for place in places:
            if place.is_file():
                return place
        sought = ", ".join(dict.fromkeys(str(place.parent) for place in places))
        (node.get("dcf") or node).error(f"no file {config.dcf!r}; sought in {sought}")
        return None

    def _folder(self, text: str) -> Path:
        return Path(os.path.expandvars(text.replace(_MERGED_AT_BUILD, str(self._path.parent)))).expanduser()

    def _dictionary(self, path: Path, config: NodeConfig) -> ObjectDictionary:
        if (path, config.node_id) not in self._files:
            try:
                self._files[path, config.node_id] = read_eds(path, config.node_id).od
            except OSError as error:
                raise EdsError(str(path), 0, f"cannot be read: {error.strerror}") from error
        return self._files[path, config.node_id]

    def _plan(
        self, master: MasterConfig, config: NodeConfig, node: Node, od: ObjectDictionary, eds_path: Path
    ) -> NodePlan:
        def complain(key: str, text: str) -> None:
            self._place(node, key).error(f"{config.name}: {text}")

        plan = make_plan(
            config,
            od,
            source=eds_path.name,
            master_id=master.node_id,
            master_heartbeat_ms=master.heartbeat_ms if config.heartbeat_consumer is not False else 0,
            sync_period_us=master.sync_period,
            complain=complain,
        )
        if plan.axes and not config.allow_unsupervised and not _supervised(config, od):
            complain(
                "dcf",
                "nothing would stop this drive when the master dies: it has neither a heartbeat consumer (0x1016) "
                "nor node guarding; `allow_unsupervised: true` accepts that",
            )
        return plan

    @staticmethod
    def _place(node: Node, key: str) -> Node:
        """Find the node of a dotted key such as `rpdo.1.mapping` or `sdo[3]`, as near as the file has it."""
        place = node
        for part in key.replace("[", ".").replace("]", "").split("."):
            if part.isdigit() and (elements := place.elements()):
                found: Node | None = elements[int(part)] if int(part) < len(elements) else None
            else:
                found = place.get(part)
            if found is None:
                break
            place = found
        return place


def _supervised(config: NodeConfig, od: ObjectDictionary) -> bool:
    heartbeat = (0x1016, 1) in od and config.heartbeat_consumer is not False
    guarding = bool(config.guard_time and config.life_time_factor and (0x100C, 0) in od)
    return heartbeat or guarding
