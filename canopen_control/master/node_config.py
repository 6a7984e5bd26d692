"""Reader of one node in bus.yml: merges `defaults`, converts the keys and checks their consistency."""

from __future__ import annotations

import difflib
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from canopen_control.cia402.modes import OperationMode, mode_name
from canopen_control.master.keys import (
    DRIVE_DRIVERS,
    MISNAMED_NODE,
    SCALES,
    UNUSED_NODE,
    BootKeys,
    FileOptions,
    MasterConfig,
    MotionKeys,
    NodeConfig,
    PdoConfig,
    PdoObjectKeys,
    SdoEntry,
    SupervisionKeys,
    UnitKeys,
    named_scale,
)
from canopen_control.profiles import object_of
from canopen_control.yamlfile.convert import convert, keys_of
from canopen_control.yamlfile.node import Node

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping


NAMED_SCALES: Final = ("counts_per_revolution", "gear_ratio", "reversed")  # keys that define the scales
_TRANSITIONS = range(17)  # of the CiA 402 state machine; 0 and 1 are automatic


def tolerated(
    section: Node, keys: Collection[str], unused: Mapping[str, str], misnamed: Mapping[str, str], driver: str = ""
) -> set[str]:
    """Report the unknown keys of a section; return the keys that the conversion must ignore.

    A key in `misnamed`, or similar to a known key with an effect that could be added, is an error. Any other unknown
    key is a warning: ros2_canopen ignores unknown keys, so that files with such keys are in use (`name` under
    `master:`, a gear ratio in addition to scales that include the gear). `driver` is the name of a user's own driver,
    which may read additional keys.
    """
    tolerated_keys = set(unused)
    for key, place in section.keys().items():
        if key in keys or key in unused:
            continue
        tolerated_keys.add(key)
        if suggestion := _suggestion(key, section, keys, misnamed):
            place.error(f"unknown key {key!r}; write {suggestion}")
        elif node_id_below(section, key) is not None:
            place.error(f"unknown key {key!r}: a node belongs at the margin or under `nodes:`; it is indented too far")
        elif driver:
            place.warning(f"key {key!r} has no effect here: it belongs to {driver}, which is not part of this package")
        elif (close := difflib.get_close_matches(key.lower(), [*keys, *unused], 1, 0.6)) and _addable(
            close[0], section, unused
        ):
            place.error(f"unknown key {key!r} (did you mean {close[0]!r}?)")
        else:
            near = difflib.get_close_matches(key.lower(), keys, 1, 0.8)  # the section has the key that is meant, too
            hint = f", or write {near[0]!r}" if near else ""
            place.warning(f"unknown key {key!r} has no effect, neither here nor in ros2_canopen; remove it{hint}")
    return tolerated_keys


def _addable(key: str, section: Node, unused: Collection[str]) -> bool:
    """Whether a key has an effect, and its section has neither the key nor one with the same purpose."""
    rivals = SCALES if key in NAMED_SCALES else ()
    return key not in unused and all(section.get(name) is None for name in (key, *rivals))


def node_id_below(section: Node, key: str) -> Node | None:
    """Return the `node_id` below a key of a section, which shows that the key is a node's name, or None."""
    below = section.get(key)
    return below.get("node_id") if below is not None else None


_SPELLING: Final = re.compile(r"`(\w+)`")
_PDO_KEY: Final = re.compile(r"(?i)([rt]pdo)_?(\d+)")
_MODES: Final = {1: "position", 7: "position", 8: "position", 2: "velocity", 3: "velocity", 9: "velocity"} | {
    4: "effort",
    10: "effort",
}


def _suggestion(key: str, section: Node, keys: Collection[str], misnamed: Mapping[str, str]) -> str:
    """Return the correct form of a misspelled or misplaced key, or "" if none is known."""
    if (pdo := _PDO_KEY.fullmatch(key)) and pdo[1].lower() in keys:
        return f"`{pdo[2]}:` under `{pdo[1].lower()}:`"
    suggestion, place = misnamed.get(key, ""), section.get(key)
    number = place.value if place is not None else None
    if "velocity_mode" in suggestion and type(number) is int and number in _MODES:
        return f"`{_MODES[number]}_mode: {number}` ({OperationMode(number).name})"
    return suggestion


