"""Describes a bus by EDS files alone: node ids and files, the PDOs as the files have them by default.

Nobody is asked who he is: that would be sending. So the files must say which node they describe: ``3=FILE``, a DCF that
has its node id, or one file for every node.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.trace.network_description import NetworkDescription, NodeDescription, pdos_by_default

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

__all__ = ["network_of_eds"]

_NODE_IDS = range(1, 128)
_SUFFIXES = (".eds", ".dcf")


def network_of_eds(channel: str, options: Iterable[str], find: Callable[[str], Path] = Path) -> NetworkDescription:
    """Return the description that options ``NODE=FILE``, ``FILE`` and ``FOLDER`` make; the more exact one wins.

    `find` turns a name into the path of a file. EdsError for a bad file, ConfigError for a folder that names no node.
    """
    everybody: dict[int, NodeDescription] = {}
    named: dict[int, NodeDescription] = {}
    for option in options:
        node, equals, file = option.partition("=")
        if equals and node.strip().isdecimal():
            described = _one(int(node), find(file), option)
            named[described.node_id] = described
        elif Path(option).expanduser().is_dir():
            named.update((each.node_id, each) for each in _folder(Path(option).expanduser()))
        else:
            everybody.update((each.node_id, each) for each in _all(find(option)))
    return NetworkDescription(channel=channel, nodes=everybody | named)


def _one(node_id: int, path: Path, option: str) -> NodeDescription:
    if node_id not in _NODE_IDS:
        raise ConfigError(f"--eds {option}: node ids are 1 to 127")
    od = read_eds(path, node_id).od
    return NodeDescription(path.stem, node_id, od, pdos_by_default(od), str(path))


def _all(path: Path) -> Iterator[NodeDescription]:
    """Describe every node by one file; without a name, since there may be several."""
    parsed = read_eds(path).od
    if parsed.node_id is not None:
        yield NodeDescription(path.stem, parsed.node_id, parsed, pdos_by_default(parsed), str(path))
        return
    for node_id in _NODE_IDS:
        od = parsed.for_node(node_id)
        yield NodeDescription("", node_id, od, pdos_by_default(od), str(path))


def _folder(folder: Path) -> Iterator[NodeDescription]:
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES and path.is_file())
    parsed = [(path, read_eds(path).od) for path in files]
    named = [(path, od) for path, od in parsed if od.node_id is not None]
    if not named:
        raise ConfigError(f"--eds {folder}: no file there says its node id; write --eds NODE=FILE for each")
    for path, od in named:
        yield NodeDescription(path.stem, od.node_id or 0, od, pdos_by_default(od), str(path))
