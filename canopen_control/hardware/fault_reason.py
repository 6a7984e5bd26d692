"""Why a drive is in a fault: its error code (0x603F), read when the fault is seen.

The law of this file: a drive that has no 0x603F has said what it has to say by EMCY; nobody waits for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.emcy_codes import error_text
from canopen_control.cia402 import objects

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.cia301.sdo_client import SdoRequest
    from canopen_control.hardware.axis import Axis

__all__ = ["FaultReason"]


class FaultReason:
    """The error code of the last fault; `tell` is called with a sentence when it is known."""

    def __init__(self, axis: Axis, tell: Callable[[str], None]) -> None:
        self.code: int | None = None
        self.asking = False
        self._axis, self._tell = axis, tell

    def ask(self) -> None:
        """Read it, where the drive has one."""
        if self._axis.has(objects.ERROR_CODE) and not self.asking:
            self.asking = True
            self._axis.node.read(self._axis.index(objects.ERROR_CODE), 0, self._answered)

    @property
    def text(self) -> str:
        """What it is in words, "" while it is not known."""
        return "" if not self.code else f"0x603F is 0x{self.code:04X} ({error_text(self.code)})"

    def _answered(self, request: SdoRequest) -> None:
        self.asking = False
        if request.error is None:
            self.code = int.from_bytes(request.data[:2], "little")
            if self.text:
                self._tell(self.text)