def _respelled(section: Node) -> Node:
    """Return a section with misnamed keys corrected, so that an error is not reported twice."""
    pairs = {key.text: (key, value) for key, value in section.pairs()}
    for key, pair in list(pairs.items()):
        if (spelling := _SPELLING.fullmatch(MISNAMED_NODE.get(key, ""))) and spelling[1] not in pairs:
            pairs[spelling[1]] = pair
    for key in ("node_id", "dcf"):  # or the missing key would be reported too
        if key not in pairs and (written := difflib.get_close_matches(key, [name.lower() for name in pairs], 1, 0.75)):
            pairs[key] = next(pair for name, pair in pairs.items() if name.lower() == written[0])
    for kind in ("rpdo", "tpdo"):
        if kind not in pairs and (numbered := _numbered_pdos(pairs, kind)):
            place = next(iter(numbered.values()))[0]
            name = Node.scalar(_at(place, "scalar"), kind, kind, quoted=False)
            pairs[kind] = name, Node.mapping(_at(place, "mapping"), numbered)
    return Node.mapping(_at(section, "mapping"), pairs)


def _at(place: Node, kind: str) -> Node:
    return Node(kind, place.line, place.column, place.where, place.problems)


def _numbered_pdos(pairs: Mapping[str, tuple[Node, Node]], kind: str) -> dict[str, tuple[Node, Node]]:
    """Return the entries of the keys `tpdo1:`, `tpdo2:`, … (or `rpdo1:`, …) by PDO number."""
    numbered = {}
    for key, (place, value) in pairs.items():
        if (pdo := _PDO_KEY.fullmatch(key)) and pdo[1].lower() == kind:
            numbered[pdo[2]] = Node.scalar(_at(place, "scalar"), pdo[2], int(pdo[2]), quoted=False), value
    return numbered


def _require_modes(motion: MotionKeys, node: Node) -> None:
    """Report modes of operation that do not match the command interface of their key, and invalid target objects."""
    for kind in ("position", "velocity", "effort", "torque"):
        number, key = getattr(motion, f"{kind}_mode"), f"{kind}_mode"
        served = "effort" if kind == "torque" else kind
        target = None if kind == "torque" else motion.own_target(kind)
        _check_own_target(motion, node, kind, number)
        if number is None or _MODES.get(number) == served or (number < 0 and target is not None):
            continue
        place = node.get(key) or node
        fits = ", ".join(f"{mode} ({OperationMode(mode).name})" for mode, of in sorted(_MODES.items()) if of == served)
        if number < 0:
            problem = (
                f"{key}: {number} is a manufacturer-specific mode, whose target object is unknown; set "
                f"`{served}_target`, such as `{served}_target: {_TARGET_EXAMPLES[served]}`"
            )
            fits = f"or {fits}"
            place.error(f"{problem}, {fits}")
            continue
        problem = f"{key}: {mode_name(number)} does not support the {served} interface"
        place.error(f"{problem}; choose one of {fits}")


_TARGET_EXAMPLES: Final = {"position": "0x607A", "velocity": "0x60FF", "effort": "0x6071"}


def _check_own_target(motion: MotionKeys, node: Node, kind: str, number: int | None) -> None:
    """Report an invalid target object, or a target object without the mode that uses it."""
    key = f"{kind}_target"
    if kind == "torque" or (place := node.get(key)) is None:
        return
    if motion.own_target(kind) is None:
        place.error(f"{key} {place.text!r} is not an object; write 0x60FF, or 0x60F6:08 with a subindex")
    elif number is None and not (kind == "effort" and motion.torque_mode is not None):
        place.error(f"{key} needs {kind}_mode, the mode that uses it")


def with_defaults(name: str, node: Node, defaults: Node | None, *, peer_merge: bool) -> Node:
    """Merge `defaults` into a node, and warn about values that differ between the two methods of merging."""
    if defaults is None:
        return node
    own_first, defaults_first = node.merged_over(defaults), _peer_merged(node, defaults)
    for key, place in node.keys().items():
        if key in MISNAMED_NODE or (default := defaults.get(key)) is None or default.value == node.value:
            continue
        here, other = _plain(own_first, key), _plain(defaults_first, key)
        if here == other:
            continue
        if peer_merge:
            place.warning(f"{name} has {key}: {_brief(here)}, but --peer-merge uses {_brief(other)} from `defaults`")
        else:
            place.warning(
                f"the node's own {key} is used; ros2_canopen would use {_brief(other)} from `defaults` (--peer-merge)"
            )
    return defaults_first if peer_merge else own_first


