"""Compares the parameters of two nodes, two files, or one of each.

What follows the node id is compared without it: a COB-ID of 0x185 on node 5 and of 0x186 on node 6 are the same
parameter. What only one side has is a difference too, unless it was asked of a node that said why it has none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.od.eds_values import format_value
from canopen_control.service.parameter_set import same_value

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from canopen_control.od.model import Address, Entry, Value
    from canopen_control.service.parameter_set import ParameterSet


__all__ = ["ParameterDifference", "differences", "parameter_text", "value_text"]

_COMMUNICATION = range(0x1000, 0x2000)  # identifiers and mappings are hexadecimal


@dataclass(frozen=True, slots=True)
class ParameterDifference:
    """A parameter that two sides have with other values, None: that side has none; the texts are for people."""

    entry: Entry
    name: str
    a: Value | None
    b: Value | None
    a_text: str
    b_text: str


def differences(a: ParameterSet, b: ParameterSet, skipped: Collection[Address] = ()) -> list[ParameterDifference]:
    """Return by address what differs, without the `skipped` addresses."""
    return list(_differences(a, b, skipped))


def _differences(a: ParameterSet, b: ParameterSet, skipped: Collection[Address]) -> Iterator[ParameterDifference]:
    a_relative, b_relative = a.relative, b.relative
    for address in sorted({*a.values, *b.values}):
        if address in skipped:
            continue
        in_a, in_b = a.values.get(address), b.values.get(address)
        entry = (a.od if in_a is not None else b.od)[address]
        follows = address in a_relative, address in b_relative
        if in_a is not None and in_b is not None and follows[0] == follows[1]:
            plain_a, plain_b = _without_id(in_a, a, follows[0]), _without_id(in_b, b, follows[1])
            if same_value(entry, plain_a, plain_b):
                continue
        texts = ["" if value is None else parameter_text(side, address) for side, value in ((a, in_a), (b, in_b))]
        yield ParameterDifference(entry, _name(a if in_a is not None else b, entry), in_a, in_b, *texts)


def _without_id(value: Value, side: ParameterSet, follows: bool) -> Value:
    return value - side.node_id if follows and isinstance(value, int) else value


def _name(side: ParameterSet, entry: Entry) -> str:
    info = side.od.objects.get(entry.index)
    return entry.name if info is None or info.name == entry.name else f"{info.name}.{entry.name}"


def parameter_text(side: ParameterSet, address: Address) -> str:
    """Return the value of a parameter: `$NODEID+0x180` where it follows the node id, numbers of a drive in decimal."""
    value, entry = side.values[address], side.od[address]
    if isinstance(value, int) and address in side.relative:
        return f"$NODEID+0x{value - side.node_id:X}"
    return value_text(entry, value)


def value_text(entry: Entry, value: Value) -> str:
    """Return a value for people: numbers of a drive in decimal, identifiers and mappings as a DCF writes them."""
    if isinstance(value, int | float) and entry.index not in _COMMUNICATION:
        return str(value)
    return format_value(value, entry.data_type) if value not in ("", b"") else "(empty)"
