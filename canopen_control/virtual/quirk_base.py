"""Declaration of quirks, and the hooks through which quirk actions change a virtual node.

A fault is a defect; a quirk is how a manufacturer's healthy drive always behaves. A quirk has a name, a description,
the clause or object of the standard from which it departs ("" if the standard allows it), a source, an action, and
possibly a strength. A source is a repository with the number of a thread or a file, or a manual with a page or object;
`unsourced` quirks were seen by users, without a public source. An axis can have only one quirk of each `group`.

An action is called once with the strength when its quirk is switched on; its hooks are undone when the quirk is
switched off. No code of an inactive quirk runs.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.od.indices import RPDO, TPDO
from canopen_control.rpc.messages.drive import QuirkListing
from canopen_control.virtual.fault_effects import refusing
from canopen_control.virtual.mode_base import ModeGate

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from canopen_control.cia402.state import Transition
    from canopen_control.frame import CanFrame
    from canopen_control.od.model import Entry, Value
    from canopen_control.virtual.device_model import DeviceModel
    from canopen_control.virtual.fault_effects import Incoming, Outgoing, Switch
    from canopen_control.virtual.injection_point import InjectionPoint
    from canopen_control.virtual.object_store import Guard
    from canopen_control.virtual.power_machine import TransitionAct
    from canopen_control.virtual.virtual_drive import VirtualDrive
    from canopen_control.virtual.virtual_node import VirtualNode

    Check = Callable[[Entry, Value, Guard], Value]
    Sent = list[tuple[int, CanFrame]]
    AxisAct = Callable[["QuirkHooks", VirtualDrive, float], None]
    NodeAct = Callable[["QuirkHooks", float], None]

T = TypeVar("T")
_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Strength:
    """Parameter of a quirk: unit, default and bounds; `whole` permits only integers."""

    unit: str
    default: float
    low: float
    high: float
    whole: bool = False


def in_seconds(default: float, high: float = 60.0) -> Strength:
    """Return a quirk parameter in s, from 1 ms to `high`."""
    return Strength("s", default, 0.001, high)


def whole(unit: str, default: float, low: float, high: float) -> Strength:
    """Return an integer quirk parameter."""
    return Strength(unit, default, low, high, whole=True)


@dataclass(frozen=True, slots=True)
class Quirk:
    """Entry of the quirk table; exactly one of `axis` (action on an axis) and `node` (action on the node) is set."""

    name: str
    does: str
    clause: str
    source: str
    axis: AxisAct | None = None
    node: NodeAct | None = None
    strength: Strength | None = None
    group: str = ""

    def listing(self, on: Sequence[str] = ()) -> QuirkListing:
        """Return the entry of the quirk for lists; `on` are the active settings in text form."""
        strength = self.strength
        return QuirkListing(
            name=self.name,
            does=self.does,
            clause=self.clause,
            source=self.source,
            acts="axis" if self.axis is not None else "node",
            unit="" if strength is None else strength.unit,
            default=None if strength is None else strength.default,
            low=None if strength is None else strength.low,
            high=None if strength is None else strength.high,
            on=list(on),
        )


class QuirkHooks:
    """Hooks with which quirk actions change `node`; changes are undone in reverse order.

    `outgoing` and `incoming` are functions that change the frames that leave or reach the node.
    """

    def __init__(self, node: VirtualNode) -> None:
        self.node = node
        self.outgoing: list[Outgoing] = []
        self.incoming: list[Incoming] = []
        self._undo = contextlib.ExitStack()

    def undo(self) -> None:
        self._undo.close()
        self.outgoing.clear()
        self.incoming.clear()

    def later(self, undo: Callable[[], object]) -> None:
        """Call `undo` when the quirks are undone."""
        self._undo.callback(undo)

    def attribute(self, part: Any, name: str, value: object) -> None:  # noqa: ANN401 - any part of a node
        """Set an attribute of `part` until the quirks are undone."""
        self.later(partial(setattr, part, name, getattr(part, name)))
        setattr(part, name, value)

    def entry(self, table: dict[Any, Any], key: object, value: object) -> None:
        """Set an entry of a dictionary until the quirks are undone."""
        self.later(partial(table.__setitem__, key, table[key]) if key in table else partial(table.pop, key, None))
        table[key] = value

    def healthy(self, point: InjectionPoint[T], value: T) -> None:
        """Set the present and the healthy value of an injection point, so that it also applies after a fault ends."""
        self.attribute(point, "healthy", value)
        self.attribute(point, "value", value)

    # -- objects

    def guard(self, indices: Iterable[int], check: Check) -> None:
        """Check writes to `indices` with `check`, which receives the previous check as its last argument."""
        store = self.node.store
        for index in {entry.index for entry in store.od}.intersection(indices):
            present, by_values = store.guard_of(index)
            self.later(partial(store.set_guard, index, present, by_values=by_values))
            store.set_guard(index, _checked(check, present))

    def show(self, index: int, subindex: int, view: Callable[[Any], Value]) -> None:
        """Apply `view` to the value when an entry is read."""
        store = self.node.store
        if not store.has(index, subindex):
            return
        source = store.source_of(index, subindex)
        read = source or partial(store.values.__getitem__, (index, subindex))
        self.later(partial(store.set_source, index, subindex, source))
        store.set_source(index, subindex, lambda: view(read()))

    def preset(self, index: int, subindex: int, value: Value) -> None:
        """Set a value now and after every reset, until the quirks are undone."""
        store = self.node.store
        if not store.has(index, subindex):
            return
        before, presets = store.values[index, subindex], store.preset_of(index, subindex)

        def undo() -> None:
            store.unset_preset(index, subindex, *presets)
            if store.values[index, subindex] == value:
                store.set(index, subindex, before)

        self.later(undo)
        store.preset(index, subindex, value)

    def absent(self, *indices: int) -> None:
        """Answer SDO requests as if the objects did not exist, and refuse to map them."""
        self.incoming.append(refusing(AbortCode.NO_OBJECT, lambda _command, index: index in indices))
        self.guard(pdo_mappings(self.node), partial(_not_mapped, indices))

    # -- axes

    def word(self, drive: VirtualDrive, change: Callable[[int], int]) -> None:
        statusword = drive.readings.statusword
        self.attribute(statusword, "changes", (*statusword.changes, change))

    def act(self, drive: VirtualDrive, number: int, act: Callable[[Transition, int, TransitionAct], None]) -> None:
        """Replace the action of transition `number` of an axis; `act` gets the previous action as its last argument."""
        before = drive.power.act_of(number)
        self.entry(drive.power.acts, number, lambda transition, now: act(transition, now, before))

    def delay(self, drive: VirtualDrive, number: int, seconds: float) -> None:
        self.entry(drive.power.delays_ns, number, round(seconds * _S))

    def gate(self, drive: VirtualDrive) -> ModeGate:
        """Return the gate in front of the modes of an axis; the first call creates it."""
        if drive.modes.gate is None:
            self.attribute(drive.modes, "gate", ModeGate())
        assert drive.modes.gate is not None
        return drive.modes.gate

    def model(self, drive: VirtualDrive, changed: DeviceModel) -> None:
        self.later(partial(drive.set_model, drive.objects.model))
        drive.set_model(changed)


def _checked(check: Check, present: Guard | None) -> Guard:
    before = _unchanged if present is None else present
    return lambda entry, value: check(entry, value, before)


def _unchanged(_entry: Entry, value: Value) -> Value:
    return value


def _not_mapped(indices: tuple[int, ...], entry: Entry, value: Value, before: Guard) -> Value:
    if entry.subindex and int(value) >> 16 in indices:
        raise SdoServerAbort(AbortCode.NO_OBJECT)
    return before(entry, value)


def pdo_records(node: VirtualNode) -> list[int]:
    """Return the indices of the communication records of all PDOs."""
    return [*(RPDO + number for number in node.pdos.rpdos), *(TPDO + number for number in node.pdos.tpdos)]


def pdo_mappings(node: VirtualNode) -> list[int]:
    """Return the indices of the mapping records of all PDOs."""
    return [record + 0x200 for record in pdo_records(node)]


# -- quirk actions of several topics


def axis_refuses(code: AbortCode, index: int, when: Callable[[VirtualDrive, int, float], bool]) -> AxisAct:
    """Return a quirk action that refuses writes to an object of an axis with `code` while `when` is true."""

    def act(hooks: QuirkHooks, drive: VirtualDrive, strength: float) -> None:
        def check(entry: Entry, value: Value, before: Guard) -> Value:
            if when(drive, int(value), strength):
                raise SdoServerAbort(code)
            return before(entry, value)

        hooks.guard([index + drive.objects.offset], check)

    return act


def hide_objects(*indices: int) -> NodeAct:
    """Return a quirk action that hides objects of the node."""
    return lambda hooks, _strength: hooks.absent(*indices)


def apply_switch(switch: Switch) -> NodeAct:
    """Return a quirk action that calls `switch` with True when enabled, and with False when undone."""

    def act(hooks: QuirkHooks, _strength: float) -> None:
        node = hooks.node
        hooks.later(lambda: switch(node, False, node.clock.now))
        switch(node, True, node.clock.now)

    return act


def filter_frames(incoming: Incoming) -> NodeAct:
    """Return a quirk action that applies `incoming` to the frames that reach the node."""
    return lambda hooks, _strength: hooks.incoming.append(incoming)
