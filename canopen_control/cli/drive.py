"""`drive`: run virtual drives, any device that has an EDS, until Ctrl-C."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    import argparse

__all__ = ["EXAMPLE", "add_arguments", "parse_node_ids", "run"]

EXAMPLE = "canopen-control drive --node-id 3 --eds TMCM-1270.eds --can local:robby --fault heartbeat_lost@5s"

_RANGE = re.compile(r"(\d+)(?:-(\d+))?")
_LAST_NODE_ID = 127


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--node-id", required=True, metavar="N[,N|-N]", help="1 to 127; several as 2,3 or 1-64, in one process"
    )
    parser.add_argument("--eds", required=True, metavar="FILE", help="a path, or the name of a bundled file")
    parser.add_argument("--can", required=True, metavar="CHANNEL", help="local:NAME, vcan0, can0, ...")
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="F[@T]",
        help="switch a fault on, at the start or T seconds after it (repeatable)",
    )


def run(args: argparse.Namespace) -> int:
    """Run the drives; 0 after SIGINT or SIGTERM, 1 when the bus is gone."""
    from canopen_control.virtual.launch import run_drives

    return run_drives(parse_node_ids(args.node_id), _eds(args.eds), args.can, args.fault, _say)


def parse_node_ids(text: str) -> list[int]:
    """Return the node ids of ``3``, ``2,3`` or ``1-64``; ConfigError with what to write instead."""
    node_ids: list[int] = []
    for part in text.split(","):
        match = _RANGE.fullmatch(part.strip())
        if match is None:
            raise ConfigError(f"--node-id {text!r}: write 3, or 2,3, or 1-64")
        first, last = int(match[1]), int(match[2] or match[1])
        if not 1 <= first <= last <= _LAST_NODE_ID:
            raise ConfigError(f"--node-id {text!r}: node ids are 1 to {_LAST_NODE_ID}, rising")
        node_ids += range(first, last + 1)
    if len(set(node_ids)) != len(node_ids):
        raise ConfigError(f"--node-id {text!r}: a node id is named twice")
    return node_ids


def _eds(text: str) -> Path:
    path = Path(text)
    bundled = data_path("eds", text)
    return bundled if not path.exists() and path.name == text and bundled.exists() else path


def _say(line: str) -> None:
    print(line, flush=True)
