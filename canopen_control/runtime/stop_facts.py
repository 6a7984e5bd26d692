"""What a robot's files say of how its axes stop: supervision times, decelerations, option codes, greatest speeds.

An object has the value that bus.yml writes at the boot, else that of the DCF or EDS. The greatest speed is the smaller
of the joint's velocity limit and 0x607F. Both are for `stop_times`, which computes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.heartbeat import parse_consumer_entry
from canopen_control.cia402 import objects as o
from canopen_control.errors import CanopenError
from canopen_control.master.cycle import CYCLIC_SYNCHRONOUS
from canopen_control.master.plan import CONSUMER, GUARD_TIME, LIFE_TIME
from canopen_control.runtime.cyclic_axes import axis_number, node_of
from canopen_control.runtime.stop_times import AxisFacts

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.controllers.manager import ControllerManager
    from canopen_control.master.config import BusConfig
    from canopen_control.master.keys import NodeConfig
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.urdf.ros2_control import ControlJoint

__all__ = ["axis_facts", "command_lives"]

_ASKED: Final = (
    o.PROFILE_DECELERATION,
    o.QUICK_STOP_DECELERATION,
    o.ABORT_CONNECTION_OPTION,
    o.QUICK_STOP_OPTION,
    o.FAULT_REACTION_OPTION,
)
_UNLIMITED: Final = 0x7FFFFFFF


def axis_facts(setup: RobotSetup, lives: Mapping[str, Mapping[str, float]] | None = None) -> list[AxisFacts]:
    """Return the facts of each joint with a drive; `lives` are those of commands, by joint and controller, in s."""
    return [
        _facts(setup, config, joint, node, (lives or {}).get(joint.name, {}))
        for config in setup.buses.values()
        for tag in setup.description.hardware
        for joint in tag.joints
        if (node := node_of(config, joint)) is not None and config.plans[node.name].axes
    ]


def command_lives(manager: ControllerManager) -> dict[str, dict[str, float]]:
    """Return how long a command holds, by joint and loaded controller, in s; those without an end are left out."""
    found: dict[str, dict[str, float]] = {}
    for name in manager.states:
        controller = manager.get(name)
        try:
            interfaces = controller.command_interface_names()
        except CanopenError:
            continue
        if controller.life.limit_ns:
            for joint in {each.partition("/")[0] for each in interfaces}:
                found.setdefault(joint, {})[name] = controller.life.limit_ns / 1e9
    return found


def _facts(
    setup: RobotSetup, config: BusConfig, joint: ControlJoint, node: NodeConfig, lives: Mapping[str, float]
) -> AxisFacts:
    number, cycle_s = axis_number(joint), setup.cycle_ns / 1e9
    value = _Values(config, node.name)
    objects = {index: found for index in _ASKED if (found := value(o.axis_index(index, number))) is not None}
    limits = setup.description.joints[joint.name].limits if joint.name in setup.description.joints else None
    most = math.inf if limits is None else limits.velocity * abs(node.units.of_axis(number)["vel_to_dev"])
    profile = value(o.axis_index(o.MAX_PROFILE_VELOCITY, number))
    if profile and profile < _UNLIMITED:
        most = min(most, profile)
    _, consumer_ms = parse_consumer_entry(value(CONSUMER, 1) or 0)
    guarded_ms = (value(GUARD_TIME) or 0) * (value(LIFE_TIME) or 0)
    return AxisFacts(
        joint.name,
        node.name,
        node.node_id,
        most,
        cycle_s,
        silence_s=max(plan.supervision_ns for plan in config.plans.values()) / 1e9,
        data_s=max(_data_s(config, name, cycle_s) for name in config.plans),
        master_s=(consumer_ms or guarded_ms) / 1e3,
        axis=number,
        objects=objects,
        lives=lives,
    )


def _data_s(config: BusConfig, name: str, cycle_s: float) -> float:
    """Return after which time TPDOs that come with SYNC are missed; 0 where none does, or there is no SYNC."""
    if not config.master.sync_period:
        return 0.0
    every = [each.transmission_type for each in config.plans[name].tpdos]
    missed = config.nodes[name].supervision.missed_syncs
    return max((missed * each * cycle_s for each in every if each in CYCLIC_SYNCHRONOUS), default=0.0)


class _Values:
    """The values of a node's objects after its boot."""

    def __init__(self, config: BusConfig, name: str) -> None:
        self._od = config.dictionaries[name]
        self._written = {(each.index, each.subindex): each.data for each in config.plans[name].writes}

    def __call__(self, index: int, subindex: int = 0) -> int | None:
        """Return a value, None where there is none."""
        data = self._written.get((index, subindex))
        if data is not None:
            return int.from_bytes(data, "little", signed=index & 0x7FF in _CODES)
        entry = self._od.get(index, subindex)
        return entry.value if entry is not None and isinstance(entry.value, int) else None


_CODES: Final = tuple(index & 0x7FF for index in _ASKED[2:])
