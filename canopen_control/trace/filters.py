"""Which decoded frames somebody wants to see.

Filters choose after decoding, never before: what is not shown still tells the decoder what the next frame means.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError
from canopen_control.frame import EXTENDED_FLAG, MAX_NODE_ID
from canopen_control.trace.decoder import SERVICES, Mark

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.trace.decoder import DecodedFrame
    from canopen_control.trace.network_description import NetworkDescription


_REPEATED = frozenset(("pdo", "hb", "sync", "time"))  # what is sent again and again; the others are events each time
_KNOWN = 4096  # identifiers whose last data are remembered
_ALIASES = {"heartbeat": "hb", "heartbeats": "hb", "guarding": "hb"}
_STANDARD = 0x7FF


@dataclass(slots=True)
class Filter:
    """What to show; empty means all.

    `changes` leaves out a repeated frame with the data of the one before, `events` everything that is no news.
    """

    nodes: frozenset[int] = frozenset()
    services: frozenset[str] = frozenset()
    ids: tuple[range, ...] = ()
    changes: bool = False
    events: bool = False
    _last: dict[int, bytes] = field(default_factory=dict)

    def wants(self, decoded: DecodedFrame) -> bool:
        """Whether to show the frame; a filter of changes remembers it."""
        if self.nodes and decoded.node_id not in self.nodes:
            return False
        if self.services and decoded.service not in self.services:
            return False
        if self.ids and not any(decoded.can_id & 0x9FFFFFFF in each for each in self.ids):
            return False
        if self.events and decoded.mark is Mark.PLAIN:
            return False
        return not (self.changes or self.events) or self._is_new(decoded)

    def _is_new(self, decoded: DecodedFrame) -> bool:
        if decoded.service not in _REPEATED:
            return True
        if self._last.get(decoded.can_id) == decoded.data:
            return False
        if len(self._last) < _KNOWN or decoded.can_id in self._last:
            self._last[decoded.can_id] = decoded.data
        return True


def parse_services(text: str) -> frozenset[str]:
    """Read ``pdo,sdo``; ValueError with the names there are."""
    names = {_ALIASES.get(part, part) for part in text.lower().replace(" ", "").split(",") if part}
    if unknown := sorted(names - set(SERVICES)):
        raise ValueError(f"no service {unknown[0]!r}; there are: {', '.join(SERVICES)}")
    return frozenset(names)


def parse_ids(text: str) -> range:
    """Read an identifier or a range of them, ``181`` or ``0x181`` or ``180-1FF``: always hexadecimal; ValueError."""
    first, _, last = text.partition("-")
    low, high = _identifier(first), _identifier(last or first)
    if high < low:
        raise ValueError(f"{text!r}: the last identifier is below the first")
    return range(low, high + 1)


def _identifier(text: str) -> int:
    try:
        value = int(text, 16)
    except ValueError:
        raise ValueError(f"{text!r}: an identifier is hexadecimal, as in 181 or 0x181") from None
    if not 0 <= value <= 0x1FFFFFFF:
        raise ValueError(f"{text!r}: identifiers are 0 to 1FFFFFFF")
    return value | EXTENDED_FLAG if value > _STANDARD or len(text.lower().removeprefix("0x")) > 3 else value


def node_ids_of(network: NetworkDescription, names: Iterable[str]) -> frozenset[int]:
    """Return the node ids that names or numbers mean; ConfigError with the names there are."""
    found = set()
    for name in names:
        by_name = next((node.node_id for node in network.nodes.values() if node.name == name), None)
        if by_name is None and name == "master":
            by_name = network.master_node_id
        found.add(_node_id(network, name) if by_name is None else by_name)
    return frozenset(found)


def _node_id(network: NetworkDescription, text: str) -> int:
    try:
        node_id = int(text, 0)
    except ValueError:
        node_id = 0
    if not 1 <= node_id <= MAX_NODE_ID:
        known = ", ".join(node.name for node in network.nodes.values() if node.name) or "none with a name"
        raise ConfigError(f"no node {text!r}; give a node id, 1 to 127, or a name: {known}")
    return node_id
