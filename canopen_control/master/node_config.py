"""One node of a bus.yml: `defaults` merged below it, its keys converted and checked against each other."""

from __future__ import annotations

import difflib
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from canopen_control.cia402.modes import OperationMode
from canopen_control.master.keys import (
    MISNAMED_NODE,
    SCALES,
    UNUSED_NODE,
    BootKeys,
    MasterConfig,
    MotionKeys,
    NodeConfig,
    Options,
    SupervisionKeys,
    UnitKeys,
    named_scale,
)
from canopen_control.yamlfile.convert import convert, keys_of
from canopen_control.yamlfile.node import Node

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

__all__ = ["node_config", "tolerated", "with_defaults"]

_TRANSITIONS = range(17)  # of the CiA 402 power state machine; 0 and 1 are the drive's own


def tolerated(
    section: Node, known: Collection[str], unused: Mapping[str, str], misnamed: Mapping[str, str]
) -> set[str]:
    """Judge the keys of a section that are not `known`; return those that the conversion is not to look at.

    A key that looks like a known one, or is listed in `misnamed`, is an error. Any other is a warning: ros2_canopen
    reads the keys it has and no others, so files with such keys are in use.
    """
    found = set(unused)
    for key, place in section.keys().items():
        if key in known or key in unused:
            continue
        found.add(key)
        if meant := _meant(key, section, known, misnamed):
            place.error(f"unknown key {key!r}; write {meant}")
        elif close := difflib.get_close_matches(key, [*known, *unused], 1, 0.6):
            place.error(f"unknown key {key!r}, did you mean {close[0]!r}?")
        else:
            place.warning(f"unknown key {key!r}: it has no effect, here as in ros2_canopen; remove it")
    return found


_PDO_KEY: Final = re.compile(r"(?i)([rt]pdo)_?(\d+)")
_MODES: Final = {1: "position", 7: "position", 8: "position", 2: "velocity", 3: "velocity", 9: "velocity"} | {
    4: "effort",
    10: "effort",
}


def _meant(key: str, section: Node, known: Collection[str], misnamed: Mapping[str, str]) -> str:
    """Return what is to be written in place of a key, "" where that is not known."""
    if (pdo := _PDO_KEY.fullmatch(key)) and pdo[1].lower() in known:
        return f"`{pdo[2]}:` under `{pdo[1].lower()}:`"
    meant, place = misnamed.get(key, ""), section.get(key)
    number = place.value if place is not None else None
    if "velocity_mode" in meant and type(number) is int and number in _MODES:
        return f"`{_MODES[number]}_mode: {number}` ({OperationMode(number).name})"
    return meant


def with_defaults(name: str, node: Node, defaults: Node | None, *, peer_merge: bool) -> Node:
    """Merge `defaults` below a node as asked for, and say where the other way would give another value."""
    if defaults is None:
        return node
    ours, theirs = node.over(defaults), _peer_merged(node, defaults)
    for key, place in node.keys().items():
        if (default := defaults.get(key)) is None or default.value == node.value:
            continue
        here, there = _plain(ours, key), _plain(theirs, key)
        if here == there:
            continue
        if peer_merge:
            place.warning(f"{name} has {key}: {_brief(here)}, but --peer-merge takes {_brief(there)} of `defaults`")
        else:
            place.warning(
                f"the node's own {key} counts; ros2_canopen takes {_brief(there)} of `defaults` (--peer-merge)"
            )
    return theirs if peer_merge else ours


def _peer_merged(node: Node, defaults: Node) -> Node:
    """Return the node with the keys of `defaults` in place of its own, as ros2_canopen's generator merges."""
    if node.kind not in ("mapping", "null") or defaults.kind != "mapping":
        return node.over(defaults)
    pairs = {key.text: (key, value) for key, value in [*node.pairs(), *defaults.pairs()]}
    return Node.mapping(Node("mapping", node.line, node.column, node.where, node.problems), pairs)


def _plain(node: Node, key: str) -> Any:  # noqa: ANN401 - what stands there
    value = node.get(key)
    return None if value is None else value.value


