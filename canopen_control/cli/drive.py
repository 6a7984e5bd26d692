"""Run virtual drives, or any device that has an EDS, until Ctrl-C.

It prints one line when the drives are on the bus, then their events. --store FILE keeps what is stored through 0x1010
and LSS. --scenario is a YAML timeline of faults and quirks:

    steps:
      - {at: 5s, node: 3, fault: heartbeat_lost}
      - {at: 8s, node: 3, fault: heartbeat_lost, state: off}
      - {at: 500ms, node: 2, fault: silent, for: 2s}
      - {at: 9s, node: 3, quirk: brake_delay=0.5}
      - {at: 12s, node: 3, plant: {stalled: 1}}

--plant describes the simulated mechanics of the axes: motors with torque limit, inertia, friction, external torque and
backlash, and a base with two wheels on a floor. Each drive may also run in its own process:

    axes:
      "3": {kind: loaded, torque_limit: 800, inertia: 2.0, friction: 30, external: -50, backlash: 20}
    base: {left: 3, right: 2, wheel_radius: 0.1, wheel_separation: 0.4, counts_per_revolution: 51200,
           slip: 0.01, share: /tmp/robby.floor}
    encoders: {"5": {axis: "3", counts_per_revolution: 51200, gear: 10, share: /tmp/robby.shafts}}   # CiA 406 on axis 3
    seed: 1

--status shows running drives instead: their states, and how evenly the set-points of a cyclic mode arrive (missed and
doubled ones, ripple, phase of RPDO against SYNC); with --json as JSON, one drive a line. Devices other than drives use
the same verb, also available as `device`.

Exit codes: 0 after Ctrl-C or SIGTERM; 1 the bus is gone, the node-ID is taken, or no drive answers --status; 2 wrong
usage, or errors in files.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.channel import parse_channel
from canopen_control.cli.support.arguments import eds_path, whole
from canopen_control.cli.support.output import json_line
from canopen_control.client.drive_client import DriveClient
from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.drive import GetDriveState

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence

    from canopen_control.rpc.messages.drive import AxisState, DriveState, SetPointQuality, SignalState, Spread


# State of a running virtual drive as text: states, motion, faults and the quality of its set-points.


def state_lines(state: DriveState) -> Iterator[str]:
    """Yield the state of a virtual device as lines of text: the node, its axes and set-points, inputs and outputs."""
    errors = "".join(f", error 0x{code:04X}" for code in state.errors)
    faults = f"; active faults: {', '.join(state.faults)}" if state.faults else ""
    quirks = f"; quirks: {', '.join(state.quirks)}" if state.quirks else ""
    yield f"node {state.node_id}, {state.name}: {state.nmt_state}{errors}{faults}{quirks}"
    for axis in state.axes:
        yield _axis_line(axis)
        if axis.set_points is not None:
            yield from (f"    {line}" for line in quality_lines(axis.set_points))
    for output, word in ((False, "inputs"), (True, "outputs")):
        shown = [_signal(signal) for signal in state.signals if signal.output is output]
        if shown:
            yield f"  {word}: {', '.join(shown)}"


def _signal(signal: SignalState) -> str:
    return f"{signal.name} {signal.value:g}{f' {signal.unit}' if signal.unit else ''}"


def _axis_line(axis: AxisState) -> str:
    place = f"position {axis.position}, velocity {axis.velocity}"
    return f"  axis {axis.axis}: {axis.state}, {axis.mode}, {place}, torque {axis.plant.torque / 10:.0f} %"


def quality_lines(quality: SetPointQuality) -> Iterator[str]:
    """Yield lines about cyclic set-points: counts, ripple, and phase relative to SYNC."""
    yield (
        f"set-points: {quality.taken} taken, {quality.missed} missed, {quality.doubled} doubled, "
        f"{quality.overwritten} overwritten"
    )
    if quality.velocity is not None:
        yield f"velocity demand: {_spread(quality.velocity)}, ripple {_percent(quality.velocity_ripple)}"
    if quality.acceleration is not None:
        ripple = _percent(quality.acceleration_ripple)
        yield f"acceleration ripple: {quality.acceleration:.4g} units/s^2, in relation to the velocity {ripple}"
    if quality.phase_us is not None:
        yield f"RPDO after SYNC: {_spread(quality.phase_us)} us"


def _spread(spread: Spread) -> str:
    return f"{spread.mean:.6g} ({spread.min:.6g} to {spread.max:.6g})"


def _percent(ratio: float | None) -> str:
    return "-" if ratio is None else f"{100 * ratio:.1f} %"


EXAMPLE = """canopen-control drive --node-id 3 --eds TMCM-1270.eds --can local:robby --fault heartbeat_lost@5s
         canopen-control drive --node-id 3 --can local:robby --status"""

_RANGE = re.compile(r"(\d+)(?:-(\d+))?")
_WHOLE = re.compile(r"-?(0[xX][0-9A-Fa-f]+|[1-9]\d*|0)")
_NUMBERS = re.compile(r"[\d,\- ]+")
_LAST_NODE_ID = 127
_NO_NODE_ID = "255"
_FILES = ("store", "scenario", "plant")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--node-id",
        metavar="N[,N|-N]",
        help="node-IDs, 1 to 127; several as 2,3 or 1-64, in one process; 255: no node-ID until LSS assigns one",
    )
    parser.add_argument(
        "--eds",
        action="append",
        metavar="[N[,N]=]FILE",
        help="EDS of the drives: a path, or the name of a bundled file; needed to run drives; N=FILE applies "
        "to these nodes only (repeatable)",
    )
    parser.add_argument("--can", metavar="CHANNEL", help="channel of the drives: local:NAME, vcan0, can0, ...")
    parser.add_argument(
        "--buses",
        metavar="FILE",
        help="file that describes drives on several buses in one world, instead of all other options",
    )
    _add_behaviour(parser)
    parser.add_argument("--status", action="store_true", help="show the state of running drives, and end")
    parser.add_argument("--json", action="store_true", help="with --status: print JSON")


def _add_behaviour(parser: argparse.ArgumentParser) -> None:
    """Declare the options for the behaviour of the drives: faults, quirks, mechanics, stored parameters."""
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="F[@T]",
        help="inject a fault at the start, or T seconds later (repeatable)",
    )
    parser.add_argument(
        "--quirk",
        action="append",
        default=[],
        metavar="Q[=V][@AXIS]",
        help="deviate from the standard as a real drive does; canopen-control quirk list explains all quirks "
        "(repeatable)",
    )
    parser.add_argument(
        "--like",
        metavar="NAME|FILE",
        help="behave like the drives of a manufacturer: the name of a bundled personality, or your own file",
    )
    parser.add_argument("--scenario", metavar="FILE", help="file with a timeline of faults and quirks, see above")
    parser.add_argument(
        "--plant", metavar="FILE", help="simulated mechanics of the axes, see above (default: ideal axes)"
    )
    parser.add_argument(
        "--store", metavar="FILE", help="file for parameters stored through 0x1010 and LSS; created if missing"
    )
    parser.add_argument(
        "--object",
        action="append",
        default=[],
        metavar="[N[,N]=]OBJECT=V",
        help="value of an object in place of that of the EDS, as in 0x1018:03=0x00010002; N= applies to these nodes "
        "only (repeatable)",
    )
    parser.add_argument(
        "--serial",
        type=whole,
        metavar="N",
        help="serial number 0x1018:04 (default: the node-ID, or the process id without one)",
    )


def run(args: argparse.Namespace) -> int:
    """Run the drives, or print their state; return 0, or 1 if the bus was lost while the drives ran."""
    if args.buses is not None:
        return _run_buses(args)
    for name in ("node_id", "can"):
        if getattr(args, name) is None:
            raise ConfigError(
                f"drive needs --{name.replace('_', '-')}, as in: drive --node-id 3 --eds FILE --can local:a"
            )
    if args.status:
        return _print_status(args)
    if args.json:
        raise ConfigError("--json requires drive --status; running drives print their events as lines")
    if args.eds is None:
        raise ConfigError("drive needs --eds FILE, which describes the device; for a running drive add --status")
    from canopen_control.virtual.launch import DriveOptions, run_drives

    node_ids = parse_node_ids(args.node_id)
    eds, eds_files = _eds_files(args.eds, node_ids)
    files = {name: None if (text := getattr(args, name)) is None else Path(text) for name in _FILES}
    options = DriveOptions(
        faults=args.fault,
        quirks=args.quirk,
        like=args.like,
        serial=args.serial,
        others=eds_files,
        objects=_objects(args.object, node_ids),
        **files,
    )
    return run_drives(node_ids, eds, args.can, options, _print)


def _run_buses(args: argparse.Namespace) -> int:
    options = [name for name in ("node_id", "can", "eds", "status", "quirk", "object", *_FILES) if getattr(args, name)]
    if options:
        raise ConfigError(f"--buses FILE replaces all other options; omit --{options[0].replace('_', '-')}")
    from canopen_control.personality import read_personality
    from canopen_control.virtual.bus_group import run_group

    return run_group(Path(args.buses), _print, None if args.like is None else read_personality(args.like))


def _print_status(args: argparse.Namespace) -> int:
    channel = str(parse_channel(args.can))
    for node_id in parse_node_ids(args.node_id):
        with DriveClient.connect(channel, node_id) as client:
            state = client.ask(GetDriveState())
        _print(json_line(state) if args.json else "\n".join(state_lines(state)))
    return 0


def parse_node_ids(text: str) -> list[int]:
    """Return the node-IDs in a text such as ``3``, ``2,3`` or ``1-64``; raise ConfigError if the text is invalid."""
    if text.strip() == _NO_NODE_ID:
        return [int(_NO_NODE_ID)]
    node_ids: list[int] = []
    for part in text.split(","):
        match = _RANGE.fullmatch(part.strip())
        if match is None:
            raise ConfigError(f"--node-id {text!r}: write 3, or 2,3, or 1-64")
        first, last = int(match[1]), int(match[2] or match[1])
        if not 1 <= first <= last <= _LAST_NODE_ID:
            hint = f"; {_NO_NODE_ID} is only allowed alone: one process per drive" if _NO_NODE_ID in text else ""
            raise ConfigError(f"--node-id {text!r}: node-IDs are 1 to {_LAST_NODE_ID}, rising{hint}")
        node_ids += range(first, last + 1)
    if len(set(node_ids)) != len(node_ids):
        raise ConfigError(f"--node-id {text!r}: a node-ID is given twice")
    return node_ids


def _eds_files(texts: Sequence[str], node_ids: Sequence[int]) -> tuple[Path, dict[int, Path]]:
    """Return the common EDS file, and the EDS files of single nodes by node-ID.

    Raise ConfigError if one is missing or ambiguous.
    """
    common: list[Path] = []
    eds_files: dict[int, Path] = {}
    for text in texts:
        numbers, equals, file = text.partition("=")
        if not equals or _NUMBERS.fullmatch(numbers) is None:
            common.append(eds_path(text))
            continue
        for node_id in parse_node_ids(numbers):
            if node_id not in node_ids or eds_files.setdefault(node_id, eds_path(file)) != eds_path(file):
                why = "another file is given for it" if node_id in eds_files else "it is not in --node-id"
                raise ConfigError(f"--eds {text}: node {node_id}: {why}")
    missing = [node_id for node_id in node_ids if node_id not in eds_files]
    if len(common) > 1 or (missing and not common):
        problem = (
            f"no file for node {missing[0]}" if not common else f"{common[0]} and {common[1]} are both for all nodes"
        )
        raise ConfigError(
            f"--eds: {problem}; give --eds FILE once for all nodes, and --eds N=FILE for nodes with another file"
        )
    return (common or list(eds_files.values()))[0], eds_files


def _objects(texts: Sequence[str], node_ids: Sequence[int]) -> dict[int, dict[tuple[int, int], int]]:
    """Return the values of --object by node-ID and address; raise ConfigError if a text is invalid."""
    from canopen_control.profiles import object_of

    objects: dict[int, dict[tuple[int, int], int]] = {}
    for text in texts:
        *numbers, name, value = ("", *text.split("="))[-3:]
        place = object_of(name)
        if place is None or place[2] is not None or _WHOLE.fullmatch(value) is None or text.count("=") > 2:
            raise ConfigError(f"--object {text}: write an object and a number, as in 0x1018:04=17 or 3=0x1018:04=17")
        try:
            chosen = parse_node_ids(numbers[0]) if numbers[0] else node_ids
        except ConfigError:
            raise ConfigError(f"--object {text}: {numbers[0]!r} is not a node-ID; write 3, or 2,3, or 1-64") from None
        for node_id in chosen:
            if node_id not in node_ids:
                raise ConfigError(f"--object {text}: node {node_id} is not in --node-id; add it there, or correct it")
            objects.setdefault(node_id, {})[place[0], place[1]] = int(value, 0)
    return objects


def _print(line: str) -> None:
    print(line, flush=True)
