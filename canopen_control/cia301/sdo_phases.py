"""The phases of an SDO request: what a frame, an abort or a timeout means while each of them lasts (CiA 301, 7.2.4).

The law of this file: an answer counts if its command and its multiplexer are those of the request, and if the request
has left: what comes before that is the bus's copy of an older answer. There is one phase for each kind of first frame,
and one for the rest of a transfer; what follows from what they find is decided in sdo_exchange.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia301.abort import AbortCode
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
    MAX_BLOCK_SIZE,
    NO_MUX,
    PROGRESS,
    SIZED_FLAG,
    UPLOAD,
    UPLOAD_SIZED,
    UPLOAD_UNSIZED,
)
from canopen_control.cia301.sdo_exchange import Phase
from canopen_control.cia301.sdo_initiate import initiate, initiate_block

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_exchange import SdoExchange, Transfer
    from canopen_control.cia301.sdo_request import SdoRequest

__all__ = [
    "AwaitingBlockDownload",
    "AwaitingBlockUpload",
    "AwaitingDownload",
    "AwaitingUpload",
    "Probing",
    "Transferring",
    "first_phase",
]


class Awaiting(Phase):
    """The first frame is on its way, and the answer is due; what is one, the phases derived from this know."""

    def receive(self, exchange: SdoExchange, data: bytes, now: int) -> None:
        """Take an answer to this request alone, and not before the request has left."""
        request = exchange.active
        if data[1:4] != exchange.mux or exchange.out or request is None:
            exchange.ignored += 1
        else:
            self.answered(exchange, request, data, now)

    def answered(self, exchange: SdoExchange, request: SdoRequest, data: bytes, now: int) -> None:
        """Take a frame with the multiplexer of the request."""
        raise NotImplementedError

    def concerns(self, exchange: SdoExchange, mux: bytes) -> bool:
        """Whether the abort is about it: some servers name no object when they do not know a command."""
        if exchange.out:
            return False
        return mux == exchange.mux or (mux == NO_MUX and (self.block or not exchange.quarantine.owed))

    def time_out(self, exchange: SdoExchange, request: SdoRequest, now: int) -> None:
        """Give this try up."""
        exchange.timed_out(request, now)

    def abandon(self, exchange: SdoExchange) -> None:
        """Take the first frame back, or abort what has left."""
        if exchange.out:
            exchange.out.pop()
        else:
            exchange.die(AbortCode.GENERAL_ERROR)


class AwaitingUpload(Awaiting):
    """An upload was asked for: the answer has the data (expedited), or announces segments."""

    def answered(self, exchange: SdoExchange, request: SdoRequest, data: bytes, now: int) -> None:
        """Finish an expedited upload, or go on with segments."""
        if data[0] & COMMAND_MASK != UPLOAD:
            exchange.ignored += 1
            return
        if exchange.quarantine.owed:
            exchange.quarantine.answered(exchange.mux)
        if (length := EXPEDITED_LENGTHS.get(data[0])) is not None:
            exchange.uploaded(request, data[4 : 4 + length], data[0] & 1 == 1, now)
        elif data[0] in (UPLOAD_SIZED, UPLOAD_UNSIZED):
            size, limit = _size(data, data[0] == UPLOAD_SIZED), exchange.options.max_size
            if exchange.has_room(request, size, now):
                transfer = SegmentedUpload(exchange.request_cob_id, size, limit, exchange.out)
                exchange.proceed(request, Transferring(transfer, self.block), now)
        else:  # reserved bits are set, or the length of what is no expedited transfer
            exchange.give_up(request, AbortCode.UNKNOWN_COMMAND, now)


class AwaitingBlockUpload(AwaitingUpload):
    """A block upload was asked for; the server may switch and answer as if plainly asked."""

    def answered(self, exchange: SdoExchange, request: SdoRequest, data: bytes, now: int) -> None:
        """Go on in blocks."""
        command, options = data[0], exchange.options
        if command & ~(CRC_FLAG | SIZED_FLAG) != BLOCK_UPLOAD_ANSWER:
            super().answered(exchange, request, data, now)
            return
        exchange.quarantine.answered(exchange.mux)
        exchange.block_supported = True
        size = _size(data, bool(command & SIZED_FLAG))
        if exchange.has_room(request, size, now):
            limits = (size, options.max_size, bool(command & exchange.first[0] & CRC_FLAG), options.block_size)
            transfer = BlockUpload(exchange.request_cob_id, *limits, exchange.out)
            exchange.proceed(request, Transferring(transfer, block=True), now)


class AwaitingDownload(Awaiting):
    """A download was announced: its data went with it (expedited), or follow in segments."""

    def answered(self, exchange: SdoExchange, request: SdoRequest, data: bytes, now: int) -> None:
        """Finish an expedited download, or go on with segments."""
        if data[0] != DOWNLOAD_ANSWER:
            exchange.ignored += 1
            return
        exchange.quarantine.answered(exchange.mux)
        if exchange.first[0] & SIZED_FLAG:  # e: the data went with the request
            exchange.finish(request, now)
        else:
            transfer = SegmentedDownload(exchange.request_cob_id, request.data, exchange.out)
            exchange.proceed(request, Transferring(transfer, block=False), now)


class AwaitingBlockDownload(Awaiting):
    """A block download was announced."""

    def answered(self, exchange: SdoExchange, request: SdoRequest, data: bytes, now: int) -> None:
        """Go on in blocks of the size that the server asks for."""
        command, block_size = data[0], data[4]
        if command & ~CRC_FLAG != BLOCK_DOWNLOAD_ANSWER:
            exchange.ignored += 1
            return
        exchange.quarantine.answered(exchange.mux)
        exchange.block_supported = True
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            exchange.give_up(request, AbortCode.INVALID_BLOCK_SIZE, now)
            return
        crc = bool(command & exchange.first[0] & CRC_FLAG)
        transfer = BlockDownload(exchange.request_cob_id, request.data, crc, block_size, exchange.out)
        exchange.proceed(request, Transferring(transfer, block=True), now)


class Probing(Awaiting):
    """Another object is read first, so that no late answer can be taken for this request's (sdo_quarantine.py)."""

    def answered(self, exchange: SdoExchange, request: SdoRequest, data: bytes, now: int) -> None:
        """Begin the request itself: whatever the answer says, it settles what was owed."""
        if data[0] & COMMAND_MASK not in (UPLOAD, ABORT):
            exchange.ignored += 1
            return
        exchange.quarantine.answered(exchange.mux)
        exchange.begin(request, now)

    def aborted(self, exchange: SdoExchange, request: SdoRequest, data: bytes, now: int) -> None:
        """Take an abort as an answer."""
        self.answered(exchange, request, data, now)


