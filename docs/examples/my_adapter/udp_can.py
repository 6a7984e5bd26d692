"""A python-can adapter for CAN frames over UDP; the channel is two local ports, `LOCAL-REMOTE`."""

import socket
import struct
from typing import Any

import can

RECORD = struct.Struct(">IB8s")  # identifier, length, data


class UdpCan(can.BusABC):
    """One end of the link; each frame is a datagram."""

    def __init__(self, channel: str, **options: Any) -> None:
        here, there = (int(port) for port in channel.split("-"))
        self.channel_info = f"UDP {channel}"
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", here))
        self._peer = ("127.0.0.1", there)
        super().__init__(channel=channel, **options)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one frame."""
        self._socket.sendto(RECORD.pack(msg.arbitration_id, msg.dlc, bytes(msg.data)), self._peer)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self._socket.settimeout(timeout)
        try:
            identifier, length, data = RECORD.unpack(self._socket.recv(RECORD.size))
        except (TimeoutError, BlockingIOError):
            return None, False
        return can.Message(arbitration_id=identifier, is_extended_id=False, data=data[:length]), False  # not filtered

    def shutdown(self) -> None:
        """Close the socket."""
        super().shutdown()
        self._socket.close()
