"""The client of one SDO server: any number of callers, one transfer at a time (CiA 301, 7.2.4).

The law:
- A server has one client with one request outstanding; the others wait in the order in which they came.
- An answer counts if its command and its multiplexer are those of the request, and if the request has left: what comes
  before that is the bus's copy of an older answer.
- A request that died (timed out or cancelled) may still be answered: until that is settled, its object is in
  quarantine (sdo_quarantine.py), so that no late answer can be taken for that of the retry.
- A timeout sends an abort with the true multiplexer and is tried again `retries` times. A toggle error starts the
  transfer again at most twice. "Not now" aborts are tried again with growing pauses for `busy_ns`. A block transfer
  that the server refuses, or whose CRC is wrong, is done again in segments. Every other abort ends the request.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.cia301.abort import AbortCode, abort_text
from canopen_control.cia301.sdo_client_block import BlockDownload, BlockUpload
from canopen_control.cia301.sdo_client_segmented import SegmentedDownload, SegmentedUpload
from canopen_control.cia301.sdo_codec import (
    ABORT,
    ANSWER_BASE,
    BLOCK_DOWNLOAD,
    BLOCK_DOWNLOAD_ANSWER,
    BLOCK_UPLOAD,
    BLOCK_UPLOAD_ANSWER,
    COMMAND_MASK,
    CRC_FLAG,
    DONE,
    DOWNLOAD,
    DOWNLOAD_ANSWER,
    EXPEDITED_CODES,
    EXPEDITED_LENGTHS,
    IGNORED,
    INITIATE,
    INITIATE_BYTES,
    INITIATE_NUMBER,
    MAX_BLOCK_SIZE,
    NO_MUX,
    PROGRESS,
    REQUEST_BASE,
    SIZED_FLAG,
    UPLOAD,
    UPLOAD_SIZED,
    UPLOAD_UNSIZED,
)
from canopen_control.cia301.sdo_quarantine import Quarantine
from canopen_control.cia301.sdo_request import Patience, SdoOptions, SdoRequest
from canopen_control.errors import LocalProtocolError, SdoAbort, SdoTimeout
from canopen_control.frame import CanFrame

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.errors import CanopenError

__all__ = ["SdoClient", "SdoOptions", "SdoRequest"]

# What a request waits for.
_IDLE, _UPLOAD, _DOWNLOAD, _BLOCK_UPLOAD, _BLOCK_DOWNLOAD, _PROBE, _PAUSE = range(7)
_UNARMED: Final = 0  # the deadline of a request whose caller did not say when it is; the next tick does
_BLOCK_KINDS: Final = frozenset((_BLOCK_UPLOAD, _BLOCK_DOWNLOAD))
_BLOCK_ERRORS: Final = frozenset(  # what segments may still do: without CRC a lost segment shows in the length
    (
        AbortCode.UNKNOWN_COMMAND,
        AbortCode.INVALID_BLOCK_SIZE,
        AbortCode.INVALID_SEQUENCE_NUMBER,
        AbortCode.CRC_ERROR,
        AbortCode.LENGTH_TOO_HIGH,
        AbortCode.LENGTH_TOO_LOW,
    ),
)


_DEFAULTS: Final = SdoOptions()


class _Transfer(Protocol):
    """What follows an initiate that was not expedited."""

    suspect: bool

    @property
    def result(self) -> bytes: ...
    def receive(self, data: bytes, out: list[CanFrame]) -> int: ...
    def nudge(self, out: list[CanFrame]) -> bool: ...


class SdoClient:
    """The queue of one server and the transfer at its head; see the law of this file.

    `retries` counts the tries after the first. `request_cob_id` and `answer_cob_id` are those of the predefined
    connection set unless given. Raises LocalProtocolError when asked for what no SDO can carry.
    """

    def __init__(
        self,
        node_id: int,
        *,
        timeout_ns: int = 500_000_000,
        retries: int = 1,
        name: str = "",
        options: SdoOptions = _DEFAULTS,
        request_cob_id: int | None = None,
        answer_cob_id: int | None = None,
    ) -> None:
        self.node_id, self.name = node_id, name
        self.timeout_ns, self.retries, self.options = timeout_ns, retries, options
        self.request_cob_id = REQUEST_BASE + node_id if request_cob_id is None else request_cob_id
        self.answer_cob_id = ANSWER_BASE + node_id if answer_cob_id is None else answer_cob_id
        self.ignored = 0  # frames from the server that belonged to nothing
        self.retried = 0  # tries after the first
        self.block_supported: bool | None = None  # None: not known yet
        self._queue: deque[SdoRequest] = deque()
        self._out: list[CanFrame] = []
        self._finished: list[SdoRequest] = []
        self._quarantine = Quarantine()
        self._active: SdoRequest | None = None
        self._transfer: _Transfer | None = None
        self._kind = _IDLE
        self._request = b""  # the initiate of this try
        self._mux = b""  # its multiplexer
        self._deadline: int | None = None
        self._started: int | None = None  # None: the first frame has not been seen to leave
        self._patience: Patience | None = None  # None: the request has had no trouble yet

    # -- what callers ask for

    def read(
        self,
        index: int,
        subindex: int = 0,
        *,
        timeout_ns: int | None = None,
        block: bool | None = None,
        size: int | None = None,
        now: int | None = None,
    ) -> SdoRequest:
        """Upload an object; `data` of the request holds its bytes once it is `done`.

        `size` is the length the caller knows the object to have: an answer of another length is an error, one that
        does not tell its length is cut to it. With `now` the timeout starts at once, else with the next `tick`.
        """
        request = SdoRequest(index, subindex, None, self.timeout_ns if timeout_ns is None else timeout_ns, block, size)
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
        """Download the bytes `data` to an object; the request is `done` when the server has confirmed it."""
        request = SdoRequest(index, subindex, data, self.timeout_ns if timeout_ns is None else timeout_ns, block)
        self._enqueue(request, now)
        return request

    def cancel(self, request: SdoRequest, error: CanopenError) -> None:
        """End one request with `error`; one that is done stays as it is."""
        if request is self._active:
            self._kill_active()
            self._report(request, error)
            self._next(None)
        elif request in self._queue:
            self._queue.remove(request)
            self._report(request, error)

    def cancel_all(self, error: CanopenError) -> None:
        """End every request with `error`, waiting ones too."""
        waiting = list(self._queue)
        self._queue.clear()
        if self._active is not None:
            waiting.insert(0, self._active)
            self._kill_active()
        for request in waiting:
            self._report(request, error)

    def forget(self) -> None:
        """Forget what is known of the server: it has booted, and owes no answers any more."""
        self._quarantine.owed.clear()
        self.block_supported = None

    @property
    def busy(self) -> bool:
        """Whether a request is under way."""
        return self._active is not None

    @property
    def waiting(self) -> int:
        """How many requests wait behind the one under way."""
        return len(self._queue)

    # -- the sans-IO verbs

    def receive(self, frame: CanFrame, now: int) -> None:
        """Take a frame; those of other COB-IDs are not ours, and what answers nothing is counted."""
        can_id, data = frame
        if can_id != self.answer_cob_id:
            return
        if len(data) != 8 and not (data := _completed(data)):
            self.ignored += 1
        elif data[0] == ABORT:
            self._on_abort(data, now)
        elif self._transfer is not None:
            self._on_transfer(self._transfer, data, now)
        elif data[1:4] != self._mux or self._out:
            self.ignored += 1
        else:
            _ON_INITIATE[self._kind](self, data, now)

    def tick(self, now: int) -> None:
        """Let time pass: start the timeout of a request that has left, or act on one that ran out."""
        if self._deadline is not None and now >= self._deadline and self._active is not None:
            self._on_deadline(self._active, now)

    def next_deadline(self) -> int | None:
        """Return when `tick` is due; 0 means at once."""
        return self._deadline

    def frames(self) -> list[CanFrame]:
        """Return what to send, in order."""
        if not (out := self._out):
            return out
        self._out = []
        return out

    def events(self) -> list[SdoRequest]:
        """Return the requests that ended since the last call."""
        if not (finished := self._finished):
            return finished
        self._finished = []
        return finished

    # -- the queue

    def _enqueue(self, request: SdoRequest, now: int | None) -> None:
        if not (0 <= request.index <= 0xFFFF and 0 <= request.subindex <= 0xFF):
            raise LocalProtocolError(f"no object 0x{request.index:X}:{request.subindex:X}: 0xFFFF:FF is the last one")
        if len(request.data) > 0xFFFFFFFF:
            raise LocalProtocolError(f"{len(request.data)} bytes are more than an SDO transfer can announce")
        if self._active is None:
            self._start(request, now)
        else:
            self._queue.append(request)

    def _start(self, request: SdoRequest, now: int | None) -> None:
        self._active, self._started, self._patience = request, now, None
        self._begin(request, now)

    def _next(self, now: int | None) -> None:
        if self._queue:
            self._start(self._queue.popleft(), now)

    def _finish(self, request: SdoRequest, now: int, error: CanopenError | None = None) -> None:
        request.elapsed_ns = 0 if self._started is None else now - self._started
        self._idle()
        self._report(request, error)
        self._next(now)

    def _report(self, request: SdoRequest, error: CanopenError | None) -> None:
        request.error = error
        request.done = True
        self._finished.append(request)

    def _idle(self) -> None:
        self._active = self._transfer = self._deadline = None
        self._kind, self._mux = _IDLE, b""

    def _kill_active(self) -> None:
        """Give up the transfer under way without an answer; the server is told if it has heard of it."""
        if self._out and self._transfer is None:
            self._out.clear()  # the request has not left
        elif self._kind not in (_IDLE, _PAUSE):
            self._die(AbortCode.GENERAL_ERROR)
        self._idle()

    # -- one try

    def _begin(self, request: SdoRequest, now: int | None) -> None:
        self._transfer = None
        self._kind, data = self._initiate(request)
        if data[1:4] in self._quarantine.owed:
            self._kind, data = _PROBE, self._quarantine.probe()
        self._request, self._mux = data, data[1:4]
        self._out.append(CanFrame(self.request_cob_id, data))
        self._deadline = _UNARMED if now is None else now + request.timeout_ns

    def _initiate(self, request: SdoRequest) -> tuple[int, bytes]:
        """Return the kind of transfer and its first frame."""
        index, subindex, data = request.index, request.subindex, request.data
        if request.block is not False and self._wants_block(request):
            return self._initiate_block(request)
        if not request.is_write:
            return _UPLOAD, INITIATE.pack(UPLOAD, index, subindex)
        length, sized = len(data), self.options.announce_size
        if 1 <= length <= 4:
            command = DOWNLOAD | (EXPEDITED_CODES[length] if sized else SIZED_FLAG)
            return _DOWNLOAD, INITIATE_BYTES.pack(command, index, subindex, data)
        return _DOWNLOAD, INITIATE_NUMBER.pack(DOWNLOAD | sized, index, subindex, length if sized else 0)

    def _wants_block(self, request: SdoRequest) -> bool:
        if self.block_supported is False or (self._patience and self._patience.plain):
            return False
        return bool(request.block) or (request.is_write and len(request.data) >= self.options.block_threshold)

    def _initiate_block(self, request: SdoRequest) -> tuple[int, bytes]:
        options, crc = self.options, CRC_FLAG if self.options.crc else 0
        index, subindex = request.index, request.subindex
        if not request.is_write:
            parameters = bytes((options.block_size, options.switch_threshold))
            return _BLOCK_UPLOAD, INITIATE_BYTES.pack(BLOCK_UPLOAD | crc, index, subindex, parameters)
        sized, length = (SIZED_FLAG, len(request.data)) if options.announce_size else (0, 0)
        return _BLOCK_DOWNLOAD, INITIATE_NUMBER.pack(BLOCK_DOWNLOAD | crc | sized, index, subindex, length)

    # -- answers

    def _on_upload(self, data: bytes, now: int) -> None:
        request = self._active
        if request is None or data[0] & COMMAND_MASK != UPLOAD:
            self.ignored += 1
            return
        self._quarantine.answered(self._mux)
        if (length := EXPEDITED_LENGTHS.get(data[0])) is not None:
            self._uploaded(request, data[4 : 4 + length], data[0] & 1 == 1, now)
        elif data[0] in (UPLOAD_SIZED, UPLOAD_UNSIZED):
            size = int.from_bytes(data[4:8], "little") if data[0] == UPLOAD_SIZED else None
            self._upload_segments(request, size, now)
        else:  # reserved bits are set, or the length of what is no expedited transfer
            self._break(request, AbortCode.UNKNOWN_COMMAND, now)

    def _upload_segments(self, request: SdoRequest, size: int | None, now: int) -> None:
        if size is not None and size > self.options.max_size:
            self._break(request, AbortCode.OUT_OF_MEMORY, now)
            return
        self._transfer = SegmentedUpload(self.request_cob_id, size, self.options.max_size, self._out)
        self._deadline = now + request.timeout_ns

    def _on_download(self, data: bytes, now: int) -> None:
        request = self._active
        if request is None or data[0] != DOWNLOAD_ANSWER:
            self.ignored += 1
            return
        self._quarantine.answered(self._mux)
        if self._request[0] & SIZED_FLAG:  # e: the data went with the request
            self._finish(request, now)
        else:
            self._transfer = SegmentedDownload(self.request_cob_id, request.data, self._out)
            self._deadline = now + request.timeout_ns

    def _on_block_upload(self, data: bytes, now: int) -> None:
        request, command, options = self._active, data[0], self.options
        if request is None or command & ~(CRC_FLAG | SIZED_FLAG) != BLOCK_UPLOAD_ANSWER:
            self._on_upload(data, now)  # the protocol switch: it answers as if plainly asked
            return
        self._quarantine.answered(self._mux)
        self.block_supported = True
        size = int.from_bytes(data[4:8], "little") if command & SIZED_FLAG else None
        if size is not None and size > options.max_size:
            self._break(request, AbortCode.OUT_OF_MEMORY, now)
            return
        crc = bool(command & self._request[0] & CRC_FLAG)
        self._transfer = BlockUpload(self.request_cob_id, size, options.max_size, crc, options.block_size, self._out)
        self._deadline = now + request.timeout_ns

    def _on_block_download(self, data: bytes, now: int) -> None:
        request, command, block_size = self._active, data[0], data[4]
        if request is None or command & ~CRC_FLAG != BLOCK_DOWNLOAD_ANSWER:
            self.ignored += 1
            return
        self._quarantine.answered(self._mux)
        self.block_supported = True
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            self._break(request, AbortCode.INVALID_BLOCK_SIZE, now)
            return
        crc = bool(command & self._request[0] & CRC_FLAG)
        self._transfer = BlockDownload(self.request_cob_id, request.data, crc, block_size, self._out)
        self._deadline = now + request.timeout_ns

    def _on_probe(self, data: bytes, now: int) -> None:
        if self._active is None or data[0] & COMMAND_MASK not in (UPLOAD, ABORT):
            self.ignored += 1
            return
        self._quarantine.answered(self._mux)
        self._begin(self._active, now)

    def _on_nothing(self, data: bytes, now: int) -> None:  # noqa: ARG002 - one signature for the whole table
        self.ignored += 1

    def _on_transfer(self, transfer: _Transfer, data: bytes, now: int) -> None:
        outcome = transfer.receive(data, self._out)
        request = self._active
        if outcome == IGNORED or request is None:
            self.ignored += 1
        elif outcome == PROGRESS:
            self._deadline = now + request.timeout_ns
        elif outcome == DONE and not request.is_write:
            self._uploaded(request, transfer.result, True, now)
        elif outcome == DONE:
            self._finish(request, now)
        else:
            self._break(request, outcome, now)

    def _uploaded(self, request: SdoRequest, data: bytes, sized: bool, now: int) -> None:
        size = request.size
        if size is not None and len(data) != size:
            if len(data) > size and not sized:
                data = data[:size]
            elif len(data) < size and self.options.lenient:
                data = data.ljust(size, b"\0")
            else:
                code = AbortCode.LENGTH_TOO_HIGH if len(data) > size else AbortCode.LENGTH_TOO_LOW
                self._finish(request, now, self._abort_error(request, code))
                return
        request.data = data
        self._finish(request, now)

    # -- aborts and errors

    def _on_abort(self, data: bytes, now: int) -> None:
        request = self._active
        if request is None or not self._is_ours(data[1:4]):
            self.ignored += 1
        elif self._kind == _PROBE:
            self._on_probe(data, now)
        else:
            if data[1:4] == self._mux:
                self._quarantine.answered(self._mux)
            self._refused(request, int.from_bytes(data[4:8], "little"), now)

    def _is_ours(self, mux: bytes) -> bool:
        if self._transfer is not None:
            return mux in (self._mux, NO_MUX)
        if self._out or self._kind == _PAUSE:
            return False
        return mux == self._mux or (mux == NO_MUX and (not self._quarantine.owed or self._kind in _BLOCK_KINDS))

    def _refused(self, request: SdoRequest, code: int, now: int) -> None:
        """Decide what follows from an abort, be it the server's or ours."""
        patience = self._trouble()
        if self._kind in _BLOCK_KINDS and code in _BLOCK_ERRORS:
            if code == AbortCode.UNKNOWN_COMMAND and self._transfer is None:
                self.block_supported = False
            patience.plain = True
            self._again(request, now)
        elif patience.has_try(code):
            self._again(request, now)
        elif (until := patience.pause(code, self.options.busy_ns, now)) is not None:
            self._transfer = None
            self._kind, self._mux, self._deadline = _PAUSE, b"", until
        else:
            self._finish(request, now, self._abort_error(request, code))

    def _trouble(self) -> Patience:
        if self._patience is None:
            self._patience = Patience(self.retries)
        return self._patience

    def _again(self, request: SdoRequest, now: int) -> None:
        self.retried += 1
        self._begin(request, now)

    def _break(self, request: SdoRequest, code: int, now: int) -> None:
        """Abort the transfer because of what the server sent."""
        self._send_abort(code)
        if code == AbortCode.OUT_OF_MEMORY:  # our own limit: no pause makes it larger
            self._finish(request, now, self._abort_error(request, code))
        else:
            self._refused(request, code, now)

    def _on_deadline(self, request: SdoRequest, now: int) -> None:
        if self._deadline == _UNARMED:
            self._started, self._deadline = now, now + request.timeout_ns
        elif self._kind == _PAUSE:
            self._again(request, now)
        elif self._transfer is not None and self._transfer.nudge(self._out):
            self._deadline = now + request.timeout_ns
        elif self._transfer is not None and self._transfer.suspect:
            self._break(request, AbortCode.TOGGLE_NOT_ALTERNATED, now)
        else:
            self._timed_out(request, now)

    def _timed_out(self, request: SdoRequest, now: int) -> None:
        patience = self._trouble()
        patience.waited_ns += request.timeout_ns
        if self._kind in _BLOCK_KINDS:
            patience.plain = True  # some servers do not answer what they do not know
        self._die(AbortCode.TIMED_OUT)
        if patience.has_try(AbortCode.TIMED_OUT):
            self._again(request, now)
        else:
            seconds = patience.waited_ns / 1e9
            self._finish(request, now, SdoTimeout(self.node_id, request.index, request.subindex, seconds, self.name))

    def _die(self, code: int) -> None:
        """Abort a transfer whose last answer is still owed."""
        self._quarantine.died(self._mux)
        self._out.clear()
        self._send_abort(code)

    def _send_abort(self, code: int) -> None:
        _, index, subindex, _ = INITIATE_NUMBER.unpack(self._request)
        self._out.append(CanFrame(self.request_cob_id, INITIATE_NUMBER.pack(ABORT, index, subindex, code)))

    def _abort_error(self, request: SdoRequest, code: int) -> SdoAbort:
        return SdoAbort(self.node_id, request.index, request.subindex, code, abort_text(code), self.name)


def _completed(data: bytes) -> bytes:
    """Fill up a frame that some servers cut behind its last used byte; empty if it lacks a byte that counts."""
    if len(data) < 4 or len(data) > 8:
        return b""
    needed = 4 + (8 if data[0] == ABORT else EXPEDITED_LENGTHS.get(data[0], 0 if data[0] == DOWNLOAD_ANSWER else 8))
    return data.ljust(8, b"\0") if len(data) >= needed else b""


_ON_INITIATE: Final[dict[int, Callable[[SdoClient, bytes, int], None]]] = {
    _IDLE: SdoClient._on_nothing,  # noqa: SLF001 - the table of this very class
    _UPLOAD: SdoClient._on_upload,  # noqa: SLF001
    _DOWNLOAD: SdoClient._on_download,  # noqa: SLF001
    _BLOCK_UPLOAD: SdoClient._on_block_upload,  # noqa: SLF001
    _BLOCK_DOWNLOAD: SdoClient._on_block_download,  # noqa: SLF001
    _PROBE: SdoClient._on_probe,  # noqa: SLF001
    _PAUSE: SdoClient._on_nothing,  # noqa: SLF001
}
