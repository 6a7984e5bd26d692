"""The client of one SDO server: any number of callers, one request at a time (CiA 301, 7.2.4).

The law: a server has one client with one request outstanding; the others wait in the order in which they came, each
with a timeout that starts when its own first frame leaves. What an answer is and what follows from errors is the
exchange's affair (sdo_exchange.py).
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.sdo_codec import ANSWER_BASE, REQUEST_BASE
from canopen_control.cia301.sdo_exchange import SdoExchange
from canopen_control.cia301.sdo_phases import first_phase
from canopen_control.cia301.sdo_request import SdoOptions, SdoRequest
from canopen_control.errors import LocalProtocolError, SdoRestarted

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.errors import CanopenError
    from canopen_control.frame import CanFrame
    from canopen_control.od.model import Entry

__all__ = ["SdoClient", "SdoOptions", "SdoRequest"]

_DEFAULTS: Final = SdoOptions()


class SdoClient:
    """The queue of one server, and the exchange that works it off.

    `timeout_ns` is what every single answer may take, `retries` counts the tries after the first, `name` is the node's
    in messages. `request_cob_id` and `answer_cob_id` are those of the predefined connection set unless given.
    `entry_of` finds an object in the node's dictionary: an upload of what is known there has the length of its type, or
    is an SdoLengthError. Raises LocalProtocolError when asked for what no SDO can carry.
    """

    def __init__(
        self,
        node_id: int,
        *,
        timeout_ns: int = 500_000_000,
        retries: int = 1,
        name: str = "",
        options: SdoOptions = _DEFAULTS,
        entry_of: Callable[[int, int], Entry | None] | None = None,
        request_cob_id: int | None = None,
        answer_cob_id: int | None = None,
    ) -> None:
        self.node_id, self.name = node_id, name
        self.timeout_ns = timeout_ns
        self.answer_cob_id = ANSWER_BASE + node_id if answer_cob_id is None else answer_cob_id
        self.request_cob_id = REQUEST_BASE + node_id if request_cob_id is None else request_cob_id
        self._queue: deque[SdoRequest] = deque()
        self._exchange = SdoExchange(node_id, name, retries, options, self.request_cob_id, first_phase)
        self._exchange.entry_of = entry_of

    # -- what callers ask for

    def read(
        self,
        index: int,
        subindex: int = 0,
        *,
        timeout_ns: int | None = None,
        block: bool | None = None,
        now: int | None = None,
    ) -> SdoRequest:
        """Upload an object; `data` of the request holds its bytes once it is `done`.

        Block transfer is used if `block` is True. With `now` the timeout starts at once, else with the next `tick`.
        """
        timeout = self.timeout_ns if timeout_ns is None else timeout_ns
        request = SdoRequest(index, subindex, None, timeout, block is True)
        self._enqueue(request, now)
        return request

    def write(
        self,
        index: int,
        subindex: int,
        data: bytes,
        *,
        timeout_ns: int | None = None,
        block: bool | None = None,
        now: int | None = None,
    ) -> SdoRequest:
        """Download the bytes `data` to an object; the request is `done` when the server has confirmed it.

        Where the caller does not choose with `block`, the length decides (see SdoOptions).
        """
        timeout = self.timeout_ns if timeout_ns is None else timeout_ns
        blocks = len(data) >= self._exchange.options.block_threshold if block is None else block
        request = SdoRequest(index, subindex, bytes(data), timeout, blocks)
        self._enqueue(request, now)
        return request

    def cancel(self, request: SdoRequest, error: CanopenError) -> None:
        """End one request with `error`; one that is done stays as it is."""
        if request is self._exchange.active:
            self._exchange.cancel(error)
            self._next(None)
        elif request in self._queue:
            self._queue.remove(request)
            self._exchange.report(request, error)

    def cancel_all(self, error: CanopenError) -> None:
        """End every request with `error`, waiting ones too."""
        self._exchange.cancel(error)
        while self._queue:
            self._exchange.report(self._queue.popleft(), error)

    def forget(self) -> None:
        """Forget what is known of the server, which has booted: it owes no answers, and a transfer's data are lost."""
        active = self._exchange.active
        if active is not None and self._exchange.phase.transfer is not None:
            self.cancel(active, SdoRestarted(self.node_id, active.index, active.subindex, self.name))
        self._exchange.forget()

    @property
    def busy(self) -> bool:
        """Whether a request is under way."""
        return self._exchange.active is not None

    @property
    def waiting(self) -> int:
        """How many requests wait behind the one under way."""
        return len(self._queue)

    @property
    def ignored(self) -> int:
        """How many frames of the server belonged to nothing: late, doubled, malformed, or about another object."""
        return self._exchange.ignored

    @property
    def retried(self) -> int:
        """How many tries were made after the first."""
        return self._exchange.retried

    @property
    def progress(self) -> tuple[int, int | None]:
        """Bytes of the transfer under way that are over, and how many there are; (0, None) while nobody knows.

        Made for who watches from another thread: a number that is a moment old.
        """
        return self._exchange.progress

    @property
    def block_supported(self) -> bool | None:
        """Whether the server knows block transfer; None if it has not been asked yet."""
        return self._exchange.block_supported

    # -- the sans-IO verbs

    def receive(self, frame: CanFrame, now: int) -> None:
        """Take a frame; those of other COB-IDs are not ours."""
        can_id, data = frame
        if can_id == self.answer_cob_id:
            self._exchange.receive(data, now)
            if self._queue:
                self._next(now)

    def receive_records(self, records: bytes, start: int, now: int) -> int:
        """Take what of the records from byte `start` on may be taken at once, as if each had been received.

        Return how many records that were. 0 is no refusal: the first of them is for `receive`.
        """
        return self._exchange.receive_records(records, start, self.answer_cob_id, now)

    def tick(self, now: int) -> None:
        """Let time pass: start the timeout of a request that has left, or act on one that ran out."""
        self._exchange.tick(now)
        if self._queue:
            self._next(now)

    def next_deadline(self) -> int | None:
        """Return when `tick` is due; 0 means at once."""
        return self._exchange.deadline

    def frames(self) -> list[CanFrame]:
        """Return what to send, in order."""
        if not (out := self._exchange.out):
            return []  # never our own list: callers extend what they get
        self._exchange.out = []
        return out

    def events(self) -> list[SdoRequest]:
        """Return the requests that ended since the last call."""
        if not (finished := self._exchange.finished):
            return []
        self._exchange.finished = []
        return finished

    # -- the queue

    def _enqueue(self, request: SdoRequest, now: int | None) -> None:
        if not (0 <= request.index <= 0xFFFF and 0 <= request.subindex <= 0xFF):
            raise LocalProtocolError(f"no object 0x{request.index:X}:{request.subindex:X}: 0xFFFF:FF is the last one")
        if len(request.data) > 0xFFFFFFFF:
            raise LocalProtocolError(f"{len(request.data)} bytes are more than an SDO transfer can announce")
        if self._exchange.active is None:
            self._exchange.start(request, now)
        else:
            self._queue.append(request)

    def _next(self, now: int | None) -> None:
        if self._queue and self._exchange.active is None:
            self._exchange.start(self._queue.popleft(), now)
