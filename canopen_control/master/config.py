"""Reader of bus.yml files in the format of ros2_canopen, which it converts to frozen dataclasses.

Two forms are accepted: with the sections `options`, `master`, `defaults` and `nodes`, or without `nodes`, where every
other top-level key is a node. A node's own keys take precedence over `defaults` at every depth. All errors of a file
are reported together with their lines. Keys used only by ros2_canopen are accepted and listed in `notes`. The keys,
including the additions of this package, are defined in `keys.py`.
"""

from __future__ import annotations

import itertools
import os
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.bus.channel import parse_channel
from canopen_control.cia301.sync import SYNC_COB_ID
from canopen_control.cia402.objects import has_loss_reaction
from canopen_control.data_files import data_path
from canopen_control.errors import BusConfigError, ConfigError, closest, nearest
from canopen_control.frame import Service, cob_id
from canopen_control.master.keys import (
    MISNAMED_MASTER,
    MISNAMED_OPTIONS,
    MISNAMED_ROOT,
    UNUSED_MASTER,
    UNUSED_NODE,
    FileOptions,
    MasterConfig,
    NodeConfig,
)
from canopen_control.master.node_config import node_config, node_id_below, tolerated, with_defaults
from canopen_control.master.plan import UNWATCHED, NodePlan, plan_node
from canopen_control.master.plan_builder import PlanBuilder
from canopen_control.od.dcf import concise_of, decode_concise
from canopen_control.od.eds import SUFFIXES, read_eds
from canopen_control.od.indices import GUARD_TIME, LIFE_FACTOR
from canopen_control.od.model import BIT_RATES
from canopen_control.yamlfile.convert import convert, keys_of
from canopen_control.yamlfile.node import Node
from canopen_control.yamlfile.reader import tree

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.od.eds import EdsFile
    from canopen_control.od.issues import Issue
    from canopen_control.od.model import ObjectDictionary
    from canopen_control.yamlfile.node import Problems


# Files that a bus.yml names (EDS, DCF, configuration files), each of which is read only once.
#
# A file is searched for in the node's dcf_path, the dcf_path of `options`, the folder of bus.yml and the bundled files,
# in this order; `@BUS_CONFIG_PATH@` is the folder of bus.yml, `$NAME` an environment variable.


BUS_FOLDER = "@BUS_CONFIG_PATH@"  # replaced during the build of ros2_canopen; here the folder of bus.yml


class NotFound(ConfigError):
    """Error for a file that was not found; the message lists the searched folders."""


