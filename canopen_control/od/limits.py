"""The limits of an entry (LowLimit, HighLimit), and which of them count.

CiA 301 gives some objects values that are no quantities: an identifier below flag bits (COB-IDs), a node id above a
time (0x1016), a signature (0x1010, 0x1011). A limit that leaves no room for what every device has to take there is a
mistake of the file, as 65535 for 0x1016 is: it is told by the check of the file, and nobody obeys it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from canopen_control.od.model import Entry

__all__ = ["above_limit", "below_limit", "forbidden_limit", "outside_limits"]


class _Required(NamedTuple):
    """What the value range of an object has to hold, by CiA 301."""

    low: int
    high: int
    why: str


_OFF = 1 << 31
_COB_ID = _Required(_OFF, _OFF, "bit 31 switches the object off")
_SIGNATURE = _Required(0x64616F6C, 0x65766173, "the signature is written there")
_OBJECTS = {
    0x1005: _Required(0x80, 0x80, "0x80 is the predefined identifier"),  # 7.5.2.5
    0x1010: _SIGNATURE,  # 7.5.2.13
    0x1011: _SIGNATURE,  # 7.5.2.14
    0x1014: _COB_ID,  # 7.5.2.17
    0x1016: _Required(0, 127 << 16 | 1, "bits 16 to 23 are the node id"),  # 7.5.2.19
}
_PDO_RECORDS = (0x1400, 0x1800)  # 7.5.2.35 and 7.5.2.37, 512 each


def _required(entry: Entry) -> _Required | None:
    if entry.data_type is not DataType.UNSIGNED32:
        return None
    index, subindex = entry.address
    if subindex == 1 and any(first <= index < first + 512 for first in _PDO_RECORDS):
        return _COB_ID
    if index in (0x1010, 0x1011, 0x1016) and not subindex:
        return None
    return _OBJECTS.get(index)


def forbidden_limit(entry: Entry) -> str:
    """Return what is wrong with the limits of a communication object, empty where CiA 301 allows them."""
    required = _required(entry)
    if required is None:
        return ""
    if entry.high is not None and entry.high < required.high:
        return f"HighLimit {entry.high} forbids what CiA 301 wants there ({required.why}); ignored"
    if entry.low is not None and entry.low > required.low:
        return f"LowLimit {entry.low} forbids what CiA 301 wants there ({required.why}); ignored"
    return ""


def above_limit(entry: Entry, value: float) -> bool:
    """Whether a value is above a HighLimit that counts."""
    return entry.high is not None and value > entry.high and not forbidden_limit(entry)


def below_limit(entry: Entry, value: float) -> bool:
    """Whether a value is below a LowLimit that counts."""
    return entry.low is not None and value < entry.low and not forbidden_limit(entry)


def outside_limits(entry: Entry, value: float) -> bool:
    """Whether a value is outside limits that count."""
    return above_limit(entry, value) or below_limit(entry, value)
