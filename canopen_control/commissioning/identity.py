"""Identity of a node, and comparison with other devices, EDS files and bus.yml.

Vendor and product (0x1018:01 and 02) decide which EDS fits a node; the revision only chooses among several. As in the
boot of a node (CiA 302-2), an expected value of 0 accepts any value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.errors import EdsError
from canopen_control.od.codec import fitted
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from canopen_control.od.model import Address, ObjectDictionary
    from canopen_control.rpc.messages.robot import NodeIdentity


FIELDS: Final[dict[str, tuple[Address, str]]] = {
    "device_type": ((0x1000, 0), "device type"),
    "vendor_id": ((0x1018, 1), "vendor"),
    "product_code": ((0x1018, 2), "product"),
    "revision_number": ((0x1018, 3), "revision"),
    "serial_number": ((0x1018, 4), "serial number"),
}
"""Numbers of an identity: object and label by field of `DeviceIdentity`."""
NAME: Final[Address] = (0x1008, 0)
TEXTS: Final[dict[str, Address]] = {"device_name": NAME, "hardware": (0x1009, 0), "software": (0x100A, 0)}
OBJECTS: Final = {**{field: address for field, (address, _) in FIELDS.items()}, **TEXTS}


@dataclass(frozen=True, slots=True)
class DeviceIdentity:
    """Identity that a device reports in 0x1000, 0x1018, and 0x1008 to 0x100A; missing values are None or ""."""

    device_type: int | None = None
    vendor_id: int | None = None
    product_code: int | None = None
    revision_number: int | None = None
    serial_number: int | None = None
    device_name: str | None = None
    hardware: str | None = None
    software: str | None = None

    @classmethod
    def of(cls, numbers: Iterable[int | None], texts: Iterable[str | None] = (None, None, None)) -> DeviceIdentity:
        """Return an identity from numbers in the order of `FIELDS`, and texts in the order of `TEXTS`."""
        device_type, vendor_id, product_code, revision_number, serial_number = numbers
        device_name, hardware, software = texts
        return cls(
            device_type, vendor_id, product_code, revision_number, serial_number, device_name, hardware, software
        )

    def strangers(self, other: DeviceIdentity) -> list[str]:
        """Return the differences in device type, vendor and product; any of them forbids copying parameters."""
        return self._differences(other, ("device_type", "vendor_id", "product_code"))

    def variations(self, other: DeviceIdentity) -> list[str]:
        """Return the differences in revision and software version, which devices of one product may have."""
        return self._differences(other, ("revision_number", "software"))

    def _differences(self, other: DeviceIdentity, names: tuple[str, ...]) -> list[str]:
        pairs = ((name, getattr(self, name), getattr(other, name)) for name in names)
        return [
            f"{FIELDS[name][1] if name in FIELDS else name} {_shown(a)} and {_shown(b)}"
            for name, a, b in pairs
            if a != b and None not in (a, b) and "" not in (a, b)
        ]


def _shown(value: object) -> str:
    return f"0x{value:08X}" if isinstance(value, int) else repr(value)


@dataclass(frozen=True, slots=True)
class KnownEds:
    """EDS file, with the identity given by its objects or by [DeviceInfo]."""

    path: Path
    vendor_id: int
    product_code: int
    revision_number: int


def identity_of(data: Mapping[Address, object]) -> DeviceIdentity:
    """Return the identity, without versions of hardware and software, from uploaded bytes by address."""
    name = data.get(NAME)
    text = name.rstrip(b"\0").decode("latin-1") if isinstance(name, bytes) else None
    return DeviceIdentity.of((_number(data.get(address)) for address, _ in FIELDS.values()), (text, None, None))


def _number(data: object) -> int | None:
    """Decode an UNSIGNED32, or return None for data of another length."""
    padded = fitted(data, DataType.UNSIGNED32) if isinstance(data, bytes) else None
    return None if padded is None else int.from_bytes(padded, "little")


def read_known(paths: Iterable[Path]) -> tuple[list[KnownEds], list[str]]:
    """Return the EDS files that name a vendor or a product, and the errors of unreadable files."""
    candidates, refused = [], []
    for path in paths:
        try:
            od = read_eds(path).od
        except EdsError as error:
            refused.append(str(error))
            continue
        known = KnownEds(path, *(eds_number(od, subindex) for subindex in (1, 2, 3)))
        if known.product_code or known.vendor_id:  # without either it would fit to every device that has none
            candidates.append(known)
    return candidates, refused


def vendor_and_product(path: Path) -> tuple[int, int]:
    """Return the vendor and the product in an EDS (0 if missing), or (0, 1) if the file is unreadable."""
    try:
        od = read_eds(path).od
    except EdsError:
        return 0, 1
    return eds_number(od, 1), eds_number(od, 2)


def eds_number(od: ObjectDictionary, subindex: int) -> int:
    """Return a number of 0x1018 in an EDS: its default, else the value in [DeviceInfo], or 0 without the subindex."""
    if (entry := od.get(0x1018, subindex)) is None:
        return 0
    info = {1: od.device.vendor_number, 2: od.device.product_number, 3: od.device.revision_number}
    return entry.default if isinstance(entry.default, int) else info.get(subindex) or 0


def match_eds(identity: DeviceIdentity, candidates: Iterable[KnownEds]) -> tuple[KnownEds | None, str]:
    """Return the best matching EDS or None, and a remark if revision or product do not match exactly, else ""."""
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


def _of_the_vendor(identity: DeviceIdentity, candidates: Iterable[KnownEds]) -> tuple[KnownEds | None, str]:
    """Return the vendor's only EDS without a product code and a remark, or None and "" if there is not exactly one."""
    same = [eds for eds in candidates if not eds.product_code and eds.vendor_id and eds.vendor_id == identity.vendor_id]
    return (same[0], "without a product code, chosen by the vendor") if len(same) == 1 else (None, "")


def differences(identity: DeviceIdentity, expected: NodeIdentity) -> list[str]:
    """Return the differences from `expected` as texts; 0 in `expected` accepts any value."""
    texts = []
    for field, (_, label) in FIELDS.items():
        expected_number, has = getattr(expected, field), getattr(identity, field)
        if expected_number and expected_number != has:
            shown = "none" if has is None else f"0x{has:08X}"
            texts.append(f"{label} 0x{expected_number:08X} expected, {shown} reported")
    return texts
