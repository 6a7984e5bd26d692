"""``local:`` buses for python-can: ``can.Bus(interface="canopen_control", channel="robby")``.

So python-can's logger and viewer, and whatever is built on python-can, such as the `canopen` package, can join a bus
while a robot runs on it. The entry point ``can.interface`` makes it known; nothing has to be imported.
"""

from __future__ import annotations

import select
import threading
import time
from collections import deque

import can

from canopen_control.bus.local import open_local
from canopen_control.bus.pythoncan import message_of, record_of
from canopen_control.errors import BusClosed, CanopenError
from canopen_control.frame import frames_of
from canopen_control.host.sockets import list_sockets

__all__ = ["LocalBus"]


class LocalBus(can.BusABC):
    """One end of a ``local:`` bus, as python-can wants it; one thread may send while another receives.

    `channel` is the bus' name, with or without ``local:``; `label` is what others see of this end. Error frames are
    delivered, with `is_error_frame` set. The bus has no bit rate of its own: a `bitrate` is accepted and ignored.
    """

    def __init__(
        self,
        channel: str,
        can_filters: can.typechecking.CanFilters | None = None,
        *,
        label: str = "python-can",
        receive_own_messages: bool = False,
        **kwargs: object,
    ) -> None:
        name = str(channel).removeprefix("local:")
        self.channel_info = f"canopen_control local:{name}"
        self._can_protocol = can.CanProtocol.CAN_20
        self._own = receive_own_messages
        self._waiting: deque[can.Message] = deque()
        self._sending = threading.Lock()
        try:
            self._port = open_local(name, label)
        except CanopenError as error:
            raise can.CanInitializationError(str(error)) from error
        super().__init__(channel=name, can_filters=can_filters, **kwargs)

    def fileno(self) -> int:
        """Return the descriptor that is readable when frames wait."""
        return self._port.fileno()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a message; CanOperationError if the bus is gone or does not take it within `timeout` seconds."""
        record = record_of(msg)
        if record is None:
            raise can.CanOperationError("CAN FD frames have no place on a CANopen bus")
        with self._sending:
            try:
                self._port.send(record)
                if timeout is not None and self._port.wants_write:
                    self._flush(timeout)
            except BusClosed as error:
                raise can.CanOperationError(str(error)) from error
        if self._own:
            msg.timestamp = time.time()
            self._waiting.append(msg)

    def _flush(self, timeout: float) -> None:
        deadline = time.monotonic() + timeout
        while self._port.wants_write:
            if not select.select([], [self._port], [], max(0.0, deadline - time.monotonic()))[1]:
                raise can.CanTimeoutError(f"{self._port.channel} has not taken the message within {timeout:g} s")
            self._port.flush()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._waiting:
            self._fetch(timeout)
        return (self._waiting.popleft() if self._waiting else None), False

    def _fetch(self, timeout: float | None) -> None:
        try:
            if not select.select([self._port], [], [], timeout)[0]:
                return
            records = self._port.receive()
        except (BusClosed, OSError, ValueError) as error:  # the latter two: closed by another thread meanwhile
            raise can.CanOperationError(str(error)) from error
        now = time.time()
        self._waiting.extend(message_of(frame, now, self._port.channel) for frame in frames_of(records))
        if self._port.wants_write:
            with self._sending:
                self._port.flush()

    def shutdown(self) -> None:
        """Leave the bus; a second call does nothing."""
        super().shutdown()
        self._port.close()

    @staticmethod
    def _detect_available_configs() -> list[can.typechecking.AutoDetectedConfig]:
        return [{"interface": "canopen_control", "channel": name} for name in list_sockets("bus")]