class Transferring(Phase):
    """Segments or blocks are exchanged."""

    def __init__(self, transfer: Transfer, block: bool) -> None:
        self.block, self.transfer, self.rest = block, transfer, transfer

    def receive(self, exchange: SdoExchange, data: bytes, now: int) -> None:
        """Hand a frame to the transfer, and end the request when it is done."""
        outcome = self.rest.receive(data, exchange.out)
        request = exchange.active
        if outcome == PROGRESS and request is not None:
            exchange.deadline = now + request.timeout_ns
        elif outcome == IGNORED or request is None:
            exchange.ignored += 1
        elif outcome == DONE and not request.is_write:
            exchange.uploaded(request, self.rest.result, True, now)
        elif outcome == DONE:
            exchange.finish(request, now)
        else:
            exchange.give_up(request, outcome, now)

    def concerns(self, exchange: SdoExchange, mux: bytes) -> bool:
        """Whether the abort is about it: named, or nothing."""
        return mux in (exchange.mux, NO_MUX)

    def time_out(self, exchange: SdoExchange, request: SdoRequest, now: int) -> None:
        """Let the transfer ask again where it can, else give this try up."""
        if self.rest.nudge(exchange.out):
            exchange.deadline = now + request.timeout_ns
        elif self.rest.suspect:
            exchange.die(AbortCode.TOGGLE_NOT_ALTERNATED)
            exchange.refused(request, AbortCode.TOGGLE_NOT_ALTERNATED, now)
        else:
            exchange.timed_out(request, now)

    def abandon(self, exchange: SdoExchange) -> None:
        """Abort it."""
        exchange.die(AbortCode.GENERAL_ERROR)


def _size(data: bytes, told: bool) -> int | None:
    return int.from_bytes(data[4:8], "little") if told else None


_UPLOAD: Final = AwaitingUpload()
_DOWNLOAD: Final = AwaitingDownload()
_BLOCK_UPLOAD: Final = AwaitingBlockUpload(block=True)
_BLOCK_DOWNLOAD: Final = AwaitingBlockDownload(block=True)
_PROBING: Final = Probing()


def first_phase(exchange: SdoExchange, request: SdoRequest) -> tuple[Phase, bytes]:
    """Return what a try waits for first, and its first frame: the request's, or that of another object before it."""
    if request.block and exchange.tries_blocks:
        phase: Phase = _BLOCK_DOWNLOAD if request.is_write else _BLOCK_UPLOAD
        data = initiate_block(request, exchange.options)
    else:
        phase = _DOWNLOAD if request.is_write else _UPLOAD
        data = initiate(request, exchange.options)
    if data[1:4] in exchange.quarantine.owed:
        return _PROBING, exchange.quarantine.probe()
    return phase, data