def _brief(value: object) -> str:
    return "another" if isinstance(value, dict | list) else repr(value)


def node_config(name: str, node: Node, master: MasterConfig, options: Options) -> NodeConfig | None:
    """Convert and check the keys of one node; None where they cannot be used."""
    ignored = tolerated(node, keys_of(NodeConfig), UNUSED_NODE, MISNAMED_NODE)
    keys: NodeConfig | None = convert(node, NodeConfig, None, ignored=ignored)
    if keys is None:
        return None
    for number in keys.motion.transition_timeouts_ms:
        if number not in _TRANSITIONS:
            place = node.get("transition_timeouts_ms") or node
            place.error(f"no transition {number}; CiA 402 numbers them 0 to {_TRANSITIONS[-1]}")
    return replace(
        keys,
        supervision=_supervision(keys.supervision, master, options),
        units=_units(keys.units, node),
        motion=replace(keys.motion, effort_mode=_effort_mode(keys.motion, node)),
        name=name,
        line=node.line,
        required=_required(keys.boot, node),
    )


def _supervision(keys: SupervisionKeys, master: MasterConfig, options: Options) -> SupervisionKeys:
    return replace(
        keys,
        multiplier=keys.heartbeat_multiplier or master.heartbeat_multiplier or options.heartbeat_multiplier,
        life_factor=keys.life_time_factor or keys.retry_factor or options.retry_factor,
    )


def _required(keys: BootKeys, node: Node) -> bool:
    """Whether the robot waits for the node: `required`, else `mandatory`, else whether it is booted at all."""
    place = node.get("required") or node
    if None not in (keys.required, keys.mandatory) and keys.required != keys.mandatory:
        place.error("`required` and `mandatory` mean the same and differ; keep one")
    if not keys.wanted and (keys.required or keys.mandatory):
        place.error("a node with `boot: false` is never started, so nothing can wait for it")
    wanted = keys.mandatory if keys.required is None else keys.required
    return keys.wanted if wanted is None else wanted


def _effort_mode(keys: MotionKeys, node: Node) -> int | None:
    if None not in (keys.effort_mode, keys.torque_mode) and keys.effort_mode != keys.torque_mode:
        (node.get("torque_mode") or node).error("`torque_mode` and `effort_mode` mean the same and differ; keep one")
    return keys.torque_mode if keys.effort_mode is None else keys.effort_mode


def _units(keys: UnitKeys, node: Node) -> UnitKeys:
    """Turn units by name into the scales; or check the scales as they are given."""
    named = [key for key in ("counts_per_revolution", "gear_ratio", "reversed") if node.get(key) is not None]
    scales = [key for key in SCALES if node.get(key) is not None]
    if not named:
        _check_scales(keys, node)
        return keys
    place = node.keys()[named[0]]
    if scales:
        place.error(f"{', '.join(named)} and {', '.join(scales)} say the same twice; keep one way")
    elif keys.counts_per_revolution is None:
        place.error(f"{named[0]} needs counts_per_revolution, the position counts of one turn of the motor")
    else:
        try:
            return keys.with_scale(named_scale(keys.counts_per_revolution, keys.gear_ratio, bool(keys.reversed)))
        except ValueError as error:
            (node.get("gear_ratio") or node).error(str(error))
    return keys


def _check_scales(keys: UnitKeys, node: Node) -> None:
    """Refuse scales that move nothing; warn where one way and back do not cancel: command and feedback would differ."""
    for key in SCALES:
        if not 1e-15 < abs(getattr(keys, key)) < 1e15:
            (node.get(key) or node).error(f"{key} {getattr(keys, key)!r} cannot be used: finite and not 0 is wanted")
            return
    for what in ("pos", "vel"):
        given = node.get(f"scale_{what}_to_dev") or node.get(f"scale_{what}_from_dev")
        product = getattr(keys, f"scale_{what}_to_dev") * getattr(keys, f"scale_{what}_from_dev")
        if given is not None and abs(product - 1) > 0.01:
            given.warning(
                f"scale_{what}_to_dev times scale_{what}_from_dev is {product:.6g}, not 1: "
                "what is commanded and what comes back would differ"
            )