class Sources:
    """Files that a bus.yml in `folder` names; `issues` are the problems found in each EDS.

    `bundled` maps the path of each bundled file in use to the folders that were searched before.
    """

    def __init__(self, folder: Path, dcf_path: str = "") -> None:
        self._folder, self._dcf_path = folder, dcf_path
        self._files: dict[Path, EdsFile] = {}
        self._dictionaries: dict[tuple[Path, int | None], ObjectDictionary] = {}
        self.issues: dict[Path, list[Issue]] = {}
        self.bundled: dict[Path, list[Path]] = {}

    def expanded(self, text: str) -> str:
        """Substitute `@BUS_CONFIG_PATH@` and environment variables in a text."""
        return os.path.expandvars(text.replace(BUS_FOLDER, str(self._folder)))

    def find(self, name: str, dcf_path: str = "") -> Path:
        """Return the path of a named file; raise NotFound, with the searched folders, if it does not exist."""
        path = Path(self.expanded(name)).expanduser()
        folders = [Path(self.expanded(text)).expanduser() for text in (dcf_path, self._dcf_path) if text]
        places = [folder / path for folder in [*folders, self._folder]]
        places.append(self._folder / path.name)
        for place in places:
            if place.is_file():
                return place
        bundled = data_path("eds", path.name)
        if bundled.is_file():
            self.bundled.setdefault(bundled, []).extend(place.parent for place in places)
            return bundled
        searched = ", ".join(dict.fromkeys(str(place.parent) for place in (*places, bundled)))
        unset = "; an environment variable is not set" if "$" in searched or "$" in str(path) else ""
        looked = dict.fromkeys(place.parent for place in (*places, bundled))
        known = [file.name for folder in looked for file in _entries(folder) if file.suffix.lower() in SUFFIXES]
        raise NotFound(f"file {name!r} not found in {searched}{nearest(path.name, known, listed=False)}{unset}")

    def unused_namesake(self, bundled: Path) -> Path | None:
        """Return a file near bus.yml with the name of a bundled file (in any case) but other content, or None."""
        folders = [self._folder, *(entry for entry in _entries(self._folder) if entry.is_dir())]
        named = (file for folder in folders for file in _entries(folder) if file.name.lower() == bundled.name.lower())
        readable = (file for file in named if file.is_file() and os.access(file, os.R_OK))
        return next((file for file in readable if file.read_bytes() != bundled.read_bytes()), None)

    def dictionary(self, path: Path, node_id: int | None) -> ObjectDictionary:
        """Return the object dictionary of a file for a node-ID (None: the file's own node-ID).

        Raise EdsError if the file is invalid.
        """
        if (path, node_id) not in self._dictionaries:
            if path not in self._files:
                self._files[path] = read_eds(path)
                self.issues[path] = self._files[path].issues
            od = self._files[path].od
            self._dictionaries[path, node_id] = od if node_id is None else od.for_node(node_id)
        return self._dictionaries[path, node_id]

    def downloads(self, name: str, dcf_path: str, node_id: int) -> tuple[tuple[int, int, bytes], ...]:
        """Return the SDO downloads in a concise DCF (.bin) or a DCF, as (index, subindex, data).

        The ParameterValues of a DCF are returned by ascending address, an order in which PDO parameters cannot be
        written. Raise ValueError, EdsError or NotFound if the file cannot be used.
        """
        path = self.find(name, dcf_path)
        if path.suffix.lower() in SUFFIXES:
            return tuple(concise_of(self.dictionary(path, node_id)))
        try:
            return tuple(decode_concise(path.read_bytes()))
        except OSError as error:
            raise ValueError(f"cannot be read: {error.strerror}") from error


def _entries(folder: Path) -> list[Path]:
    """Return the entries of a folder, sorted; [] for a folder that cannot be read."""
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


_SECTIONS = ("options", "master", "defaults", "nodes")
_TIME_COB_ID = 0x100  # predefined (CiA 301, 7.3.3)
_SYNCHRONOUS: Final = (*range(241), 252)  # transmission types that wait for SYNC (CiA 301, 7.5.2.35 and 7.5.2.37)
_NAMED_PDOS: Final = 4
_REPEATED_NODE: Final = re.compile(r"nodes\.[^.]+")
_FOR_BOTH: Final = "write it under `options`, where both use it for either side"
_IGNORED_ID = 255  # node-ID of a node that ros2_canopen's generator leaves out


@dataclass(frozen=True)
class BusConfig:
    """Configuration of a bus from bus.yml; nodes, object dictionaries, plans and EDS paths are keyed by node name.

    The dictionary of a device with several motors in one object set is the view of its axes. `period_line` is the line
    of sync_period, 0 without that key; `sections` maps each node name to its YAML node, `unreadable` each
    node with errors in its keys to its node-ID, 0 if unknown. `substitutes` are sentences about bundled files in use.
    `note_lines` are the lines of the keys in `notes`. `incomplete` means that two nodes have one name, so that one is
    missing.
    """

    path: str
    options: FileOptions
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
    substitutes: tuple[str, ...] = ()
    note_lines: dict[str, int] = field(default_factory=dict)
    incomplete: bool = False

    def place(self, name: str, key: str) -> Node:
        """Return the YAML node of a node's dotted key, such as `rpdo.1.mapping`, or of the nearest parent key."""
        return _place(self.sections[name], key)


