"""Reads bus.yml, as ros2_canopen defines it, into frozen dataclasses.

Both shapes are read (`options`, `master`, `defaults`, `nodes`; or the flat one where every other
top-level key is a node), a node's own keys win over `defaults` at every depth, and every mistake of the file is
reported at once with its place. Keys that only the other stack uses are accepted and named in `notes`. The keys
themselves, and what this package adds to them, are in `keys.py`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.channel import parse_channel
from canopen_control.cia301.sync import SYNC_COB_ID
from canopen_control.errors import BusConfigError, ConfigError, nearest
from canopen_control.frame import Service, cob_id
from canopen_control.master.keys import (
    MISNAMED_MASTER,
    MISNAMED_OPTIONS,
    MISNAMED_ROOT,
    UNUSED_MASTER,
    UNUSED_NODE,
    MasterConfig,
    NodeConfig,
    Options,
    PdoConfig,
    PdoObject,
    SdoEntry,
)
from canopen_control.master.named_files import NotFound, Sources
from canopen_control.master.node_config import node_config, tolerated, with_defaults
from canopen_control.master.plan import NodePlan, PlanInput, make_plan
from canopen_control.od.concise import concise_of
from canopen_control.od.model import BIT_RATES
from canopen_control.yamlfile.convert import convert, keys_of
from canopen_control.yamlfile.node import Node
from canopen_control.yamlfile.reader import tree

if TYPE_CHECKING:
    from canopen_control.od.issues import Issue
    from canopen_control.od.model import ObjectDictionary
    from canopen_control.yamlfile.problems import Problems

__all__ = [
    "BusConfig",
    "MasterConfig",
    "NodeConfig",
    "Options",
    "PdoConfig",
    "PdoObject",
    "SdoEntry",
    "inspect_bus",
    "read_bus",
]

_SECTIONS = ("options", "master", "defaults", "nodes")
_TIME_COB_ID = 0x100  # predefined (CiA 301, 7.5.2.18)
_IGNORED_ID = 255  # a node that ros2_canopen's generator leaves out


@dataclass(frozen=True)
class BusConfig:
    """A bus: its master, its nodes by name, and for each node the dictionary and the plan.

    `period_line` is where sync_period stands, 0 where it does not; `sections` are the nodes in the file by name.
    `unreadable` are the nodes that have a mistake in their keys, with their node ids (0: none that can be read).
    """

    path: str
    options: Options
    master: MasterConfig
    nodes: dict[str, NodeConfig]
    dictionaries: dict[str, ObjectDictionary]
    plans: dict[str, NodePlan]
    eds_paths: dict[str, Path]
    notes: tuple[str, ...]
    eds_issues: dict[Path, list[Issue]]
    period_line: int = 0
    sections: dict[str, Node] = field(default_factory=dict, repr=False)
    unreadable: dict[str, int] = field(default_factory=dict)

    def place(self, name: str, key: str) -> Node:
        """Return where a dotted key of a node stands, such as `rpdo.1.mapping`, as near as the file has it."""
        return _place(self.sections[name], key)


def read_bus(path: str | Path, *, peer_merge: bool = False, allow_unsupervised: bool = False) -> BusConfig:
    """Read a bus.yml with the files it names; raises `BusConfigError` with every mistake.

    With `peer_merge` the keys of `defaults` go before a node's own, whole, as in ros2_canopen's generator;
    `allow_unsupervised` is the key of this name for all nodes.
    """
    config, problems = inspect_bus(path, peer_merge=peer_merge, allow_unsupervised=allow_unsupervised)
    problems.raise_if_any(BusConfigError)
    return config


def inspect_bus(
    path: str | Path, *, peer_merge: bool = False, allow_unsupervised: bool = False
) -> tuple[BusConfig, Problems]:
    """Read as `read_bus` does and return what could be read with all problems; what is no YAML at all raises."""
    root = tree(path)
    reader = _Reader(Path(path), root, peer_merge, allow_unsupervised)
    config = reader.read()
    notes = tuple(str(warning) for warning in root.problems.warnings)
    return replace(config, notes=notes + config.notes), root.problems


class _Reader:
    """One reading of one file; mistakes are collected in `problems`."""

    def __init__(self, path: Path, root: Node, peer_merge: bool, allow_unsupervised: bool) -> None:
        self._path, self._root, self._peer_merge = path, root, peer_merge
        self._allow_unsupervised = allow_unsupervised
        options = root.get("options")
        self._options = Options() if options is None else self._read_options(options)
        self._sources = Sources(path.parent, self._options.dcf_path)
        self._unused: dict[str, str] = {}
        self._unreadable: dict[str, int] = {}
        self._remarks: list[str] = []
        self._doubled: set[str] = set()  # nodes whose id another one has: all their COB-IDs follow from that
        self._spare_cob_ids = itertools.count(0x680)  # where ros2_canopen's generator begins with `auto` above PDO 4

    def read(self) -> BusConfig:
        master = self._master()
        nodes = self._nodes(master)
        self._check_node_ids(master, nodes)
        found = {name: self._dictionary(config, node) for name, (config, node) in nodes.items()}
        paths = {name: each[0] for name, each in found.items() if each is not None}
        dictionaries = {name: each[1] for name, each in found.items() if each is not None}
        plans = {name: self._plan(master, *nodes[name], dictionaries[name], paths[name]) for name in paths}
        self._check_cob_ids(nodes, plans)
        return BusConfig(
            str(self._path),
            self._options,
            master,
            {name: config for name, (config, _) in nodes.items()},
            dictionaries,
            plans,
            paths,
            (
                *(f"{self._path}: {key}: {why}" for key, why in sorted(self._unused.items())),
                *dict.fromkeys(self._remarks),
            ),
            self._sources.issues,
            self._period_line(),
            {name: node for name, (_, node) in nodes.items()},
            self._unreadable,
        )

    # ------------------------------------------------------------------------------------------- sections

    def _read_options(self, section: Node) -> Options:
        ignored = tolerated(section, keys_of(Options), {}, MISNAMED_OPTIONS)
        options: Options = convert(section, Options, Options(), ignored=ignored)
        return options

    def _master(self) -> MasterConfig:
        section = self._root.get("master")
        if section is None:
            if not self._misplaced_master():
                self._root.error("no `master` section; it needs at least node_id and sync_period")
            return MasterConfig()
        ignored = tolerated(section, keys_of(MasterConfig), UNUSED_MASTER, MISNAMED_MASTER)
        master: MasterConfig = convert(self._in_kbits(section), MasterConfig, MasterConfig(), ignored=ignored)
        self._note_unused(section, UNUSED_MASTER)
        if master.channel:
            channel = self._sources.expanded(master.channel)
            try:
                parse_channel(channel)
            except ConfigError as error:
                (section.get("channel") or section).error(str(error))
            master = replace(master, channel=channel)
        return master

    def _misplaced_master(self) -> bool:
        """Whether the keys of the master stand elsewhere, which is told of each of them."""
        options = self._root.get("options")
        inside = options is not None and options.get("master") is not None
        return inside or any("`master:`" in MISNAMED_ROOT.get(key, "") for key in self._root.keys())  # noqa: SIM118

    def _in_kbits(self, section: Node) -> Node:
        """Take a bit rate that is given in bit/s for one in kbit/s, and note it; ros2_canopen uses no bit rate."""
        place, pairs = section.get("baudrate"), {key.text: (key, value) for key, value in section.pairs()}
        if place is None or type(place.value) is not int or place.value not in [1000 * rate for rate in BIT_RATES]:
            return section
        kbits = place.value // 1000
        self._unused["master.baudrate"] = f"{place.text} is taken as bit/s: write {kbits}, the unit is kbit/s"
        copy = Node("scalar", place.line, place.column, place.where, place.problems)
        pairs["baudrate"] = pairs["baudrate"][0], Node.scalar(copy, str(kbits), kbits, quoted=False)
        whole = Node("mapping", section.line, section.column, section.where, section.problems)
        return Node.mapping(whole, pairs)

    def _period_line(self) -> int:
        section = self._root.get("master")
        place = section.get("sync_period") if section is not None else None
        return place.line if place is not None else 0

    def _nodes(self, master: MasterConfig) -> dict[str, tuple[NodeConfig, Node]]:
        """Find the nodes in either shape and merge `defaults` below each."""
        section, defaults = self._root.get("nodes"), self._root.get("defaults")
        if section is not None:
            self._refuse_unknown_sections()
        else:
            section = self._misnamed_nodes()
        pairs = section.items() if section is not None else self._root.items()
        found = {}
        for name, node in pairs:
            if name.startswith(".") or (section is None and name in _SECTIONS):
                continue
            merged = with_defaults(name, node, defaults, peer_merge=self._peer_merge)
            self._note_unused(merged, UNUSED_NODE)
            if (place := merged.get("node_id")) is not None and place.value == _IGNORED_ID:
                place.warning(f"{name} is left out: node_id {_IGNORED_ID} stands for no node")
                continue
            if (config := node_config(name, merged, master, self._options)) is not None:
                if self._allow_unsupervised:
                    config = replace(config, supervision=replace(config.supervision, allow_unsupervised=True))
                found[name] = (config, merged)
            else:
                node_id = place.value if place is not None else 0
                self._unreadable[name] = node_id if type(node_id) is int else 0
        if not found and not self._root.problems.errors:
            self._root.error("no nodes; list the drives under `nodes:`")
        return found

    def _misnamed_nodes(self) -> Node | None:
        """Return a section that holds the nodes under another name, which is told; None in the flat shape."""
        for name, section in self._root.items():
            below = [each for _, each in section.items()]
            if name not in _SECTIONS and below and all(each.get("node_id") is not None for each in below):
                self._root.keys()[name].error(f"unknown key {name!r}; write `nodes:`")
                return section
        return None

    def _refuse_unknown_sections(self) -> None:
        for name, place in self._root.keys().items():
            if name not in _SECTIONS and not name.startswith("."):
                meant = MISNAMED_ROOT.get(name, "")
                text = f"; write {meant}" if meant else f"{nearest(name, _SECTIONS)}; a node belongs under `nodes:`"
                place.error(f"unknown key {name!r}{text}")

    def _note_unused(self, node: Node, unused: dict[str, str]) -> None:
        for key in node.keys():  # noqa: SIM118 - a Node is no mapping
            if key in unused:
                self._unused.setdefault(key, f"has no meaning here: {unused[key]}")

    # ------------------------------------------------------------------------------------------- across nodes

    def _check_node_ids(self, master: MasterConfig, nodes: dict[str, tuple[NodeConfig, Node]]) -> None:
        owner = {master.node_id: "the master"}
        for name, (config, node) in nodes.items():
            if not (node_id := config.node_id):
                if (found := self._dictionary(config, node)) is None:
                    continue
                if (node_id := found[1].node_id or 0) == 0:
                    node.error(f"missing key 'node_id'; {config.identity.dcf} has none either")
                    continue
                nodes[name] = (replace(config, node_id=node_id), node)
            place = node.get("node_id") or node
            if node_id in owner:
                self._doubled.add(name)
                place.error(f"node id {node_id} is already that of {owner[node_id]}; give {name} another")
            owner.setdefault(node_id, name)

    def _check_cob_ids(self, nodes: dict[str, tuple[NodeConfig, Node]], plans: dict[str, NodePlan]) -> None:
        """Refuse two users of one COB-ID, be they PDOs or services: their senders would destroy each other's frames."""
        owner = {SYNC_COB_ID: "SYNC", _TIME_COB_ID: "TIME"}
        owner |= {cob_id(Service.EMCY, plan.node_id): f"EMCY of {name}" for name, plan in plans.items()}
        for name, plan in plans.items():
            if name in self._doubled:
                continue
            for kind, layouts in (("rpdo", plan.rpdos), ("tpdo", plan.tpdos)):
                for layout in layouts:
                    whose = f"{kind.upper()} {layout.number} of {name}"
                    if (first := owner.setdefault(layout.cob_id, whose)) != whose:
                        place = _place(nodes[name][1], f"{kind}.{layout.number}.cob_id")
                        place.error(f"COB-ID 0x{layout.cob_id:03X} of {whose} is already that of {first}")

    # ------------------------------------------------------------------------------------------- one node's files

    def _dictionary(self, config: NodeConfig, node: Node) -> tuple[Path, ObjectDictionary] | None:
        place = node.get("dcf") or node
        try:
            path = self._sources.find(config.identity.dcf, config.identity.dcf_path)
            return path, self._sources.dictionary(path, config.node_id or None)
        except NotFound as error:
            place.error(str(error))
        except ConfigError as error:
            place.error(f"{config.identity.dcf}: {error}")
        return None

    def _plan(
        self, master: MasterConfig, config: NodeConfig, node: Node, od: ObjectDictionary, eds_path: Path
    ) -> NodePlan:
        def complain(key: str, text: str) -> None:
            place = _place(node, key)
            place.error(_named(config, place, text))

        def warn(key: str, text: str) -> None:
            place = _place(node, key)
            place.warning(_named(config, place, text))

        def remark(key: str, text: str) -> None:
            place = _place(node, key)
            self._remarks.append(f"{self._path}: {_named(config, place, text)}")

        plan = make_plan(
            PlanInput(
                config,
                od,
                source=eds_path.name,
                master=master,
                downloads=self._downloads(config, node, od),
                complain=complain,
                warn=warn,
                note=self._note,
                remark=remark,
                spare_cob_ids=self._spare_cob_ids,
            )
        )
        if not plan.unsupervised:
            return plan
        accepts = "`allow_unsupervised: true` accepts that, or --allow-unsupervised"
        if self._allow_unsupervised:
            accepted = "nothing stops this drive when the master dies, which --allow-unsupervised accepts"
            warn("dcf", f"{accepted}: {plan.unsupervised}")
        elif not config.supervision.allow_unsupervised:
            complain("dcf", f"nothing would stop this drive when the master dies: {plan.unsupervised}; {accepts}")
        return plan

    def _note(self, key: str, text: str) -> None:
        self._unused.setdefault(key, f"has no meaning here: {text}")

    def _downloads(self, config: NodeConfig, node: Node, od: ObjectDictionary) -> tuple[tuple[int, int, bytes], ...]:
        """Read `configuration_file`, or the ParameterValues of a DCF given as `dcf`."""
        if not config.boot.configuration_file:
            return tuple(concise_of(od))
        place = node.get("configuration_file") or node
        try:
            return self._sources.downloads(config.boot.configuration_file, config.identity.dcf_path, config.node_id)
        except NotFound as error:
            place.error(str(error))
        except (ConfigError, ValueError) as error:
            place.error(f"{config.boot.configuration_file}: {error}")
        return ()


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


def _named(config: NodeConfig, place: Node, text: str) -> str:
    """Name the node, unless the place does, or is common to several: then it is told once for all of them."""
    return text if "." in place.where else f"{config.name}: {text}"


def is_supervised(bus: BusConfig, name: str) -> bool:
    """Whether the death of the master stops the axes of a node: by its heartbeat, or by node guarding."""
    return not bus.plans[name].unsupervised
