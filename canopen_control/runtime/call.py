"""One request of a client of the API, and its answer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from canopen_control.errors import CanopenError, ControlError, LocalProtocolError

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_client import SdoRequest
    from canopen_control.host.jsonlines import Connection

__all__ = ["Call"]

MAX_OBJECT = 400_000  # bytes of an uploaded object that an answer can carry


class Call:
    """One request: `reply` or `refuse` answers it, unless it is a notification."""

    __slots__ = ("_number", "connection", "params")

    def __init__(self, connection: Connection, params: dict[str, Any], number: object) -> None:
        self.connection, self.params, self._number = connection, params, number

    @property
    def source(self) -> str:
        """Who is asking, in words."""
        return str(self.params.get("source") or f"client {self.connection.name} (pid {self.connection.pid})")

    def reply(self, result: object) -> None:
        """Answer with a result."""
        if self._number is not None:
            self.connection.send({"id": self._number, "result": result})

    def refuse(self, error: CanopenError) -> None:
        """Answer with an error."""
        if self._number is not None:
            answer = {"kind": type(error).__name__, "message": str(error)}
            self.connection.send({"id": self._number, "error": answer})

    def settle(self, error: str | None) -> None:
        """Answer the end of something that took time."""
        if error is None:
            self.reply({})
        else:
            self.refuse(ControlError(error))

    def ended(self, request: SdoRequest) -> None:
        """Answer the end of an SDO transfer."""
        if request.error is not None:
            self.refuse(request.error)
        elif request.is_write:
            self.reply({})
        elif len(request.data) > MAX_OBJECT:
            text = f"0x{request.index:04X}:{request.subindex:02X} has {len(request.data)} bytes, more than {MAX_OBJECT}"
            self.refuse(LocalProtocolError(f"{text}; end the robot and upload it straight from the bus"))
        else:
            self.reply({"data": request.data.hex()})