def _peer_merged(node: Node, defaults: Node) -> Node:
    """Merge as ros2_canopen's generator does: keys of `defaults` replace the node's own keys."""
    if node.kind not in ("mapping", "null") or defaults.kind != "mapping":
        return node.merged_over(defaults)
    pairs = {key.text: (key, value) for key, value in [*node.pairs(), *defaults.pairs()]}
    return Node.mapping(Node("mapping", node.line, node.column, node.where, node.problems), pairs)


def _plain(node: Node, key: str) -> Any:  # noqa: ANN401 - any YAML value
    value = node.get(key)
    return None if value is None else value.value


def _brief(value: object) -> str:
    return "another" if isinstance(value, dict | list) else repr(value)


def _nest_pdo_keys(node: Node) -> Node:
    """Report PDO keys at the same indentation as the PDO numbers, and move them into the PDO with the last number."""
    keys = node.keys()  # also under the names that replace misspelled keys
    pairs = {name: (keys[name], value) for name, value in node.items()}
    for kind in ("rpdo", "tpdo"):
        section = node.get(kind)
        entries = {} if section is None else {key.text: (key, value) for key, value in section.pairs()}
        numbers = [key for key in entries if key.isdigit()]
        misplaced = {key: pair for key, pair in entries.items() if key in _PDO_KEYS}
        if section is None or not numbers or not misplaced:
            continue
        node.problems.discard_below(section.where)  # duplicate keys
        key = next(iter(misplaced.values()))[0]
        key.error(f"{key.text!r} belongs to a PDO: indent the keys of each PDO below its number, `{numbers[0]}:`")
        place, _ = entries[numbers[-1]]
        last = {numbers[-1]: (place, Node.mapping(_at(place, "mapping"), misplaced))}
        pairs[kind] = pairs[kind][0], Node.mapping(_at(section, "mapping"), last)
    return Node.mapping(_at(node, "mapping"), pairs)


_PDO_KEYS: Final = frozenset(keys_of(PdoConfig))
_MAPPING_KEYS: Final = tuple(keys_of(PdoObjectKeys))
_SDO_KEYS: Final = tuple(keys_of(SdoEntry))
_SYNONYMS: Final = frozenset(
    ("type", "data", "object", "objects", "timer", "id", "address", "mode", "active", "disabled", "disable", "state")
)
_REMARKS: Final = frozenset(("name", "comment", "note", "unit", "default_value", "length", "size"))
"""Keys that have no effect, whatever their value is."""


def _plain_lists(node: Node) -> Node:
    """Return a node whose `sdo`, `rpdo` and `tpdo` have the form that the conversion expects.

    Objects written as `0x6081: 1000`, and PDOs written as a list, are errors with the right form, but read so that no
    second error results. Keys that mean nothing are reported and left out, because dcfgen ignores them.
    """
    keys = node.keys()
    pairs = {name: (keys[name], value) for name, value in node.items()}
    if (section := node.get("sdo")) is not None and section.kind in ("sequence", "mapping"):
        entries = section.elements() if section.kind == "sequence" else [section]
        if section.kind == "mapping" and not _short_writes(section):
            section.error("expected a list, got a mapping; begin each object with a dash: `- {index: ...}`")
            entries = entries if section.get("index") is not None else []
        written = [write for entry in entries for write in _writes(entry)]
        pairs["sdo"] = pairs["sdo"][0], Node.sequence(_at(section, "sequence"), written)
    for kind in ("rpdo", "tpdo"):
        if (section := node.get(kind)) is not None and section.kind in ("sequence", "mapping"):
            numbered = _by_number(section) if section.kind == "sequence" else section.pairs()
            pdos = {key.text: (key, _plain_pdo(pdo)) for key, pdo in numbered}
            pairs[kind] = pairs[kind][0], Node.mapping(_at(section, "mapping"), pdos)
    return Node.mapping(_at(node, "mapping"), pairs)


