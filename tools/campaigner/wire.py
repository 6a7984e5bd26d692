"""The contents of a robot's frames and its time limits, read from bus.yml independently of the master's own reader.

Only what a campaign needs: the mappings of RPDOs and TPDOs on their predefined identifiers, the scales, and the times
after which somebody has to notice that somebody else is gone.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import yaml

if TYPE_CHECKING:
    from pathlib import Path


CONTROLWORD: Final = 0x6040
STATUSWORD: Final = 0x6041
VELOCITY: Final = 0x606C
TARGET_VELOCITY: Final = 0x60FF
#: times specified by CiA 402
_FORMATS: Final = {
    0x6040: "<H", 0x6041: "<H", 0x6060: "<b", 0x6061: "<b", 0x6064: "<i", 0x606C: "<i", 0x6071: "<h", 0x6077: "<h",
    0x607A: "<i", 0x60FF: "<i",
}  # fmt: skip
_PROFILE_DECELERATION, _QUICK_STOP_DECELERATION = 0x6084, 0x6085


@dataclass(frozen=True, slots=True)
class Field:
    """The position of an object in a frame."""

    node_id: int
    index: int
    offset: int
    form: str

    def value(self, data: bytes) -> int | None:
        """Return its value, or None if the frame is too short."""
        if len(data) < self.offset + struct.calcsize(self.form):
            return None
        return int(struct.unpack_from(self.form, data, self.offset)[0])


@dataclass(frozen=True, slots=True)
class Limits:
    """Times in seconds in which a death or a lost signal must be detected according to bus.yml."""

    sync: float  # one cycle
    heartbeat: float  # between two heartbeats; a changed state is known after this time
    consumer: float  # 0x1016: without a heartbeat for this time the producer counts as lost
    feedback: float  # feedback is stale after this number of SYNCs


@dataclass(frozen=True, slots=True)
class Wire:
    """A bus: `fields` by identifier, `nodes` {node-ID: name}, `scales` {node-ID: device units per rad/s}.

    `decelerations` {node-ID: device units/s^2}, the gentler of ramp and quick stop.
    """

    fields: dict[int, tuple[Field, ...]]
    nodes: dict[int, str]
    scales: dict[int, float]
    decelerations: dict[int, float]
    limits: Limits
    master: int

    def ramp(self, speed: float) -> float:
        """Return how many seconds the slowest drive needs from `speed` (rad/s) to standstill."""
        return max(abs(speed * self.scales[node]) / self.decelerations[node] for node in self.nodes)

    def values(self, identifier: int, data: bytes) -> list[tuple[int, int, int]]:
        """Return the values in a frame: node-ID, object, value."""
        found = []
        for field in self.fields.get(identifier, ()):
            value = field.value(data)
            if value is not None:
                found.append((field.node_id, field.index, value))
        return found


def read_wire(path: Path) -> Wire:
    """Read a bus.yml whose drives are all commanded by velocity."""
    tree = yaml.safe_load(path.read_text())
    master, defaults = tree["master"], tree.get("defaults", {})
    nodes = {int(node["node_id"]): (name, {**defaults, **node}) for name, node in tree["nodes"].items()}
    fields: dict[int, tuple[Field, ...]] = {}
    for node_id, (_, keys) in nodes.items():
        fields.update(_pdos(node_id, keys.get("rpdo", {}), 0x100))
        fields.update(_pdos(node_id, keys.get("tpdo", {}), 0x80))
    return Wire(
        fields,
        {node_id: name for node_id, (name, _) in nodes.items()},
        {node_id: abs(float(keys["scale_vel_to_dev"])) for node_id, (_, keys) in nodes.items()},
        {node_id: _deceleration(keys) for node_id, (_, keys) in nodes.items()},
        _limits(master, [keys for _, keys in nodes.values()]),
        int(master["node_id"]),
    )


def _limits(master: dict[str, Any], nodes: list[dict[str, Any]]) -> Limits:
    sync = int(master["sync_period"]) / 1e6
    beat = max(int(node["heartbeat_producer"]) for node in (master, *nodes)) / 1e3
    multiplier = max(float(node.get("heartbeat_multiplier", 3)) for node in nodes)
    return Limits(sync, beat, beat * multiplier, sync * max(int(node.get("missed_syncs", 3)) for node in nodes))


def _deceleration(keys: dict[str, Any]) -> float:
    written = {int(key["index"]): float(key["value"]) for key in keys.get("sdo", ())}
    return min(written[index] for index in (_PROFILE_DECELERATION, _QUICK_STOP_DECELERATION) if index in written)


def _pdos(node_id: int, pdos: dict[Any, dict[str, Any]], base: int) -> dict[int, tuple[Field, ...]]:
    found = {}
    for number, pdo in pdos.items():
        if not pdo.get("enabled", False):
            continue
        given = pdo.get("cob_id", "auto")
        identifier = base + 0x100 * int(number) + node_id if given == "auto" else int(given) & 0x7FF
        fields, offset = [], 0
        for entry in pdo["mapping"]:
            form = _FORMATS[int(entry["index"])]
            fields.append(Field(node_id, int(entry["index"]), offset, form))
            offset += struct.calcsize(form)
        found[identifier] = tuple(fields)
    return found
