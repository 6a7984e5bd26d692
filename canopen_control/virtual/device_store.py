"""SDO access to a device with several motors in one object set: maps its objects to the store of its axes.

The store has the objects of several axes as defined by CiA 402 (`cia402.motors`); SDO uses those of the device.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.od.codec import default_of, encode

if TYPE_CHECKING:
    from canopen_control.cia402.motors import MotorMap
    from canopen_control.od.model import Entry
    from canopen_control.virtual.object_store import VirtualStore


class DeviceStore:
    """Objects of the device `motors` with the values of `store`."""

    def __init__(self, store: VirtualStore, motors: MotorMap) -> None:
        self._store, self._motors = store, motors

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an object; SdoServerAbort if it is missing or not readable."""
        entry = self._entry(index, subindex)
        if entry is None:
            return self._store.upload(index, subindex)
        parts = self._motors.parts(index, subindex)
        if not parts:
            return encode(default_of(entry), entry.data_type)  # the number of subindices
        size = (entry.data_type.bits or 0) // 8 // len(parts)
        return b"".join(self._store.upload(*address)[:size] for address in parts)

    def size_of(self, index: int, subindex: int) -> int | None:
        """Return the size of a download in bytes, None if it is variable; SdoServerAbort as `VirtualStore` has it."""
        entry = self._entry(index, subindex)
        if entry is None:
            return self._store.size_of(index, subindex)
        if not entry.writable:
            raise SdoServerAbort(AbortCode.READ_ONLY)
        return (entry.data_type.bits or 0) // 8

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write the bytes of an object to all axes that it belongs to; SdoServerAbort if a rule forbids it."""
        entry = self._entry(index, subindex)
        if entry is None:
            for address in ((index, subindex), *self._motors.shared.get((index, subindex), ())):
                self._store.download(*address, data)
            return
        parts = self._motors.parts(index, subindex)
        if not entry.writable:
            raise SdoServerAbort(AbortCode.READ_ONLY)
        if len(data) != self.size_of(index, subindex):
            long = len(data) > (self.size_of(index, subindex) or 0)
            raise SdoServerAbort(AbortCode.LENGTH_TOO_HIGH if long else AbortCode.LENGTH_TOO_LOW)
        size = len(data) // len(parts)
        for number, address in enumerate(parts):
            kind = self._store.od[address].data_type
            value = int.from_bytes(data[number * size : (number + 1) * size], "little", signed=kind.signed)
            self._store.download(*address, encode(value, kind))

    def _entry(self, index: int, subindex: int) -> Entry | None:
        """Return the device's entry of an object that is elsewhere in the store, None if it is not."""
        entry = self._motors.device.get(index, subindex)
        if entry is None and (index, subindex) in self._motors.places:  # an address of the view alone
            present = index in self._motors.device.objects
            raise SdoServerAbort(AbortCode.NO_SUBINDEX if present else AbortCode.NO_OBJECT)
        elsewhere = bool(self._motors.parts(index, subindex)) or (index, subindex) in self._motors.places
        return entry if elsewhere else None