def _writes(entry: Node) -> list[Node]:
    """Return the writes of an entry of `sdo`: itself, or one for each of its keys such as `0x6081`."""
    short = _short_writes(entry)
    if not short:
        is_whole = entry.get("index") is not None and entry.get("value") is not None
        return [_without_foreign(entry, _SDO_KEYS) if is_whole else entry]
    key, value = short[0]
    shown = value.text if value.kind == "scalar" else ""
    key.error(f"write each object as `- {{{_form(key.text)}, value: {shown or '...'}}}`")
    return [
        _entry(key, {"value": value if value.kind == "scalar" else _number(key, 0)})  # or it would be a second error
        for key, value in short
    ]


def _short_writes(entry: Node) -> list[tuple[Node, Node]]:
    """Return the keys of an entry that name an object, such as `0x6081`, with their values."""
    return [(key, value) for key, value in entry.pairs() if object_of(key.text) is not None]


def _number(place: Node, number: int) -> Node:
    return Node.scalar(_at(place, "scalar"), hex(number), number, quoted=False)


def _form(text: str) -> str:
    index, subindex, _ = object_of(text) or (0, 0, None)
    return f"index: 0x{index:04X}, sub_index: {subindex}"


def _entry(place: Node, more: dict[str, Node]) -> Node:
    """Return the entry of a list for the object that a text such as `0x6081:01` names."""
    index, subindex, _ = object_of(place.text) or (0, 0, None)
    values = {"index": _number(place, index), "sub_index": _number(place, subindex)}
    keys = {key: Node.scalar(_at(place, "scalar"), key, key, quoted=False) for key in (*values, *more)}
    return Node.mapping(_at(place, "mapping"), {key: (keys[key], value) for key, value in (values | more).items()})


def _by_number(section: Node) -> list[tuple[Node, Node]]:
    """Report PDOs that are written as a list, and return those with known keys, numbered."""
    section.error("expected the PDOs by number, got a list; write `1:`, `2:` ... instead of the dashes")
    numbered = []
    for number, pdo in enumerate(section.elements(), 1):
        known = {key.text: (key, value) for key, value in pdo.pairs() if key.text in _PDO_KEYS}
        name = Node.scalar(_at(section, "scalar"), str(number), number, quoted=False)
        numbered.append((name, Node.mapping(_at(pdo, "mapping"), known)))
    return numbered


def _plain_pdo(pdo: Node) -> Node:
    pdo = _without_foreign(pdo, _PDO_KEYS)
    mapping = pdo.get("mapping")
    if mapping is None or mapping.kind != "sequence":
        return pdo
    objects = [_plain_object(entry) for entry in mapping.elements()]
    pairs = {key.text: (key, value) for key, value in pdo.pairs()}
    pairs["mapping"] = pairs["mapping"][0], Node.sequence(_at(mapping, "sequence"), objects)
    return Node.mapping(_at(pdo, "mapping"), pairs)


def _plain_object(entry: Node) -> Node:
    """Return an object of a mapping; an object written as `0x6040` or `0x6040: 16` is an error with the right form."""
    short = [entry] if entry.kind == "scalar" else [key for key, _ in entry.pairs()]
    if short and object_of(short[0].text) is not None:
        entry.error(f"write each object as `- {{{_form(short[0].text)}}}`")
        return _entry(short[0], {})
    return _without_foreign(entry, _MAPPING_KEYS)


def _without_foreign(section: Node, known: Collection[str]) -> Node:
    """Warn about the keys of a section that cannot stand for a known key, and return the section without them."""
    if section.kind != "mapping":
        return section
    pairs = {key.text: (key, value) for key, value in section.pairs()}
    for name, (key, value) in list(pairs.items()):
        if name not in known and not _may_be_meant(name, value, known):
            key.warning(f"unknown key {name!r} has no effect, neither here nor in ros2_canopen; remove it")
            del pairs[name]
    return Node.mapping(_at(section, "mapping"), pairs)


def _may_be_meant(name: str, value: Node, known: Collection[str]) -> bool:
    """Whether a key may stand for a known one, so that it must not be left out.

    Its name resembles that of the known key, or its value is a number, a truth value, a list or a mapping.
    """
    name = name.lower()
    shortened = any(len(name) > 2 and key.startswith(name) for key in known)
    if shortened or name in _SYNONYMS or difflib.get_close_matches(name, known, 1, 0.6):
        return True
    return name not in _REMARKS and value.value is not None and not isinstance(value.value, str)


