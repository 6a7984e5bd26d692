"""PDO layout of a bus as a message for trace, monitor, exports and the API method `layout`.

The layout is taken from the plans by which the nodes are booted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.cia301.sync import SYNC_COB_ID
from canopen_control.cia402 import objects
from canopen_control.cia402.units import Scale
from canopen_control.rpc.messages.layout import BusLayout, MappedEntry, NodeLayout
from canopen_control.rpc.messages.layout import PdoLayout as PdoMessage

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from canopen_control.cia301.pdo import MappedObject
    from canopen_control.master.config import BusConfig
    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedPdo
    from canopen_control.rpc.messages.layout import Direction


LinearAxes = frozenset[tuple[str, int]]
"""Node name and axis number of prismatic joints."""


class _Meaning(NamedTuple):
    """Scale of a raw number: the value is the number times `factor` plus `offset`, in `unit`."""

    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""


class _Quantity(NamedTuple):
    """Quantity of a CiA 402 object; `scale` is pos, vel or eff, `absolute` is set if the position offset applies."""

    scale: str
    commanded: bool = False
    absolute: bool = False


_QUANTITIES: Final = {
    0x6062: _Quantity("pos", absolute=True),  # position demand value
    objects.POSITION_ACTUAL: _Quantity("pos", absolute=True),
    0x60F4: _Quantity("pos"),  # following error actual value
    objects.TARGET_POSITION: _Quantity("pos", commanded=True, absolute=True),
    0x606B: _Quantity("vel"),  # velocity demand value
    objects.VELOCITY_ACTUAL: _Quantity("vel"),
    objects.TARGET_VELOCITY: _Quantity("vel", commanded=True),
    objects.TORQUE_ACTUAL: _Quantity("eff"),
}
_UNITS: Final = {"pos": ("rad", "m"), "vel": ("rad/s", "m/s"), "eff": ("Nm", "N")}  # revolute, prismatic joints


def layout_of(config: BusConfig, channel: str = "", linear: Collection[tuple[str, int]] | None = None) -> BusLayout:
    """Return the PDO layout of a bus; `channel` defaults to the channel in bus.yml.

    `linear` contains (node, axis) of each prismatic joint; with None, for unknown, scales and units are omitted.
    """
    master = config.master
    return BusLayout(
        channel or master.channel,
        master.baudrate * 1000,
        master.node_id,
        SYNC_COB_ID,
        master.sync_period,
        tuple(
            NodeLayout(name, plan.node_id, str(config.eds_paths[name].resolve()), tuple(_pdos(config, plan, linear)))
            for name, plan in config.plans.items()
        ),
    )


def _pdos(config: BusConfig, plan: NodePlan, linear: Collection[tuple[str, int]] | None) -> Iterator[PdoMessage]:
    yield from (_pdo(config, plan, "rpdo", layout, linear) for layout in plan.rpdos)
    yield from (_pdo(config, plan, "tpdo", layout, linear) for layout in plan.tpdos)


def _pdo(
    config: BusConfig,
    plan: NodePlan,
    direction: Direction,
    layout: PlannedPdo,
    linear: Collection[tuple[str, int]] | None,
) -> PdoMessage:
    objects = tuple(_objects(config, plan, layout, linear))
    return PdoMessage(layout.cob_id, direction, layout.number, layout.transmission_type, objects)


def _objects(
    config: BusConfig, plan: NodePlan, layout: PlannedPdo, linear: Collection[tuple[str, int]] | None
) -> Iterator[MappedEntry]:
    for mapped in layout.objects:
        name = plan.entry_names.get((mapped.index, mapped.subindex), "")
        parent = plan.object_names.get(mapped.index, "")
        full = name if not parent or parent == name or not name else f"{parent}: {name}"
        meaning = _Meaning() if linear is None else _signal(plan, mapped) or _of_axis(config, plan, mapped, linear)
        yield MappedEntry(mapped.index, mapped.subindex, mapped.bits, mapped.data_type.name, full, *meaning)


def _signal(plan: NodePlan, mapped: MappedObject) -> _Meaning | None:
    """Return the scale of a mapped object that is a signal; None if it is not, or if device objects determine it."""
    for signal in plan.signals.values():
        if signal.address == (mapped.index, mapped.subindex) and signal.bit is None and not signal.scales:
            same_type = signal.data_type in (None, mapped.data_type)
            return _Meaning(signal.factor, signal.offset, signal.unit) if same_type else None
    return None


def _of_axis(config: BusConfig, plan: NodePlan, mapped: MappedObject, linear: Collection[tuple[str, int]]) -> _Meaning:
    """Return the scale that bus.yml sets for a drive object, or the raw scale if it sets none."""
    base, axis = objects.axis_of(mapped.index)
    quantity = _QUANTITIES.get(base) if plan.axes and not mapped.subindex else None
    if quantity is None or not _is_scaled(config, plan.name, axis, quantity.scale):
        return _Meaning()
    scale = Scale(**config.nodes[plan.name].units.of_axis(axis))
    unit = _UNITS[quantity.scale][(plan.name, axis) in linear]
    if quantity.commanded:
        factor = 1 / (scale.pos_to_dev if quantity.scale == "pos" else scale.vel_to_dev)
        return _Meaning(factor, -scale.offset_pos_to_dev * factor if quantity.absolute else 0.0, unit)
    factors = {"pos": scale.pos_from_dev, "vel": scale.vel_from_dev, "eff": scale.eff_from_dev}
    return _Meaning(factors[quantity.scale], scale.offset_pos_from_dev if quantity.absolute else 0.0, unit)


def _is_scaled(config: BusConfig, node: str, axis: int, quantity: str) -> bool:
    """Whether bus.yml sets the scale for a quantity of an axis; the defaults of ros2_canopen do not count."""
    return config.nodes[node].units.gives(axis, f"scale_{quantity}_from_dev", f"scale_{quantity}_to_dev")
