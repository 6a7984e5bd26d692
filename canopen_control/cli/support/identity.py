"""Identity of a node, its EDS file, and the comparison with bus.yml.

Vendor and product decide which EDS a node has (0x1018:01 and 02); the revision only chooses among
several. What is expected is what the boot would refuse (CiA 302-2), where 0 stands for anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.errors import EdsError
from canopen_control.od.codec import fitted
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from canopen_control.od.model import ObjectDictionary


#: field: (object, what it is called)
FIELDS: dict[str, tuple[tuple[int, int], str]] = {
    "device_type": ((0x1000, 0), "device type"),
    "vendor_id": ((0x1018, 1), "vendor"),
    "product_code": ((0x1018, 2), "product"),
    "revision_number": ((0x1018, 3), "revision"),
    "serial_number": ((0x1018, 4), "serial number"),
}
NAME = (0x1008, 0)


@dataclass(frozen=True, slots=True)
class ScannedDevice:
    """Values of 0x1000, 0x1018 and 0x1008; None for missing ones."""

    device_type: int | None = None
    vendor_id: int | None = None
    product_code: int | None = None
    revision_number: int | None = None
    serial_number: int | None = None
    device_name: str | None = None


@dataclass(frozen=True, slots=True)
class KnownEds:
    """A file and the identity it is for."""

    path: Path
    vendor_id: int
    product_code: int
    revision_number: int


def identity_of(data: Mapping[tuple[int, int], object]) -> ScannedDevice:
    """Return the identity in objects that were read by address; refused ones are None."""
    numbers = {field: _number(data.get(address)) for field, (address, _) in FIELDS.items()}
    name = data.get(NAME)
    text = name.rstrip(b"\0").decode("latin-1") if isinstance(name, bytes) else None
    return ScannedDevice(**numbers, device_name=text)


def _number(data: object) -> int | None:
    """Return an UNSIGNED32, as all of `FIELDS` are; None for other data."""
    padded = fitted(data, DataType.UNSIGNED32) if isinstance(data, bytes) else None
    return None if padded is None else int.from_bytes(padded, "little")


def read_known(paths: Iterable[Path]) -> tuple[list[KnownEds], list[str]]:
    """Read the identities of EDS files; the second list has the unreadable ones with the reason."""
    candidates, refused = [], []
    for path in paths:
        try:
            od = read_eds(path).od
        except EdsError as error:
            refused.append(str(error))
            continue
        vendor = _default(od, 1, od.device.vendor_number)
        product = _default(od, 2, od.device.product_number)
        if product or vendor:  # without either it would fit to every device that tells nothing
            candidates.append(KnownEds(path, vendor, product, _default(od, 3, od.device.revision_number)))
    return candidates, refused


def vendor_and_product(path: Path) -> tuple[int, int]:
    """Return vendor and product of an EDS, 0 if missing; (0, 1) for an unreadable file."""
    try:
        od = read_eds(path).od
    except EdsError:
        return 0, 1
    return _default(od, 1, od.device.vendor_number), _default(od, 2, od.device.product_number)


def _default(od: ObjectDictionary, subindex: int, device: int | None) -> int:
    """Return the default of a subindex; 0 if the file lacks it."""
    entry = od.get(0x1018, subindex)
    if entry is None:
        return 0
    return entry.default if isinstance(entry.default, int) else device or 0


def match_eds(identity: ScannedDevice, candidates: Iterable[KnownEds]) -> tuple[KnownEds | None, str]:
    """Return the file that fits best, and a remark: another revision, or other files that fit as well."""
    same = [
        eds
        for eds in candidates
        if (eds.vendor_id, eds.product_code) == (identity.vendor_id or 0, identity.product_code)
    ]
    if not same:
        return _of_the_vendor(identity, candidates)
    exact = [eds for eds in same if eds.revision_number == identity.revision_number]
    best = (exact or sorted(same, key=lambda eds: eds.revision_number))[-1]
    if exact:
        return best, ""
    return best, f"for revision 0x{best.revision_number:08X}"


def _of_the_vendor(identity: ScannedDevice, candidates: Iterable[KnownEds]) -> tuple[KnownEds | None, str]:
    """Return the only file of the vendor without a product code."""
    same = [eds for eds in candidates if not eds.product_code and eds.vendor_id and eds.vendor_id == identity.vendor_id]
    return (same[0], "without a product code, chosen by its vendor") if len(same) == 1 else (None, "")


def differences(identity: ScannedDevice, expected: Mapping[str, int]) -> list[str]:
    """Return the differences from `expected` in words; 0 in `expected` accepts any value."""
    texts = []
    for field, (_, label) in FIELDS.items():
        expected_number, has = expected.get(field, 0), getattr(identity, field)
        if expected_number and expected_number != has:
            shown = "none" if has is None else f"0x{has:08X}"
            texts.append(f"{label} 0x{expected_number:08X} expected, {shown} found")
    return texts