def read_bus(path: str | Path, *, peer_merge: bool = False, allow_unsupervised: bool = False) -> BusConfig:
    """Read a bus.yml and the files that it names; raise BusConfigError, which lists all errors.

    With `peer_merge` the keys of `defaults` replace a node's own keys, as in ros2_canopen's generator;
    `allow_unsupervised` sets the key of this name for all nodes.
    """
    config, problems = inspect_bus(path, peer_merge=peer_merge, allow_unsupervised=allow_unsupervised)
    problems.raise_if_any(BusConfigError)
    return config


def inspect_bus(
    path: str | Path, *, peer_merge: bool = False, allow_unsupervised: bool = False
) -> tuple[BusConfig, Problems]:
    """Read a bus.yml like `read_bus`, but return the readable part with all problems; YAML syntax errors are raised."""
    root = tree(path)
    reader = _Reader(Path(path), root, peer_merge, allow_unsupervised)
    config = reader.read()
    notes = tuple(str(warning) for warning in root.problems.warnings)
    return replace(config, notes=notes + config.notes), root.problems


class _Reader:
    """Reader of one bus.yml; errors are collected in the `problems` of the YAML root."""

    def __init__(self, path: Path, root: Node, peer_merge: bool, allow_unsupervised: bool) -> None:
        self._path, self._root, self._peer_merge = path, _with_misspelt_sections(root), peer_merge
        self._allow_unsupervised = allow_unsupervised
        options = self._root.get("options")
        self._options = FileOptions() if options is None else self._read_options(options)
        self._sources = Sources(path.parent, self._options.dcf_path)
        self._unused: dict[str, tuple[str, int]] = {}
        self._unreadable: dict[str, int] = {}
        self._remarks: list[str] = []
        self._doubled: set[str] = set()  # nodes with the id of another node, so that their COB-IDs are not checked
        self._spare_cob_ids = itertools.count(0x680)  # range of ros2_canopen's generator, for `auto` above PDO 4

    def read(self) -> BusConfig:
        master = self._master()
        unclear = len(self._root.problems.errors)  # errors in the keys of `master`, which may cause the later ones
        nodes = self._nodes(master)
        self._check_node_ids(master, nodes)
        read_files = {name: self._dictionary(config, node) for name, (config, node) in nodes.items()}
        paths = {name: pair[0] for name, pair in read_files.items() if pair is not None}
        dictionaries = {name: pair[1] for name, pair in read_files.items() if pair is not None}
        plans = {name: self._plan(master, *nodes[name], dictionaries[name], paths[name]) for name in paths}
        dictionaries |= {name: plan.motors.view for name, plan in plans.items() if plan.motors is not None}
        self._note_multipliers(master, nodes)
        self._check_cob_ids(nodes, plans)
        if not unclear:
            self._check_sync(master, plans)
        _warn_of_empty(self._root)
        unused = {f"{self._path}: {key}: {why}": line for key, (why, line) in sorted(self._unused.items())}
        return BusConfig(
            str(self._path),
            self._options,
            master,
            {name: config for name, (config, _) in nodes.items()},
            dictionaries,
            plans,
            paths,
            (*unused, *dict.fromkeys(self._remarks)),
            self._sources.issues,
            self._period_line(),
            {name: node for name, (_, node) in nodes.items()},
            self._unreadable,
            tuple(self._substitutes(paths, nodes)),
            unused,
            incomplete=any(_REPEATED_NODE.fullmatch(error.where) for error in self._root.problems.repeated),
        )

    def _substitutes(self, paths: dict[str, Path], nodes: dict[str, tuple[NodeConfig, Node]]) -> Iterator[str]:
        """Yield a sentence about each bundled file used instead of a missing one; warn about unused namesakes."""
        if self._path.resolve().is_relative_to(data_path("config", "").resolve()):
            return  # bundled robots use bundled files
        for path, folders in self._sources.bundled.items():
            searched = ", ".join(dict.fromkeys(map(str, folders)))
            yield (
                f"{self._path}: {path.name} is not in {searched}, so the bundled file {path} is used; "
                "if your device has another file, copy it to that folder"
            )
            other = self._sources.unused_namesake(path)
            user = next((nodes[name][1] for name in paths if paths[name] == path), None)
            if other is not None and user is not None:
                (user.get("dcf") or user).warning(
                    f"the bundled file {path} is used, and {other}, whose content differs, is not; "
                    f"write `dcf: {os.path.relpath(other, self._path.parent)}` to use it"
                )

    # ------------------------------------------------------------------------------------------- sections

    def _read_options(self, section: Node) -> FileOptions:
        ignored = tolerated(section, keys_of(FileOptions), {}, MISNAMED_OPTIONS)
        options: FileOptions = convert(section, FileOptions, FileOptions(), ignored=ignored)
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
        """Whether keys of the master are in a wrong section; that error is reported elsewhere."""
        options = self._root.get("options")
        inside = options is not None and options.get("master") is not None
        return inside or any("`master:`" in MISNAMED_ROOT.get(key, "") for key in self._root.keys())  # noqa: SIM118

    def _in_kbits(self, section: Node) -> Node:
        """Return the section with a bit rate in bit/s converted to kbit/s, and note it; ros2_canopen ignores it."""
        place, pairs = section.get("baudrate"), {key.text: (key, value) for key, value in section.pairs()}
        if place is None or type(place.value) is not int or place.value not in [1000 * rate for rate in BIT_RATES]:
            return section
        kbits = place.value // 1000
        why = f"{place.text} is interpreted as bit/s; write {kbits}, the unit is kbit/s"
        self._unused["master.baudrate"] = why, place.line
        copy = Node("scalar", place.line, place.column, place.where, place.problems)
        pairs["baudrate"] = pairs["baudrate"][0], Node.scalar(copy, str(kbits), kbits, quoted=False)
        root = Node("mapping", section.line, section.column, section.where, section.problems)
        return Node.mapping(root, pairs)

    def _period_line(self) -> int:
        section = self._root.get("master")
        place = section.get("sync_period") if section is not None else None
        return place.line if place is not None else 0

    def _nodes(self, master: MasterConfig) -> dict[str, tuple[NodeConfig, Node]]:
        """Return the nodes from either form of the file, with `defaults` merged into each node."""
        section, defaults = self._root.get("nodes"), self._root.get("defaults")
        if section is not None:
            self._refuse_unknown_sections()
            _require_mapping(section)
        else:
            section = self._misnamed_nodes()
        pairs = section.items() if section is not None else self._root.items()
        nodes = {}
        for name, node in pairs:
            if name.startswith(".") or (section is None and name in _SECTIONS):
                continue
            merged = with_defaults(name, node, defaults, peer_merge=self._peer_merge)
            self._note_unused(merged, UNUSED_NODE)
            if (place := merged.get("node_id")) is not None and place.value == _IGNORED_ID:
                place.warning(f"{name} is skipped: node_id {_IGNORED_ID} means that no node is used")
                continue
            if (read := node_config(name, merged, master, self._options)) is not None:
                config, section_read = read
                if self._allow_unsupervised:
                    config = replace(config, supervision=replace(config.supervision, allow_unsupervised=True))
                nodes[name] = (config, section_read)
            else:
                node_id = place.value if place is not None else 0
                self._unreadable[name] = node_id if type(node_id) is int else 0
        if not nodes:
            self._report_indented_nodes()
        if not nodes and not self._root.problems.errors:
            self._root.error("no nodes; list the drives under `nodes:`")
        return nodes

    def _report_indented_nodes(self) -> None:
        """Report nodes, or the section `nodes`, that are indented below `defaults` by mistake."""
        defaults = self._root.get("defaults")
        for key, place in defaults.keys().items() if defaults is not None else ():
            if key == "nodes" or (defaults is not None and node_id_below(defaults, key) is not None):
                place.error(f"unknown key {key!r}; write `{key}:` at the margin; it is indented too far")

    def _misnamed_nodes(self) -> Node | None:
        """Report and return a section that contains nodes under a name other than `nodes`, or None."""
        for name, section in self._root.items():
            below = [child for _, child in section.items()]
            if name not in _SECTIONS and below and all(child.get("node_id") is not None for child in below):
                self._root.keys()[name].error(f"unknown key {name!r}; write `nodes:`")
                return section
        return None

    def _refuse_unknown_sections(self) -> None:
        for name, place in self._root.keys().items():
            if name not in _SECTIONS and not name.startswith("."):
                suggestion = MISNAMED_ROOT.get(name, "")
                text = (
                    f"; write {suggestion}"
                    if suggestion
                    else f"{nearest(name, _SECTIONS)}; a node belongs under `nodes:`"
                )
                place.error(f"unknown key {name!r}{text}")

    def _note_unused(self, node: Node, unused: dict[str, str]) -> None:
        for key, place in node.keys().items():
            if key in unused:
                self._unused.setdefault(key, (f"has no meaning here: {unused[key]}", place.line))

    # ------------------------------------------------------------------------------------------- across nodes

    def _note_multipliers(self, master: MasterConfig, nodes: dict[str, tuple[NodeConfig, Node]]) -> None:
        """Note a heartbeat_multiplier whose meaning for ros2_canopen is narrower.

        dcfgen uses a node's multiplier only for the loss of that node, the master's only for the loss of the master.
        """
        whole = self._options.heartbeat_multiplier
        of_master = master.heartbeat_multiplier or whole
        section = self._root.get("master")
        place = None if section is None else section.keys().get("heartbeat_multiplier")
        own = {name: key for name, (_, node) in nodes.items() if (key := node.keys().get("heartbeat_multiplier"))}
        differing = [key for name, key in own.items() if nodes[name][0].supervision.multiplier != of_master]
        if differing:
            why = f"is also used for the loss of the master; ros2_canopen uses {of_master:g} for that; {_FOR_BOTH}"
            self._unused["heartbeat_multiplier"] = why, differing[0].line
        elif place is not None and of_master != whole and len(own) < len(nodes):
            why = f"is also used for the loss of a node; ros2_canopen uses {whole:g} for that; {_FOR_BOTH}"
            self._unused["master.heartbeat_multiplier"] = why, place.line

    def _check_node_ids(self, master: MasterConfig, nodes: dict[str, tuple[NodeConfig, Node]]) -> None:
        section = self._root.get("master")
        place = section.get("node_id") if section is not None else None
        wrong = place is not None and place.value != master.node_id  # reported; no master has the default
        owner = {} if wrong else {master.node_id: "the master"}
        for name, (config, node) in nodes.items():
            if not (node_id := config.node_id):
                if (dictionary := self._dictionary(config, node)) is None:
                    continue
                if (node_id := dictionary[1].node_id or 0) == 0:
                    node.error(f"missing key 'node_id'; {config.identity.dcf} has none either")
                    continue
                nodes[name] = (replace(config, node_id=node_id), node)
            place = node.get("node_id") or node
            if node_id in owner:
                self._doubled.add(name)
                place.error(f"node-ID {node_id} is already used by {owner[node_id]}; choose another for {name}")
            owner.setdefault(node_id, name)

    def _check_cob_ids(self, nodes: dict[str, tuple[NodeConfig, Node]], plans: dict[str, NodePlan]) -> None:
        """Report COB-IDs that are used by two PDOs, or by a PDO and a service."""
        owner = {SYNC_COB_ID: "SYNC", _TIME_COB_ID: "TIME"}
        owner |= {cob_id(Service.EMCY, plan.node_id): f"EMCY of {name}" for name, plan in plans.items()}
        for name, plan in plans.items():
            if name in self._doubled:
                continue
            for kind, layouts in (("rpdo", plan.rpdos), ("tpdo", plan.tpdos)):
                for layout in layouts:
                    pdo = f"{kind.upper()} {layout.number} of {name}"
                    if (first := owner.setdefault(layout.cob_id, pdo)) != pdo:
                        place = _place(nodes[name][1], f"{kind}.{layout.number}.cob_id")
                        remedy = _own_cob_ids(kind, nodes[name][1], [each.number for each in layouts])
                        place.error(f"COB-ID 0x{layout.cob_id:03X} of {pdo} is already used by {first}{remedy}")

    def _check_sync(self, master: MasterConfig, plans: dict[str, NodePlan]) -> None:
        """Report synchronous PDOs on a bus without a SYNC producer (CiA 301, 7.5.2.35 and 7.5.2.37)."""
        if master.sync_period:
            return
        pdos = [
            f"{kind} {layout.number} of {name}"
            for name, plan in plans.items()
            for kind, layouts in (("RPDO", plan.rpdos), ("TPDO", plan.tpdos))
            for layout in layouts
            if layout.transmission_type in _SYNCHRONOUS
        ]
        if pdos:
            section = self._root.get("master") or self._root
            more = f" and {len(pdos) - _NAMED_PDOS} more" if len(pdos) > _NAMED_PDOS else ""
            (section.get("sync_period") or section).warning(
                f"no SYNC is sent without sync_period, so that these synchronous PDOs have no effect: "
                f"{', '.join(pdos[:_NAMED_PDOS])}{more}; set sync_period in us, such as 20000, or transmission: 255"
            )

    # ------------------------------------------------------------------------------------------- one node's files

    def _dictionary(self, config: NodeConfig, node: Node) -> tuple[Path, ObjectDictionary] | None:
        place = node.get("dcf") or node
        try:
            path = self._sources.find(config.identity.dcf, config.identity.dcf_path)
            named = Path(self._sources.expanded(config.identity.dcf)).expanduser()
            if not path.match(str(named)) and path not in self._sources.bundled:
                self._remarks.append(f"{self._path}: {named} does not exist; {path} is used instead")
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
            place.error(_named(config, place, text + _decimal_hint(place, od)))

        def warn(key: str, text: str) -> None:
            place = _place(node, key)
            place.warning(_named(config, place, text))

        def note(key: str, text: str) -> None:
            self._unused.setdefault(key, (f"has no meaning here: {text}", _place(node, key).line))

        def remark(key: str, text: str) -> None:
            place = _place(node, key)
            self._remarks.append(f"{self._path}: {_named(config, place, text)}")

        downloads = self._downloads(config, node, od)
        builder = PlanBuilder(config, od, complain, warn, note, self._spare_cob_ids, downloads, remark)
        plan = plan_node(builder, master, eds_path.name)
        if not plan.unsupervised:
            known = all(has_loss_reaction(od, offset) for offset in plan.axes)
            if not config.supervision.allow_unsupervised and not known:
                warn("dcf", _UNKNOWN_REACTION)
            return plan
        accepts = "accept that with `allow_unsupervised: true` or --allow-unsupervised"
        if self._allow_unsupervised:
            accepted = "nothing stops this drive when the master is lost, which --allow-unsupervised accepts"
            warn("dcf", f"{accepted}: {plan.unsupervised}")
        elif not config.supervision.allow_unsupervised:
            off = plan.unsupervised.startswith("heartbeat_consumer ")
            key, accepts = ("heartbeat_consumer", f"write true, or {accepts}") if off else ("dcf", accepts)
            if (
                plan.unsupervised == UNWATCHED
                and builder.can_write(GUARD_TIME, 0)
                and builder.can_write(LIFE_FACTOR, 0)
            ):
                accepts = f"replace heartbeat_producer by `guard_time: 100` and `life_time_factor: 5`, or {accepts}"
            complain(key, f"nothing would stop this drive when the master is lost: {plan.unsupervised}; {accepts}")
        return plan

    def _downloads(self, config: NodeConfig, node: Node, od: ObjectDictionary) -> tuple[tuple[int, int, bytes], ...]:
        """Return the SDO downloads of `configuration_file`, or without this key the ParameterValues of a DCF."""
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


