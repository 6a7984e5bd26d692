"""Generate reference pages from tables in the code, so that they cannot get out of date.

Type, default and bounds of a key, the faults, the verbs and the import table are the code's; what a key means is said
in `words.py`, what a parameter of a controller means in `canopen_control.controllers.declared`.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import re
import typing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from protocol import drive_socket, hub_socket, robot_socket
from words import BUS_YML

from canopen_control.yamlfile.convert import fields_of, help_of, key_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from enum import Enum

ROOT = Path(__file__).parents[1]


def write_pages(folder: Path) -> None:
    """Write every generated page to `folder`; unchanged files are not rewritten."""
    folder.mkdir(exist_ok=True)
    for name, make in PAGES.items():
        path, text = folder / name, make()
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def _table(head: str, rows: Iterator[str] | list[str]) -> str:
    columns = head.count("|") - 1
    return "\n".join([head, "|" + "---|" * columns, *rows]) + "\n"


# -- bus.yml and the controllers' parameters: dataclasses with bounds


def _shown(value: object) -> str:
    """Return a default as it is written in YAML."""
    if value is None or value is dataclasses.MISSING or value in ((), [], {}, ""):
        return ""
    if dataclasses.is_dataclass(value) or value != value:  # a section; not a number: no value
        return ""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f"`{list(value) if isinstance(value, tuple) else value}`"


def _default(field: dataclasses.Field[Any]) -> str:
    if field.default_factory is not dataclasses.MISSING:
        return _shown(field.default_factory())
    low, _ = field.metadata.get("range") or (None, None)
    default = field.default
    out_of_bounds = low is not None and isinstance(default, int | float) and default < low
    return "required" if default is dataclasses.MISSING or out_of_bounds else _shown(default)


_TYPES = {
    r"tuple\[str, \.\.\.\]": "list of names",
    r"list\[str\]": "list of names",
    r"list\[int\]": "list of integers",
    r"list\[(\w+)\]": r"list of \1",
    r"dict\[int, int\]": "number: number",
    r"dict\[str, (.+)\]": r"by name: \1",
    r"dict\[int, (\w+)\]": r"number: \1",
    r"\bSix\b": "six numbers",
    r"\bstr\b": "text",
    r"\bint\b": "integer",
    r"\bfloat\b": "number",
    r"\bbool\b": "true, false",
    r"\bAny\b": "anything",
    r"Literal\[(.*?)\]": r"\1",
    r" \| None\b": "",
    r" \| ": ", ",
}
_PARTS = {
    "PdoConfig": "a [PDO](#one-pdo)",
    "SdoEntry": "[objects](#an-object-of-sdo)",
    "SignalKeys": "[signals](#a-signal)",
    "PdoObjectKeys": "[objects](#a-mapped-object)",
    "AxisUnitKeys": "[units](#the-units-of-one-axis)",
}


def _type(field: dataclasses.Field[Any]) -> str:
    text = str(field.type)
    for pattern, word in _TYPES.items():
        text = re.sub(pattern, word, text)
    for name, link in _PARTS.items():
        text = text.replace(name, link)
    choices, bounds = field.metadata.get("choices"), field.metadata.get("range")
    if choices and len(choices) < 20:
        return f"{text}: {', '.join(map(str, choices))}"
    if bounds:
        low, high = (None if each is None else f"{each:g}" if abs(each) < 1e6 else f"{each:,.0f}" for each in bounds)
        return f"{text}, " + (f"{low} to {high}" if low and high else f"at least {low}" if low else f"at most {high}")
    return text


def parts_of(cls: type[Any]) -> list[type[Any]]:
    """Return the classes whose keys are merged into those of a dataclass."""
    hints = typing.get_type_hints(cls)
    return [hints[field.name] for field in dataclasses.fields(cls) if field.metadata.get("part")]


def own_entries(cls: type[Any]) -> Iterator[tuple[str, dataclasses.Field[Any]]]:
    """Yield each key of a dataclass itself, with its field."""
    for field in dataclasses.fields(cls):
        marks = ("part", "derived", "here") if "dict" in str(field.type) else ("part", "section", "derived", "here")
        if not any(field.metadata.get(mark) for mark in marks):
            yield field.metadata.get("key") or field.name, field


def entries(cls: type[Any]) -> Iterator[tuple[str, dataclasses.Field[Any]]]:
    """Yield each key of a dataclass and of its parts, with its field."""
    for each in (cls, *parts_of(cls)):
        yield from own_entries(each)


def _keys(cls: type[Any], words: Mapping[str, str], unused: Mapping[str, str]) -> str:
    """Return the key table of a dataclass, followed by a titled table per part."""
    rows = [
        f"| `{key}` | {_type(field)} | {_default(field)} | {words[key]} |"
        for key, field in own_entries(cls)
        if key not in unused
    ]
    text = _table("| key | value | default | meaning |", rows)
    for part in parts_of(cls):
        title = re.split(r"[;:.]", part.__doc__ or "")[0]
        text += f"\n### {title}\n\n{_keys(part, words, unused)}"
    return text


def bus_yml() -> str:
    """Return the page of the bus.yml keys."""
    from canopen_control.master import keys

    sections = (
        ("`options`", keys.FileOptions, {}),
        ("`master`", keys.MasterConfig, keys.UNUSED_MASTER),
        ("A node, and `defaults` of all", keys.NodeConfig, keys.UNUSED_NODE),
        ("One PDO", keys.PdoConfig, {}),
        ("A mapped object", keys.PdoObjectKeys, {}),
        ("An object of `sdo`", keys.SdoEntry, {}),
        ("The units of one axis", keys.AxisUnitKeys, {}),
        ("A signal", keys.SignalKeys, {}),
    )
    text = [
        "# The keys of `bus.yml`\n",
        "The format is that of ros2_canopen; the file is read at start-up. It has the sections `options`, `master`, "
        "`defaults` and `nodes`; nodes may also be at the top level, as in older files. A node's own keys override "
        "`defaults`. A robot folder may hold more buses in files `bus_NAME.yml`, all with one SYNC period. "
        "`canopen-control check ROBOT` reports every error with its line.\n",
    ]
    for title, cls, unused in sections:
        text += [f"## {title}\n", _keys(cls, BUS_YML[title], unused)]
    for title, unused in (("`master`", keys.UNUSED_MASTER), ("a node", keys.UNUSED_NODE)):
        text += [
            f"## Keys of {title} that have no effect\n",
            "Keys of ros2_canopen that are accepted; a warning lists them once.\n",
            _table("| key | why |", [f"| `{name}` | {why} |" for name, why in unused.items()]),
        ]
    return "\n".join(text)


def controllers() -> str:
    """Return the page of the controller parameters."""
    from canopen_control.controllers.base import Controller
    from canopen_control.controllers.controllers_file import ManagerParams
    from canopen_control.controllers.params import CommonParams
    from canopen_control.controllers.types import TYPES, class_of

    groups: dict[str, list[str]] = {}
    for name in TYPES:
        groups.setdefault((class_of(name) or Controller).title, []).append(name)
    text = [
        "# Controllers and their parameters\n",
        "Names, defaults and meanings are those of ros2_controllers. `ros2 param describe` also prints them.\n",
        "## The controller manager\n",
        _keys(ManagerParams, _parameters(ManagerParams), {}),
        "## Every controller\n",
        _keys(CommonParams, _parameters(CommonParams), {}),
    ]
    for title, names in groups.items():
        kind = class_of(names[0]) or Controller
        text += [f"## {title}\n", *(f"- `{name}`" for name in names), ""]
        text.append(_keys(kind.reads, _parameters(kind.reads), CommonParams.__annotations__))
        for heading, section in kind.sections.items():
            text += [f"### {heading}\n", _keys(section, _parameters(section), {})]
    return "\n".join(text)


def _parameters(cls: type[Any]) -> dict[str, str]:
    return {key_of(entry): text for entry, _ in fields_of(cls) if (text := help_of(cls, entry))}


# -- faults, verbs, layers


def faults() -> str:
    """Return the page of virtual drive faults and the reactions of a correct master."""
    from canopen_control.virtual.fault_table import FAULTS

    rows = [
        f"| `{each.name}` | {each.does}{' (once)' if each.once else ''} | {each.reaction} |" for each in FAULTS.values()
    ]
    return (
        "# Faults of virtual drives\n\n"
        "Switch a fault on with `canopen-control fault NODE NAME on`, from the start with `canopen-control drive "
        "--fault NAME`, or in a scenario. The tests inject each of them into a whole robot (`tests/faults`).\n\n"
        + _table("| fault | the drive | a correct master |", rows)
    )


def quirks() -> str:
    """Return the page of virtual drive quirks, with clauses and sources."""
    from canopen_control.virtual.quirks import QUIRKS

    rows = []
    for each in QUIRKS.values():
        shown = each.listing()
        bounds = "" if shown.default is None else f"{shown.low:g} to {shown.high:g} {shown.unit}, {shown.default:g}"
        where = "" if each.axis is not None else " (the node as a whole)"
        rows.append(f"| `{each.name}` | {each.does}{where} | {bounds} | {each.clause or 'no clause'} | {each.source} |")
    return (
        "# Quirks of virtual drives\n\n"
        "A quirk is a documented deviation of a healthy drive from CiA 301 or CiA 402-2; a malfunction is a "
        "[fault](faults.md). A drive has quirks from its start with `canopen-control drive --quirk "
        "NAME[=VALUE][@AXIS]`; `canopen-control quirk NODE NAME on` and the key `quirk` of a scenario switch one while "
        "it runs. The strength column lists bounds and default. `unsourced`: seen by users, but no public source is "
        "known.\n\n" + _table("| quirk | the drive | strength | departs from | source |", rows)
    )


def personalities() -> str:
    """Return the page of manufacturer-specific behaviour, from `eds/personalities`."""
    from canopen_control.personality import personality_names, read_personality
    from canopen_control.virtual.quirks import parse_quirk

    rows, keys, unknown = [], [], []
    for name in personality_names():
        drive = read_personality(name)
        called = f"`{name}`, {drive.title}"
        does = [parse_quirk(line.quirk).quirk.does for line in drive.quirks]
        rows += [
            f"| {called} | {each} | `{line.quirk}` | {line.source} |"
            for each, line in zip(does, drive.quirks, strict=True)
        ]
        keys += [f"| {called} | `{key.text}` | {key.why} | {key.source} |" for key in drive.bus_keys]
        ids = ", ".join(f"0x{each.vendor:X}" for each in drive.identity) or "not known"
        unknown.append(f"- {called} (vendor id: {ids}): {'; '.join(drive.not_known)}.")
    return (
        "# Manufacturer-specific behaviour\n\n"
        "From the files of `eds/personalities`; [the guide](../guide/drive_makers.md) explains how to use them.\n\n"
        + _table("| drive | behaviour | quirk | source |", rows)
        + "\n## Required keys of bus.yml\n\n"
        + _table("| drive | key | reason | source |", keys)
        + "\n## Unknown\n\n"
        + "\n".join(unknown)
        + "\n"
    )


def command_line() -> str:
    """Return the page with the help of every verb."""
    import importlib
    import os

    from canopen_control.cli.support.parsers import parser_of
    from canopen_control.cli.verbs import VERBS

    os.environ["COLUMNS"] = "110"
    text = [
        "# The command line\n",
        "`canopen-control VERB --help` prints the same. Exit codes: 0 success, 1 failure, 2 wrong usage, wrong "
        "configuration, or a missing dependency.\n",
        _table("| verb | |", [f"| [`{verb}`](#{verb}) | {what} |" for verb, what in VERBS.items()]),
    ]
    for verb in VERBS:
        example = importlib.import_module(f"canopen_control.cli.{verb}").EXAMPLE
        parser = parser_of(verb)
        parser.epilog = None
        lines = [line.strip() for line in example.splitlines()]
        text += [f"## {verb}\n", "```text", _help(parser).rstrip(), "```\n", "```sh", *lines, "```\n"]
    return "\n".join(text)


def _help(parser: argparse.ArgumentParser) -> str:
    """Return the help of a verb and of its actions, if it has any."""
    text = parser.format_help()
    for action in parser._actions:  # noqa: SLF001 - argparse has no public way to them
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 - as above
            for each in dict.fromkeys(action.choices.values()):
                each.epilog = None
                text += "\n" + each.format_help()
    return text


def import_table() -> str:
    """Return the page of permitted imports, as checked by the layering test."""
    source = (ROOT / "tests" / "test_layering.py").read_text(encoding="utf-8")
    rows = []
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "MAY_IMPORT":
            assert isinstance(node.value, ast.Dict)
            for key, value in zip(node.value.keys, node.value.values, strict=True):
                assert isinstance(key, ast.Constant)
                assert isinstance(value, ast.Tuple)
                rows.append(f"| `{key.value}` | {_ours(value.elts[0])} | {_outside(value.elts[1])} |")
    head = "# Permitted imports\n\nThe layering test enforces this table. `errors` and `frame` are open to all.\n\n"
    return head + _table("| subpackage | may import | from outside |", rows)


def _ours(node: ast.expr) -> str:
    if isinstance(node, ast.Set):
        return ", ".join(f"`{each.value}`" for each in node.elts if isinstance(each, ast.Constant))
    return "everything" if isinstance(node, ast.Constant) else "-"


def _outside(node: ast.expr) -> str:
    text = ast.unparse(node)
    if text == "None":
        return "whatever it needs"
    words = {
        "PURE": "the standard library without I/O",
        "STDLIB": "the standard library",
        "MARKS": "mypy_extensions",
    }
    return ", ".join(words.get(part, part.strip("{}").replace("'", "`")) for part in text.split(" | "))


_AXIS_POWER = """# May an axis move? Its statechart

