"""One request of an SDO client with its server: the tries, the answers and what follows from errors (CiA 301, 7.2.4).

The law:
- An answer counts if its command and its multiplexer are those of the request, and if the request has left: what comes
  before that is the bus's copy of an older answer.
- A request that died (timed out or cancelled) may still be answered: until that is settled, its object is in
  quarantine (sdo_quarantine.py), so that no late answer can be taken for that of the retry.
- A timeout sends an abort with the true multiplexer. How often what is tried again: sdo_request.py. A block transfer
  that the server refuses, or whose CRC is wrong, is done again in segments. Every other abort ends the request.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.cia301.abort import AbortCode, abort_text
from canopen_control.cia301.sdo_client_block import BlockDownload, BlockUpload
from canopen_control.cia301.sdo_client_segmented import SegmentedDownload, SegmentedUpload
from canopen_control.cia301.sdo_codec import (
    ABORT,
    BLOCK_DOWNLOAD_ANSWER,
    BLOCK_UPLOAD_ANSWER,
    COMMAND_MASK,
    CRC_FLAG,
    DONE,
    DOWNLOAD_ANSWER,
    EXPEDITED_LENGTHS,
    IGNORED,
    INITIATE_NUMBER,
    MAX_BLOCK_SIZE,
    NO_MUX,
    PROGRESS,
    SIZED_FLAG,
    UPLOAD,
    UPLOAD_SIZED,
    UPLOAD_UNSIZED,
)
from canopen_control.cia301.sdo_initiate import (
    AWAIT_BLOCK_DOWNLOAD,
    AWAIT_BLOCK_UPLOAD,
    AWAIT_DOWNLOAD,
    AWAIT_NOTHING,
    AWAIT_PROBE,
    AWAIT_UPLOAD,
    BLOCK_ERRORS,
    BLOCK_KINDS,
    completed,
    fitted,
    initiate,
)
from canopen_control.cia301.sdo_quarantine import Quarantine
from canopen_control.cia301.sdo_request import Patience, SdoOptions, SdoRequest
from canopen_control.errors import SdoAbort, SdoTimeout
from canopen_control.frame import CanFrame

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.errors import CanopenError

__all__ = ["SdoExchange"]

_UNARMED: Final = 0  # the deadline of a request whose caller did not say when it is; the next tick does


class _Transfer(Protocol):
    """What follows an initiate that was not expedited."""

    suspect: bool

    @property
    def result(self) -> bytes: ...
    @property
    def progress(self) -> tuple[int, int | None]: ...
    def receive(self, data: bytes, out: list[CanFrame]) -> int: ...
    def nudge(self, out: list[CanFrame]) -> bool: ...


class SdoExchange:
    """The request under way, if there is one; see the law of this file.

    `out` holds what is to be sent and `finished` the requests that ended: both are the client's to take.
    """

    def __init__(self, node_id: int, name: str, retries: int, options: SdoOptions, request_cob_id: int) -> None:
        self.node_id, self.name, self.retries, self.options = node_id, name, retries, options
        self.request_cob_id = request_cob_id
        self.ignored = 0  # frames from the server that belonged to nothing
        self.retried = 0  # tries after the first
        self.block_supported: bool | None = None  # None: not known yet
        self.out: list[CanFrame] = []
        self.finished: list[SdoRequest] = []
        self.active: SdoRequest | None = None
        self.deadline: int | None = None
        self._quarantine = Quarantine()
        self._transfer: _Transfer | None = None
        self._kind = AWAIT_NOTHING
        self._request = b""  # the initiate of this try
        self._mux = b""  # its multiplexer
        self._started: int | None = None  # None: the first frame has not been seen to leave
        self._patience: Patience | None = None  # None: the request has had no trouble yet

    @property
    def progress(self) -> tuple[int, int | None]:
        """How far the transfer under way is, in bytes; see `SdoClient.progress`."""
        transfer = self._transfer
        return (0, None) if transfer is None else transfer.progress

    def start(self, request: SdoRequest, now: int | None) -> None:
        """Begin a request; with `now` None its timeout starts with the next tick."""
        self.active, self._started, self._patience = request, now, None
        self._begin(request, now)

    def receive(self, data: bytes, now: int) -> None:
        """Take the data of a frame from the server; what answers nothing is counted."""
        if len(data) != 8 and not (data := completed(data)):
            self.ignored += 1
        elif data[0] == ABORT:
            self._on_abort(data, now)
        elif self._transfer is not None:
            self._on_transfer(self._transfer, data, now)
        elif data[1:4] != self._mux or self.out:
            self.ignored += 1
        else:
            _ON_INITIATE[self._kind](self, data, now)

    def receive_records(self, records: bytes, start: int, cob_id: int, now: int) -> int:
        """Take a run of a block upload's segments at once; return how many records, 0 if there is none."""
        transfer, request = self._transfer, self.active
        if not isinstance(transfer, BlockUpload) or request is None:
            return 0
        if count := transfer.receive_records(records, start, cob_id, self.out):
            self.deadline = now + request.timeout_ns
        return count

    def tick(self, now: int) -> None:
        """Start the timeout of a request that has left, or act on one that ran out."""
        if self.deadline is not None and now >= self.deadline and self.active is not None:
            self._on_deadline(self.active, now)

    def cancel(self, error: CanopenError) -> None:
        """Give up the request under way without an answer; the server is told if it has heard of it."""
        if (request := self.active) is None:
            return
        if self._kind != AWAIT_NOTHING:  # else it pauses: nothing is under way
            if self.out and self._transfer is None:
                self.out.pop()  # the initiate, which has not left
            else:
                self._die(AbortCode.GENERAL_ERROR)
        self._idle()
        self.report(request, error)

    def report(self, request: SdoRequest, error: CanopenError | None) -> None:
        """End a request."""
        request.error = error
        request.done = True
        self.finished.append(request)

    def forget(self) -> None:
        """Forget what is known of the server: it has booted."""
        self._quarantine.owed.clear()
        self.block_supported = None

    def _finish(self, request: SdoRequest, now: int, error: CanopenError | None = None) -> None:
        request.elapsed_ns = 0 if self._started is None else now - self._started
        self.active = self._transfer = self.deadline = None  # `_idle` and `report`, without the calls
        self._kind, self._mux = AWAIT_NOTHING, b""
        request.error = error
        request.done = True
        self.finished.append(request)

    def _idle(self) -> None:
        self.active = self._transfer = self.deadline = None
        self._kind, self._mux = AWAIT_NOTHING, b""

    # -- one try

    def _begin(self, request: SdoRequest, now: int | None) -> None:
        self._transfer = None
        block = request.block and self.block_supported is not False
        if self._patience is not None and self._patience.plain:
            block = False
        self._kind, data = initiate(request, self.options, block)
        mux = data[1:4]
        if mux in self._quarantine.owed:
            self._kind, data = AWAIT_PROBE, self._quarantine.probe()
            mux = data[1:4]
        self._request, self._mux = data, mux
        self.out.append(CanFrame(self.request_cob_id, data))
        self.deadline = _UNARMED if now is None else now + request.timeout_ns

    # -- answers

    def _on_upload(self, data: bytes, now: int) -> None:
        request = self.active
        if request is None or data[0] & COMMAND_MASK != UPLOAD:
            self.ignored += 1
            return
        if self._quarantine.owed:
            self._quarantine.answered(self._mux)
        if (length := EXPEDITED_LENGTHS.get(data[0])) is not None:
            self._uploaded(request, data[4 : 4 + length], data[0] & 1 == 1, now)
        elif data[0] in (UPLOAD_SIZED, UPLOAD_UNSIZED):
            size = int.from_bytes(data[4:8], "little") if data[0] == UPLOAD_SIZED else None
            self._upload_segments(request, size, now)
        else:  # reserved bits are set, or the length of what is no expedited transfer
            self._break(request, AbortCode.UNKNOWN_COMMAND, now)

    def _upload_segments(self, request: SdoRequest, size: int | None, now: int) -> None:
        limit = self.options.max_size
        if size is not None and size > limit:
            self._break(request, AbortCode.OUT_OF_MEMORY, now)
        else:
            self._proceed(request, SegmentedUpload(self.request_cob_id, size, limit, self.out), now)

    def _proceed(self, request: SdoRequest, transfer: _Transfer, now: int) -> None:
        self._transfer = transfer
        self.deadline = now + request.timeout_ns

    def _on_download(self, data: bytes, now: int) -> None:
        request = self.active
        if request is None or data[0] != DOWNLOAD_ANSWER:
            self.ignored += 1
            return
        self._quarantine.answered(self._mux)
        if self._request[0] & SIZED_FLAG:  # e: the data went with the request
            self._finish(request, now)
        else:
            self._proceed(request, SegmentedDownload(self.request_cob_id, request.data, self.out), now)

    def _on_block_upload(self, data: bytes, now: int) -> None:
        request, command, options = self.active, data[0], self.options
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
        limits = (size, options.max_size, crc, options.block_size)
        self._proceed(request, BlockUpload(self.request_cob_id, *limits, self.out), now)

    def _on_block_download(self, data: bytes, now: int) -> None:
        request, command, block_size = self.active, data[0], data[4]
        if request is None or command & ~CRC_FLAG != BLOCK_DOWNLOAD_ANSWER:
            self.ignored += 1
            return
        self._quarantine.answered(self._mux)
        self.block_supported = True
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            self._break(request, AbortCode.INVALID_BLOCK_SIZE, now)
            return
        crc = bool(command & self._request[0] & CRC_FLAG)
        self._proceed(request, BlockDownload(self.request_cob_id, request.data, crc, block_size, self.out), now)

    def _on_probe(self, data: bytes, now: int) -> None:
        if self.active is None or data[0] & COMMAND_MASK not in (UPLOAD, ABORT):
            self.ignored += 1
            return
        self._quarantine.answered(self._mux)
        self._begin(self.active, now)

    def _on_nothing(self, data: bytes, now: int) -> None:  # noqa: ARG002 - one signature for the whole table
        self.ignored += 1

    def _on_transfer(self, transfer: _Transfer, data: bytes, now: int) -> None:
        outcome = transfer.receive(data, self.out)
        request = self.active
        if outcome == IGNORED or request is None:
            self.ignored += 1
        elif outcome == PROGRESS:
            self.deadline = now + request.timeout_ns
        elif outcome == DONE and not request.is_write:
            self._uploaded(request, transfer.result, True, now)
        elif outcome == DONE:
            self._finish(request, now)
        else:
            self._break(request, outcome, now)

    def _uploaded(self, request: SdoRequest, data: bytes, sized: bool, now: int) -> None:
        code = 0
        if request.size is not None:
            data, code = fitted(data, request.size, sized, self.options.lenient)
        request.data = data
        self._finish(request, now, self._abort_error(request, code) if code else None)

    # -- aborts and errors

    def _on_abort(self, data: bytes, now: int) -> None:
        request = self.active
        if request is None or not self._is_ours(data[1:4]):
            self.ignored += 1
        elif self._kind == AWAIT_PROBE:
            self._on_probe(data, now)
        else:
            if data[1:4] == self._mux:
                self._quarantine.answered(self._mux)
            self._refused(request, int.from_bytes(data[4:8], "little"), now)

    def _is_ours(self, mux: bytes) -> bool:
        if self._transfer is not None:
            return mux in (self._mux, NO_MUX)
        if self.out or self._kind == AWAIT_NOTHING:
            return False
        return mux == self._mux or (mux == NO_MUX and (not self._quarantine.owed or self._kind in BLOCK_KINDS))

    def _refused(self, request: SdoRequest, code: int, now: int) -> None:
        """Decide what follows from an abort, be it the server's or ours."""
        patience = self._trouble()
        if self._kind in BLOCK_KINDS and code in BLOCK_ERRORS:
            if code == AbortCode.UNKNOWN_COMMAND and self._transfer is None:
                self.block_supported = False
            patience.plain = True
            self._again(request, now)
        elif patience.has_try(code):
            self._again(request, now)
        elif (until := patience.pause(code, self.options.busy_ns, now)) is not None:
            self._transfer = None
            self._kind, self._mux, self.deadline = AWAIT_NOTHING, b"", until
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
        if self.deadline == _UNARMED:
            self._started, self.deadline = now, now + request.timeout_ns
        elif self._kind == AWAIT_NOTHING:
            self._again(request, now)
        elif self._transfer is not None and self._transfer.nudge(self.out):
            self.deadline = now + request.timeout_ns
        elif self._transfer is not None and self._transfer.suspect:
            self._die(AbortCode.TOGGLE_NOT_ALTERNATED)
            self._refused(request, AbortCode.TOGGLE_NOT_ALTERNATED, now)
        else:
            self._timed_out(request, now)

    def _timed_out(self, request: SdoRequest, now: int) -> None:
        patience = self._trouble()
        patience.waited_ns += request.timeout_ns
        if self._kind in BLOCK_KINDS:
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
        self.out = [one for one in self.out if one.data[0] == ABORT]  # no segment that nobody wants any more
        self._send_abort(code)

    def _send_abort(self, code: int) -> None:
        _, index, subindex, _ = INITIATE_NUMBER.unpack(self._request)
        self.out.append(CanFrame(self.request_cob_id, INITIATE_NUMBER.pack(ABORT, index, subindex, code)))

    def _abort_error(self, request: SdoRequest, code: int) -> SdoAbort:
        return SdoAbort(self.node_id, request.index, request.subindex, code, abort_text(code), self.name)


_ON_INITIATE: Final[dict[int, Callable[[SdoExchange, bytes, int], None]]] = {
    AWAIT_NOTHING: SdoExchange._on_nothing,  # noqa: SLF001 - the table of this very class
    AWAIT_UPLOAD: SdoExchange._on_upload,  # noqa: SLF001
    AWAIT_DOWNLOAD: SdoExchange._on_download,  # noqa: SLF001
    AWAIT_BLOCK_UPLOAD: SdoExchange._on_block_upload,  # noqa: SLF001
    AWAIT_BLOCK_DOWNLOAD: SdoExchange._on_block_download,  # noqa: SLF001
    AWAIT_PROBE: SdoExchange._on_probe,  # noqa: SLF001
}