def _require_mapping(nodes: Node) -> None:
    if nodes.kind in ("sequence", "scalar"):
        nodes.error("expected a mapping; write each node as `NAME:`, without a dash, and its keys below it")


def _decimal_hint(place: Node, od: ObjectDictionary) -> str:
    """Return a hint for an index without 0x, such as 6041: as a decimal it is 0x1799, and only 0x6041 exists."""
    index = place.get("index")
    if index is None or not re.fullmatch(r"[1-9]\d{3}", index.text) or int(index.text) in od.objects:
        return ""
    return f"; write 0x{index.text}, since {index.text} is decimal" if int(index.text, 16) in od.objects else ""


def _warn_of_empty(root: Node) -> None:
    """Warn about keys without a value, which dcfgen refuses; keys with an error are omitted."""
    wrong = tuple(error.where for error in root.problems.errors)
    sections = [section for name, section in root.items() if name != "nodes" and not name.startswith(".")]
    nodes = root.get("nodes")
    open_nodes = sections + [node for _, node in (() if nodes is None else nodes.items())]
    while open_nodes:
        node = open_nodes.pop()
        open_nodes += [*node.elements(), *(value for _, value in node.items())]
        for key, value in node.pairs():
            if value.kind == "null" and key.text != "value" and not key.where.startswith(wrong or "/"):
                key.warning("no value, so the default applies; give a value, or remove the key")


