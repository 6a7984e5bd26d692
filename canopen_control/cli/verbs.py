"""The verbs of the command line: what each is for, and its parser; a verb's module is imported when it is used."""

from __future__ import annotations

import argparse
import importlib
import re
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["VERBS", "parser_of"]

XACRO = "xacro"  # where a verb's arguments hold NAME:=VALUE
_ARGUMENT = re.compile(r"[A-Za-z_]\w*:=")

VERBS = {
    "run": "boot a robot and run its controllers",
    "demo": "run a robot on virtual drives, with a live table and a short motion",
    "simulate": "a robot in virtual time, in one process: years of faults, the same for the same seed",
    "drive": "run virtual drives",
    "device": "run virtual I/O modules, encoders, sensors: any device with an EDS",
    "fault": "break a running virtual drive or device, and mend it; set its inputs",
    "world": "where a robot with physics really is; payload, pushes, blocked joints, grip",
    "bus": "channels: list, status, up, down, faults",
    "status": "what a running robot is doing",
    "monitor": "drives, joints, events and frames as live tables, with a STOP key",
    "command": "send a command to a controller, repeatedly",
    "calibrate": "wheel radii and track of a base, by squares driven both ways (UMBmark)",
    "twist": "send a velocity to a base controller, repeatedly",
    "trajectory": "play a trajectory of a file on an arm, end the one under way",
    "gripper": "move a gripper to a position, and wait until it is there",
    "teleop": "drive a base by keyboard",
    "stop": "ramp all wheels to zero and disable the drives",
    "shutdown": "stop, then end the runtime",
    "controller": "list, load, configure, activate, deactivate, switch, unload controllers",
    "axis": "enable, disable, halt, quick-stop or fault-reset drives",
    "sdo": "read and write objects of a node, transfer files",
    "backup": "the parameters of a node as a DCF file, with its identity",
    "diff": "compare the parameters of two nodes, two files, or one of each",
    "restore": "write the parameters of a DCF file into a node, and prove it",
    "clone": "give a replacement drive the parameters of another one",
    "firmware": "load a program into a node over CANopen (CiA 302-3)",
    "objects": "the object dictionary of a node: names, units, defaults, what it holds",
    "dump": "all that a node holds now, as table, CSV or DCF",
    "scope": "objects over time, with triggers: terminal, CSV, MCAP",
    "nmt": "start, stop or reset nodes",
    "preflight": "before the first run on real drives: look, jog slowly, try STOP",
    "jog": "turn one drive by hand, with its EDS alone: arrow keys, limits, a dead-man",
    "tune": "how a drive follows, what hangs on it, gains for its loops: step, Bode, identification",
    "init": "a new robot from EDS files, or from who is on a bus",
    "scan": "who is on a bus, which EDS fits, what bus.yml expects",
    "lss": "give node ids and bit rates to nodes",
    "check": "everything wrong with a robot's files, and what its buses carry",
    "plan": "what a boot writes into each node, and what differs on a live bus",
    "eds": "look into EDS and DCF files",
    "trace": "what is said on a bus, decoded by name: live or from a recording",
    "view": "the robot on a page of this computer: 3D, plots, drives, STOP",
    "report": "one page of what went wrong: of the last fault, a recording, or a robot that runs",
    "record": "write every frame of a bus to a file",
    "replay": "play a recording into a bus, or tell what is in it",
    "export": "the PDO layout as DBC, a recording as CSV",
    "ros": "topics and services of ROS 2 without ros2cli; the bridge by hand",
    "bench": "how fast this is here, beside its peers in the same run",
    "completion": "completion of verbs, options and names in bash, zsh and fish",
}


def parser_of(verb: str) -> argparse.ArgumentParser:
    """Return the parser of one of VERBS; its module is imported for that."""
    module = importlib.import_module(f"canopen_control.cli.{verb}")
    parser = _VerbParser(
        prog=f"canopen-control {verb}",
        description=(module.__doc__ or "").strip(),
        epilog=f"example: {module.EXAMPLE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    _give_examples(parser, module.EXAMPLE.splitlines())
    return parser


class _VerbParser(argparse.ArgumentParser):
    """The parser of a verb; NAME:=VALUE is for the description wherever it stands, where the verb takes that.

    argparse itself takes words without an option in one place only, so that none could follow an option.
    """

    def parse_known_args(  # type: ignore[override]  # of its three signatures, the one that is called
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse, and put such words under `xacro`; what follows --ros-args is ROS's."""
        words = list(sys.argv[1:] if args is None else args)
        if not any(action.dest == XACRO for action in self._actions):
            return super().parse_known_args(words, namespace)
        end = words.index("--ros-args") if "--ros-args" in words else len(words)
        given = [word for word in words[:end] if _ARGUMENT.match(word)]
        rest = [word for word in words[:end] if not _ARGUMENT.match(word)]
        found, unknown = super().parse_known_args([*rest, *words[end:]], namespace)
        setattr(found, XACRO, [*getattr(found, XACRO), *given])
        return found, unknown


def _give_examples(parser: argparse.ArgumentParser, examples: Sequence[str]) -> None:
    """Show the examples of an action in the help of that action too."""
    for group in (each for each in parser._actions if isinstance(each, argparse._SubParsersAction)):  # noqa: SLF001 - no public way
        for action in group.choices.values():
            own = [line.strip() for line in examples if line.strip().startswith(f"{action.prog} ")]
            if own:
                action.epilog = "example: " + "\n         ".join(own)
                action.formatter_class = argparse.RawDescriptionHelpFormatter
            _give_examples(action, examples)