_DRIVERS: Final = tuple(name.lower() for name in (*DRIVE_DRIVERS, "402", "Proxy", "BasicDevice", "MasterDriver"))


def _foreign_driver(node: Node) -> str:
    """Return the `driver` of a node, with a warning, if ros2_canopen has no such driver, else ""."""
    place = node.get("driver")
    driver = "" if place is None or not isinstance(place.value, str) else place.value
    if place is None or not driver or any(name in driver.lower() for name in _DRIVERS):
        return ""
    place.warning(f"{driver} is not part of this package: the node is operated by its EDS alone, without this driver")
    return driver


def node_config(name: str, node: Node, master: MasterConfig, options: FileOptions) -> tuple[NodeConfig, Node] | None:
    """Convert and check the keys of a node; return them with the corrected section, or None if they are unusable."""
    ignored = tolerated(node, keys_of(NodeConfig), UNUSED_NODE, MISNAMED_NODE, _foreign_driver(node))
    node = _plain_lists(_nest_pdo_keys(_respelled(node)))
    keys: NodeConfig | None = convert(node, NodeConfig, None, ignored=ignored)
    if keys is None:
        return None
    for number in keys.motion.transition_timeouts_ms:
        if number not in _TRANSITIONS:
            place = node.get("transition_timeouts_ms") or node
            place.error(f"transition {number} does not exist; CiA 402 numbers the transitions 0 to {_TRANSITIONS[-1]}")
    _require_modes(keys.motion, node)
    _require_values(node)
    supervision = keys.supervision
    if supervision.retry_factor == 0 and supervision.guard_time and not supervision.life_time_factor:
        # CiA 301, 7.5.2.12: a life time factor of 0 disables guarding
        place = node.get("retry_factor") or node
        place.error("0 switches node guarding off, but guard_time is set; remove one of the two")
    config = replace(
        keys,
        supervision=_supervision(keys.supervision, master, options),
        units=_units(keys.units, node),
        motion=replace(keys.motion, effort_mode=_effort_mode(keys.motion, node)),
        name=name,
        line=node.line,
        required=_required(keys.boot, node),
    )
    return config, node


def _require_values(node: Node) -> None:
    """Warn about entries of `sdo` without a value, which dcfgen writes as 0."""
    section = node.get("sdo")
    for entry in [] if section is None else section.elements():
        value = entry.get("value")
        if entry.kind == "mapping" and (value is None or value.kind == "null"):
            (value or entry).warning("there is no value, so 0 is written; write `value: 0`, or the value that is meant")


def _supervision(keys: SupervisionKeys, master: MasterConfig, options: FileOptions) -> SupervisionKeys:
    return replace(
        keys,
        multiplier=keys.heartbeat_multiplier or master.heartbeat_multiplier or options.heartbeat_multiplier,
        life_factor=keys.life_time_factor or keys.retry_factor or options.retry_factor,
    )


def _required(keys: BootKeys, node: Node) -> bool:
    """Whether the robot waits for a node, as set by `required` or `mandatory`; by default if the node is booted."""
    place = node.get("required") or node
    if None not in (keys.required, keys.mandatory) and keys.required != keys.mandatory:
        place.error("`required` and `mandatory` mean the same and differ; keep one")
    if not keys.enabled and (keys.required or keys.mandatory):
        place.error("a node with `boot: false` is never started, so that the robot cannot wait for it")
    mandatory = keys.mandatory if keys.required is None else keys.required
    return keys.enabled if mandatory is None else mandatory


def _effort_mode(keys: MotionKeys, node: Node) -> int | None:
    if None not in (keys.effort_mode, keys.torque_mode) and keys.effort_mode != keys.torque_mode:
        (node.get("torque_mode") or node).error("`torque_mode` and `effort_mode` mean the same and differ; keep one")
    return keys.torque_mode if keys.effort_mode is None else keys.effort_mode