def _with_misspelt_sections(root: Node) -> Node:
    """Return the file with misspelt sections under the right names too, so that their keys are not missing."""
    missing = [name for name in _SECTIONS if root.get(name) is None]
    if "nodes" in missing:
        return root
    pairs = {key.text: (key, value) for key, value in root.pairs()}
    for name, pair in list(pairs.items()):
        misspelt = name not in _SECTIONS and name not in MISNAMED_ROOT and not name.startswith(".")
        if misspelt and pair[1].kind == "mapping" and (meant := closest(name, missing)):
            pairs.setdefault(meant, pair)
    return Node.mapping(Node("mapping", root.line, root.column, root.where, root.problems), pairs)


def _own_cob_ids(kind: str, node: Node, numbers: Sequence[int]) -> str:
    """Return how a node gets COB-IDs of its own for its PDOs of a kind.

    Many EDS files have the COB-IDs of one node-ID instead of `$NODEID+0x180` (CiA 306-1). All PDOs in use are listed,
    because listing one switches the others off.
    """
    if any((section := node.get(kind)) is not None and section.get(str(number)) is not None for number in numbers):
        return "; write another cob_id, or `cob_id: auto`"
    listed = ", ".join(f"{number}: {{cob_id: auto}}" for number in numbers)
    return f"; COB-IDs that follow the node-ID: `{kind}: {{{listed}}}` under {node.where.rpartition('.')[2]}"


_UNKNOWN_REACTION: Final = (
    "it monitors the master, but its EDS has neither 0x6007 nor 0x1029:01, so it is unknown whether it stops when the "
    "master is lost; test it: disconnect its CAN cable while it turns slowly"
)


def _place(node: Node, key: str) -> Node:
    """Return the YAML node of a dotted key such as `rpdo.1.mapping` or `sdo[3]`, or of the nearest parent key."""
    place = node
    for part in key.replace("[", ".").replace("]", "").split("."):
        if part.isdigit() and (elements := place.elements()):
            element: Node | None = elements[int(part)] if int(part) < len(elements) else None
        else:
            element = place.get(part)
        if element is None:
            break
        place = element
    return place


def _named(config: NodeConfig, place: Node, text: str) -> str:
    """Prefix a message with the name of the node, unless the place in the file already names the node."""
    return text if "." in place.where else f"{config.name}: {text}"


def is_supervised(bus: BusConfig, name: str) -> bool:
    """Whether the loss of the NMT master stops the axes of a node; True for a node without axes."""
    return not bus.plans[name].unsupervised
