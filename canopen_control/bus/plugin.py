"""``local:`` buses for python-can: ``can.Bus(interface="canopen_control", channel="robby")``.

Programs built on python-can, such as its logger and viewer and the `canopen` package, can thus join a bus while a robot
runs on it. The entry point ``can.interface`` registers the interface; no import is needed.
"""

from __future__ import annotations

import copy
import select
import selectors
import threading
import time
from collections import deque
from typing import TYPE_CHECKING

import can

from canopen_control.bus.local import open_local
from canopen_control.bus.port import WakeDescriptor
from canopen_control.bus.port_abilities import Arrivals
from canopen_control.bus.pythoncan import message_of, record_of
from canopen_control.errors import BusClosed, CanopenError
from canopen_control.frame import frames_of
from canopen_control.host.sockets import list_sockets

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.bus.subscription import Chunk


class LocalBus(can.BusABC):
    """Port of a ``local:`` bus as a python-can bus; one thread may send while another receives.

    `channel` is the name of the bus, with or without ``local:``; `label` is its name for the other ports. Error frames
    are delivered with `is_error_frame` set. With `receive_own_messages` sent messages are received in their order among
    the others, with `is_rx` False. Time stamps are those of the hub, strictly increasing. The bus has no bit rate of
    its own: `bitrate` is accepted and ignored.
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
        self._receiving = threading.RLock()
        try:
            self._port = open_local(name, label)
        except CanopenError as error:
            raise can.CanInitializationError(str(error)) from error
        self._port.ask_stamps(echo=receive_own_messages)
        self._arrivals = Arrivals(self._port)
        self._wake = WakeDescriptor()
        self._woken = False
        self._poll = select.poll()
        for source in (self._port, self._wake):
            self._poll.register(source, select.POLLIN)
        self._readable: selectors.BaseSelector | None = None
        super().__init__(channel=name, can_filters=can_filters, **kwargs)

    def fileno(self) -> int:
        """Return a descriptor that is readable while a message waits; -1 after shutdown."""
        if self._is_shutdown:
            return -1
        if self._readable is None:
            self._readable = selectors.DefaultSelector()  # its own descriptor is readable while one of these is
            for source in (self._port, self._wake):
                self._readable.register(source, selectors.EVENT_READ)
            self._mark_waiting()
        descriptor: int = self._readable.fileno()  # type: ignore[attr-defined] # epoll's and kqueue's have one
        return descriptor

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a message; raise CanTimeoutError if the bus does not accept it within `timeout` s.

        Raise CanOperationError for a CAN FD message, or if the bus is gone.
        """
        record = record_of(msg)
        if record is None:
            raise can.CanOperationError("CAN FD frames are not supported on a CANopen bus")
        with self._sending:
            self._check_open()
            try:
                self._port.send(record)
                if timeout is not None and self._port.wants_write:
                    self._flush(timeout)
            except BusClosed as error:
                raise can.CanOperationError(str(error)) from error
        if self._own and not self._port.gives_stamps:
            self._echo(msg)

    def _echo(self, msg: can.Message) -> None:
        """Receive a sent message locally, for hubs of earlier versions that do not return it."""
        copied = copy.copy(msg)
        copied.is_rx, copied.timestamp, copied.channel = False, time.time(), self._port.channel
        self._woken = True
        self._waiting.append(copied)
        self._wake.set()

    def _flush(self, timeout: float) -> None:
        deadline = time.monotonic() + timeout
        while self._port.wants_write:
            if not select.select([], [self._port], [], max(0.0, deadline - time.monotonic()))[1]:
                raise can.CanTimeoutError(f"{self._port.channel} has not accepted the message within {timeout:g} s")
            self._port.flush()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        with self._receiving:
            self._check_open()
            if not self._waiting:
                self._fetch(timeout)
            message = self._waiting.popleft() if self._waiting else None
            self._mark_waiting()
        return message, False

    def _fetch(self, timeout: float | None) -> None:
        ready = self._poll.poll(None if timeout is None else max(0.0, 1000 * timeout))
        self._check_open()
        if not ready:
            return
        try:
            chunks = self._port.receive_chunks()
        except BusClosed as error:
            raise can.CanOperationError(str(error)) from error
        self._waiting.extend(self._messages(chunks))
        if self._port.wants_write:
            with self._sending:
                self._port.flush()

    def _messages(self, chunks: list[Chunk]) -> Iterator[can.Message]:
        stamps = [stamp for chunk in chunks for stamp in chunk.stamps]
        self._arrivals.order(stamps)
        times, offset = iter(stamps), self._arrivals.unix_offset_ns
        for chunk in chunks:
            for frame in frames_of(chunk.records):
                message = message_of(frame, (next(times) + offset) / 1e9, self._port.channel)
                message.is_rx = not chunk.own
                yield message

    def _mark_waiting(self) -> None:
        """Keep the descriptor readable while messages already read from the port wait here."""
        if self._readable is not None and bool(self._waiting) is not self._woken:
            self._woken = not self._woken
            (self._wake.set if self._woken else self._wake.clear)()

    def _check_open(self) -> None:
        if self._is_shutdown:
            raise can.CanOperationError(f"{self.channel_info}: cannot operate on a closed bus")

    def shutdown(self) -> None:
        """Close the port, even while a thread receives; a second call does nothing."""
        if self._is_shutdown:
            return
        super().shutdown()
        self._wake.set()
        with self._receiving, self._sending:
            if self._readable is not None:
                self._readable.close()
            self._port.close()
            self._wake.close()

    @staticmethod
    def _detect_available_configs() -> list[can.typechecking.AutoDetectedConfig]:
        return [{"interface": "canopen_control", "channel": name} for name in list_sockets("bus")]
