"""Identity that the boot requires of a node, and warnings about files that are for another device, node or bit rate."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.pdo import INVALID_BIT
from canopen_control.od.eds_sections import saved_node_id
from canopen_control.od.indices import IDENTITY, PROGRAM_ID
from canopen_control.od.pdos import is_cob_id
from canopen_control.rpc.messages.robot import NodeIdentity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.master.keys import NodeConfig
    from canopen_control.master.plan_builder import PlanBuilder, PlannedWrite
    from canopen_control.od.model import Address, ObjectDictionary


SAVED: Final = (".dcf", ".xdc")
"""Suffixes of files of one device, with its bit rate; in other files the bit rate is often a left-over."""
_COMPARED: Final = {
    "vendor_id": (IDENTITY, 1),
    "product_code": (IDENTITY, 2),
    "revision_number": (IDENTITY, 3),
    "serial_number": (IDENTITY, 4),
    "software_version": (PROGRAM_ID, 1),
}
"""Keys of bus.yml with which the boot compares an object of the device."""
_NODE_ID_NAME: Final = re.compile(r"(?i)(?:can ?)?node[ _-]?id")


def check_identity(builder: PlanBuilder) -> None:
    """Warn if the vendor id or product code in bus.yml differs from the EDS, which is then for another device.

    Warn also if the EDS lacks an object with which bus.yml requires a value to be compared.
    """
    device = builder.od.device
    in_file = {"vendor_id": device.vendor_number, "product_code": device.product_number}
    for key, address, value in compared_values(builder.node):
        name, actual = f"0x{address[0]:04X}:{address[1]:02X}", in_file.get(key)
        if actual and value != actual:
            text = f"0x{value:X} is required, but {builder.file} is for 0x{actual:X}; correct one of them"
            builder.warn(key, text)
        elif address not in builder.od:
            text = f"is compared with {name}, which is not in {builder.file}; remove {key} if the device has no {name}"
            builder.warn(key, text)


def compared_values(node: NodeConfig) -> Iterator[tuple[str, Address, int]]:
    """Yield the keys of bus.yml that require a value of a device, with the object and the value."""
    for key, address in _COMPARED.items():
        if value := getattr(node.identity, key):
            yield key, address, value


def warn_of_another_node(builder: PlanBuilder) -> None:
    """Warn about a DCF that was saved for another node, if COB-IDs or the node-ID of that node are written."""
    saved, node_id = saved_node_id(builder.od), builder.node.node_id
    if not saved or saved == node_id or builder.node.boot.configuration_file:
        return
    foreign = [
        _shown(write)
        for write in builder.writes
        if write.reason == builder.download_reason and _is_of_node(write, saved)
    ]
    if foreign:
        builder.warn(
            "dcf",
            f"{builder.file} was saved for node {saved}, and node {node_id} gets values of that node: "
            f"{', '.join(dict.fromkeys(foreign))}; use a DCF that was saved for this node, or the EDS of the device",
        )


def warn_of_bit_rate(builder: PlanBuilder, kbits: int) -> None:
    """Warn about a device that cannot have the bit rate of the bus, or a DCF that was saved at another one.

    Such a device does not answer, and its error frames disturb the other devices.
    """
    rates, saved = builder.od.device.bit_rates, builder.od.bitrate
    if rates and kbits * 1000 not in rates:
        listed = ", ".join(str(rate // 1000) for rate in sorted(rates))
        text = f"{builder.file} lists {listed} kbit/s for this device, and the bus has {kbits}"
        builder.warn("dcf", f"{text}; set baudrate of the master to one of them")
    elif saved and saved != kbits * 1000 and builder.file.lower().endswith(SAVED):
        text = f"{builder.file} was saved at {saved / 1000:g} kbit/s, and the bus has {kbits}"
        builder.warn("dcf", f"{text}; set the device to {kbits} kbit/s, or baudrate of the master to {saved / 1000:g}")


def _is_of_node(write: PlannedWrite, node_id: int) -> bool:
    """Whether a write gives a PDO a COB-ID of a node, or an object its node-ID (0x2000 in maxon's DCFs)."""
    value = int.from_bytes(write.data, "little")
    if is_cob_id(*write.address):
        return not value & INVALID_BIT and value & 0x7F == node_id
    return value == node_id and _NODE_ID_NAME.fullmatch(write.name) is not None


def _shown(write: PlannedWrite) -> str:
    value = int.from_bytes(write.data, "little")
    if write.pdo is None:
        return f"{write.name} (0x{write.index:04X}) = {value}"
    return f"{write.pdo[0].upper()} {write.pdo[1]} 0x{value & 0x7FF:03X}"


def required_identity(node: NodeConfig, od: ObjectDictionary) -> NodeIdentity:
    """Return the identity for the comparison during boot; the number 0 disables a comparison.

    Vendor id and product code are from bus.yml, else from the EDS; revision and serial number only from bus.yml. EDS
    values count only if the EDS has the entry of 0x1018: only the vendor id is mandatory there (CiA 301, 7.5.2.21),
    some devices lack even that, and values of [DeviceInfo] cannot be read from a device.
    """

    def default(index: int, subindex: int, device: int | None, number: int | None = None) -> int:
        entry = od.get(index, subindex)
        if number is not None:
            return number
        if entry is None:
            return 0
        return entry.default if isinstance(entry.default, int) else device or 0

    return NodeIdentity(
        device_type=default(0x1000, 0, None),
        vendor_id=default(0x1018, 1, od.device.vendor_number, node.identity.vendor_id),
        product_code=default(0x1018, 2, od.device.product_number, node.identity.product_code),
        revision_number=node.identity.revision_number or 0,
        serial_number=node.identity.serial_number or 0,
        eds_revision=0 if node.identity.revision_number is not None else default(0x1018, 3, od.device.revision_number),
    )
