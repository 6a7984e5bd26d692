"""Fault of a device, an axis or a bus: one record for EMCY, statusword, 0x603F, logs, status, report and ROS.

Code that detects a fault on the bus creates a `FaultEvent`; code that displays a fault uses the fields or texts. A
field has a value only if the source contains it, so that the fields show the source of the record.
"""

from __future__ import annotations

import msgspec

from canopen_control.cia301.emcy import EmcyMessage, code_text, is_reset_code, register_text


class FaultEvent(msgspec.Struct, frozen=True, omit_defaults=True):
    """Fault of a device, an axis or a bus, as observed on the bus.

    `error_code` is from an EMCY message or 0x603F; `error_register` (0x1001) and `data`, the manufacturer-specific
    bytes in hexadecimal, are from an EMCY message; `statusword` shows the fault of an axis; `identifiers` are the
    identifiers of received frames that no node of the bus uses.
    """

    error_code: int | None = None
    error_register: int | None = None
    data: str | None = None
    identifiers: tuple[str, ...] = ()
    statusword: int | None = None

    @classmethod
    def of_emcy(cls, message: EmcyMessage) -> FaultEvent:
        """Return the fault, or the end of a fault, reported by an EMCY message."""
        return cls(message.error_code, message.error_register, message.data.hex())

    @property
    def is_over(self) -> bool:
        """Whether the error code reports that an error has ended (00xx)."""
        return self.error_code is not None and is_reset_code(self.error_code)

    @property
    def code_text(self) -> str:
        """Error code with its meaning, or "" without a code."""
        return "" if self.error_code is None else code_text(self.error_code)

    @property
    def text(self) -> str:
        """Error code, error register, data and statusword as text; missing and zero data are omitted."""
        parts = [self.code_text]
        if self.error_register is not None:
            bits = register_text(self.error_register)
            parts.append(f"register 0x{self.error_register:02X}{bits and f' ({bits})'}")
        if self.data and any(data := bytes.fromhex(self.data)):
            parts.append(f"data {data.hex(' ')}")
        if self.statusword is not None:
            parts.append(f"statusword 0x{self.statusword:04X}")
        return ", ".join(filter(None, parts))

    @property
    def values(self) -> dict[str, str]:
        """Known fields as text, by name, for ROS messages."""
        known = {
            "error_code": None if self.error_code is None else f"0x{self.error_code:04X}",
            "error_register": None if self.error_register is None else f"0x{self.error_register:02X}",
            "data": None if self.data is None else bytes.fromhex(self.data).hex(" "),
            "statusword": None if self.statusword is None else f"0x{self.statusword:04X}",
        }
        return {key: value for key, value in known.items() if value is not None}