## Its power

Each joint is in one of these states. A trigger that a state does not list has no effect. The table is in
`canopen_control/hardware/axis_statechart.py`; `hardware/joint.py` fires the triggers of the drive and of users,
`hardware/axis_statechart.py` those of the joints that stop together.

If a stop takes longer than its state may last, a quick stop follows, then disable voltage. If the joint's description
has `<param name="holds_load">true</param>`, because its load would fall, the voltage stays on.
"""


_DRIVE_INTENT = """## Below it: the enable request of the drive

The chart commands the drive's state machine (`canopen_control/cia402/drive.py`) to enable, disable or stop. The
request, together with what is still on its way to the drive, is one of these states; the table is in
`canopen_control/cia402/drive.py`. Only an enable leads to the goal ENABLED. Two commands do not change the request:
`hold_in_switched_on` keeps a drive before OPERATION_ENABLED until its group can be enabled, `halt` sends bit 8 to an
enabled one.
"""

_MODE_REQUEST = """## Below it: the mode of operation

A mode is active only when 0x6061 shows it; nothing moves before. The table is in
`canopen_control/cia402/drive_goal.py`.
"""


def axis_power() -> str:
    """Return the page of the axis statecharts: power, enable request and mode."""
    from canopen_control.cia402 import drive_goal
    from canopen_control.cia402.drive_request import ENABLE_TABLE, GOALS, EnableRequest, EnableTrigger
    from canopen_control.hardware.axis_statechart import LIMITS_NS, TABLE, AxisPhase, PhaseTrigger

    lasts = {state: f"{limit / 1e9:g} s" for state, limit in LIMITS_NS.items()}
    lasts[AxisPhase.AWAITING_STANDSTILL] = "the rest of RAMPING_DOWN's time"
    commands = {
        (state, trigger): (row.state, "; ".join(command.value for command in row.commands))
        for state, rows in TABLE.items()
        for trigger, row in rows.items()
    }
    goals = {each: GOALS[each].name for each in EnableRequest}
    requests = {
        (state, trigger): (after, "" if goals[state] == goals[after] else goals[after])
        for state, rows in ENABLE_TABLE.items()
        for trigger, after in rows.items()
    }
    modes = {
        (state, trigger): (after, "yes" if after in drive_goal.CONFIRMED else "no")
        for state, rows in drive_goal.MODE_TABLE.items()
        for trigger, after in rows.items()
    }
    parts = [_AXIS_POWER, *_chart(AxisPhase, PhaseTrigger, commands, lasts, ("may last", "command to the drive"))]
    parts += [_DRIVE_INTENT, *_chart(EnableRequest, EnableTrigger, requests, goals, ("goal", "new goal"))]
    confirmed = {state: "yes" if state in drive_goal.CONFIRMED else "no" for state in drive_goal.ModeState}
    heads = ("confirmed", "confirmed then")
    parts += [_MODE_REQUEST, *_chart(drive_goal.ModeState, drive_goal.ModeTrigger, modes, confirmed, heads)]
    return "\n".join(parts)


def _chart(
    states: type[Enum],
    triggers: type[Enum],
    rows: Mapping[tuple[Enum, Enum], tuple[Enum, str]],
    facts: Mapping[Any, str],
    heads: tuple[str, str],
) -> Iterator[str]:
    """Yield a table of a chart's states, and a table of transitions for each state."""
    lines = [f"| {state.name} | {state.value} | {facts.get(state, '')} |" for state in states]
    yield "### States\n"
    yield _table(f"| state | means | {heads[0]} |", lines)
    yield "### Transitions\n"
    for state in states:
        lines = []
        for trigger in (each for each in triggers if (state, each) in rows):
            after, note = rows[state, trigger]
            then = "stays" if after is state else after.name
            lines.append(f"| {trigger.name} | {trigger.value} | {then} | {note} |")
        yield f"#### {state.name}\n"
        yield _table(f"| trigger | when | then | {heads[1]} |", lines)


PAGES: dict[str, Callable[[], str]] = {
    "bus_yml.md": bus_yml,
    "controllers.md": controllers,
    "faults.md": faults,
    "quirks.md": quirks,
    "personalities.md": personalities,
    "command_line.md": command_line,
    "robot_socket.md": robot_socket,
    "drive_socket.md": drive_socket,
    "hub_socket.md": hub_socket,
    "imports.md": import_table,
    "axis_power.md": axis_power,
}