def _units(keys: UnitKeys, node: Node) -> UnitKeys:
    """Return the units of a node, with scales computed from counts_per_revolution, or as written and checked."""
    named = [key for key in NAMED_SCALES if node.get(key) is not None]
    scales = [key for key in SCALES if node.get(key) is not None]
    keys = replace(keys, given=frozenset(key for key in (*SCALES, "scale_eff_from_dev") if node.get(key) is not None))
    if not named:
        _check_scales(keys, node)
        return keys
    place = node.keys()[named[0]]
    if scales:
        place.error(f"{', '.join(named)} and {', '.join(scales)} define the same scales; keep one of the two")
    elif keys.counts_per_revolution is None:
        place.error(f"{named[0]} needs counts_per_revolution, the position counts of one turn of the motor")
    else:
        try:
            keys = keys.with_scale(named_scale(keys.counts_per_revolution, keys.gear_ratio, bool(keys.reversed)))
            _check_scales(keys, node)
        except ValueError as error:
            (node.get("gear_ratio") or node).error(str(error))
    return keys


def _check_scales(keys: UnitKeys, node: Node) -> None:
    """Report scales of an axis that are zero, of different signs, or whose two directions are not inverse."""
    section = node.get("channels")
    channels = section.elements() if section is not None and keys.channels else []
    own = {axis: channel for axis, channel in enumerate(channels) if {*SCALES} & {*channel.keys()}}
    inherited = not channels or len(own) < len(channels)  # some axis has the scales of the node
    if inherited and not _are_usable({key: getattr(keys, key) for key in SCALES}, node, node):
        return
    usable = True
    for axis, channel in own.items():
        values = keys.of_axis(axis)
        usable &= _are_usable({key: values[key.removeprefix("scale_")] for key in SCALES}, node, channel)
    if usable:
        _check_offsets(keys, node)


def _are_usable(scales: Mapping[str, float], node: Node, section: Node) -> bool:
    """Report wrong scales of an axis, from its section or else from the node; return False after an error."""

    def written(key: str) -> Node | None:
        return section.get(key) or node.get(key)

    wrong = [key for key in SCALES if not 1e-15 < abs(scales[key]) < 1e15]
    for key in wrong:
        (written(key) or node).error(
            f"{scales[key]!r} cannot be used: expected a number between 1e-15 and 1e15, or its negative"
        )
    empty = [value for key in SCALES if (value := section.get(key)) is not None and value.kind == "null"]
    for value in empty:
        value.error("there is no value, and a default would not fit the drive; give a number, or remove the key")
    if wrong or empty:
        return False
    negative = [key for key, scale in scales.items() if scale < 0]
    if negative and len(negative) < len(SCALES):
        (written(negative[0]) or node).error(
            f"only {', '.join(negative)} is negative, but position and velocity must have the same direction; "
            "give all four scales the same sign, or the drive runs away from its set-point"
        )
        return False
    for name in ("pos", "vel"):
        place = written(f"scale_{name}_to_dev") or written(f"scale_{name}_from_dev")
        product = scales[f"scale_{name}_to_dev"] * scales[f"scale_{name}_from_dev"]
        if place is not None and abs(product - 1) > 0.01:
            place.warning(
                f"scale_{name}_to_dev times scale_{name}_from_dev is {product:.6g}, not 1: "
                "command and feedback would differ"
            )
    return True


def _check_offsets(keys: UnitKeys, node: Node) -> None:
    """Report offsets of commands and feedback that do not cancel."""
    # https://github.com/ros-industrial/ros2_canopen/pull/335: a joint whose absolute encoder has another zero
    offset = node.get("offset_pos_to_dev") or node.get("offset_pos_from_dev")
    rest = keys.offset_pos_to_dev * keys.scale_pos_from_dev + keys.offset_pos_from_dev
    if offset is not None and abs(rest) > max(_SAME_PLACE, _SAME_SHARE * abs(keys.offset_pos_from_dev)):
        offset.warning(
            f"offset_pos_to_dev and offset_pos_from_dev do not cancel: a joint that reached its target would show a "
            f"position {rest:.6g} away from it; set offset_pos_from_dev: "
            f"{-keys.offset_pos_to_dev * keys.scale_pos_from_dev:.9g}"
        )


_SAME_PLACE: Final = 1e-3
"""Difference in rad or m up to which two offsets cancel; `_SAME_SHARE` is that of an offset that is rounded."""
_SAME_SHARE: Final = 0.01
