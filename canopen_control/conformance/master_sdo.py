"""Checks of a master's SDO client, based on its requests to one device (CiA 301, 7.2.4.3).

The observer decodes the transfers, and passes writes and reads to `TransferListener`s.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from canopen_control.cia301.abort import AbortCode, abort_text
from canopen_control.cia301.sdo_codec import (
    ABORT,
    ANSWER_BASE,
    BLOCK_DOWNLOAD,
    BLOCK_UPLOAD,
    COMMAND_MASK,
    DOWNLOAD,
    LAST_FLAG,
    REQUEST_BASE,
    SEGMENT,
    SEGMENT_DATA,
    TOGGLE,
    UPLOAD,
    UPLOAD_SEGMENT,
)
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.conformance.master_checks import MS, MasterObserver, S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.conformance.master_checks import MasterFindings
    from canopen_control.frame import CanFrame
    from canopen_control.virtual.virtual_node import VirtualNode


OVERLAP_NS = 20 * MS  # a request that follows another one earlier was sent without waiting for the answer
_HANG_NS = 10 * S
_MAX_REQUESTS = 20  # maximum number of unanswered requests per second
_PROTOCOL_ERRORS = frozenset((0x05030000, 0x05040001, 0x05040002, 0x05040003, 0x05040004))
_MISSING = frozenset((AbortCode.NO_OBJECT, AbortCode.NO_SUBINDEX, AbortCode.READ_ONLY))
_BLOCK_ACK, _BLOCK_END = 2, 1  # sub-commands
_INITIATES = {DOWNLOAD: "download", UPLOAD: "upload", BLOCK_DOWNLOAD: "block download", BLOCK_UPLOAD: "block upload"}
Mux = tuple[int, int]


class TransferListener(Protocol):
    """Receiver of decoded SDO transfers."""

    def reading(self, mux: Mux) -> None:
        """Handle the start of an upload."""

    def writing(self, mux: Mux, data: bytes) -> None:
        """Handle the complete data of a download, before the device processes them."""

    def written(self, mux: Mux, code: int | None) -> None:
        """Handle the end of a download; `code` is the abort code, or None after a confirmation."""


@dataclass(slots=True)
class MasterTransfer:
    """Transfer in progress; `requested_at` is the time of the last request, `answered` whether the device responded."""

    kind: str
    mux: Mux
    requested_at: int
    answered: bool = False
    toggle: int = 0
    size: int | None = None
    data: bytearray = field(default_factory=bytearray)
    last: bool = False
    in_block: bool = False  # in a sub-block of a download, whose segments are not answered
    count: int = 0  # segments of the present sub-block
    begun: bool = False  # the device has answered the initiation
    stale: bool = False  # an answer for another object was received since the request


def name_of(mux: Mux) -> str:
    """Return the address of an object as text, such as "0x1018:01"."""
    return f"0x{mux[0]:04X}:{mux[1]:02X}"


class SdoObserver(MasterObserver):
    """Observer of SDO requests; `requests` counts them, `listeners` receive the decoded transfers."""

    def __init__(self, node: VirtualNode, findings: MasterFindings, listeners: Sequence[TransferListener] = ()) -> None:
        super().__init__(node, findings)
        self.listeners = listeners
        self.requests = 0
        self._transfer: MasterTransfer | None = None
        self._aborted: Mux | None = None  # object of the last transfer that the device aborted
        self._unanswered: list[int] = []  # times of requests in the last second, without an answer

    # -- requests

    def receive(self, frame: CanFrame, now: int) -> None:
        if frame.can_id != REQUEST_BASE + self.node.node_id:
            return
        self.requests += 1
        expect, data = self.findings.expect, frame.data
        expect(len(data) == 8, "MT02", f"{len(data)} bytes: {data.hex(' ').upper()}")
        if len(data) != 8:
            return
        transfer = self._transfer
        if transfer is not None and transfer.in_block and data[0] != ABORT:
            self._block_segment(transfer, data, now)
            return
        self._count(now)
        command = data[0] & COMMAND_MASK
        if data[0] == ABORT:
            self._abort(transfer, int.from_bytes(data[4:], "little"))
        elif command in _INITIATES and self._is_initiate(data):
            self._initiate(_INITIATES[command], data, now)
        elif command in (SEGMENT, UPLOAD_SEGMENT):
            self._segment(data, now, upload=command == UPLOAD_SEGMENT)
        elif command in (BLOCK_DOWNLOAD, BLOCK_UPLOAD):
            self._block(transfer, data, now)
        else:
            expect(False, "MT11", f"command specifier {data[0]:02X}")

    @staticmethod
    def _is_initiate(data: bytes) -> bool:
        sub_commands = {BLOCK_DOWNLOAD: 1, BLOCK_UPLOAD: 3}
        return not data[0] & sub_commands.get(data[0] & COMMAND_MASK, 0)

    def _count(self, now: int) -> None:
        self._unanswered = [time for time in self._unanswered if now - time < S]
        self._unanswered.append(now)
        if (
            self._transfer is not None
            and now - self._transfer.requested_at > OVERLAP_NS
            and not self._transfer.answered
        ):
            count = len(self._unanswered)
            self.findings.expect(count <= _MAX_REQUESTS, "MT09", f"{count} requests in a second without an answer")

    def _abort(self, transfer: MasterTransfer | None, code: int) -> None:
        if transfer is None:
            return
        if not transfer.answered:
            self.findings.expect(True, "MT05", "")
            self.findings.expect(True, "MT08", "")
        self._end(transfer, code)

    def _initiate(self, kind: str, data: bytes, now: int) -> None:
        mux = int.from_bytes(data[1:3], "little"), data[3]
        if self._transfer is not None:
            self._abandoned(self._transfer, mux, now)
        expect = self.findings.expect
        expect(True, "MT01", "")
        expect(True, "MT11", "")
        transfer = self._transfer = MasterTransfer(kind, mux, now)
        if kind == "upload":
            self._zeros(data[:1], 0x1F, data[4:])
        elif kind == "download":
            self._initiate_download(transfer, data)
        if "upload" in kind:
            for listener in self.listeners:
                listener.reading(mux)

    def _abandoned(self, transfer: MasterTransfer, mux: Mux, now: int) -> None:
        """Check a transfer that is replaced by another transfer before its end."""
        gap, which = now - transfer.requested_at, f"{transfer.kind} of {name_of(transfer.mux)}"
        if not transfer.answered and transfer.stale:
            good = mux == transfer.mux or gap > 2 * S
            self.findings.expect(
                good, "MT10", f"{name_of(mux)} was requested after an answer to another request than the {which}"
            )
        elif not transfer.answered and gap >= OVERLAP_NS:
            self.findings.expect(False, "MT05", f"another request {gap / MS:.0f} ms after the {which} without an abort")
            self.findings.expect(True, "MT08", "")
        else:
            self.findings.expect(False, "MT01", f"{name_of(mux)} was requested {gap / MS:.1f} ms after the {which}")
        self._end(transfer, AbortCode.TIMED_OUT)

    def _initiate_download(self, transfer: MasterTransfer, data: bytes) -> None:
        unused, expedited, sized = data[0] >> 2 & 3, data[0] & 2, data[0] & 1
        mask = 0x10 if expedited and sized else 0x1C
        if not expedited:
            self._zeros(data[:1], mask)
            transfer.size = int.from_bytes(data[4:], "little") if sized else None
            return
        length = 4 - unused if sized else 4
        self._zeros(data[:1], mask, data[4 + length :])
        transfer.data += data[4 : 4 + length]
        transfer.last = True
        self._whole(transfer, sized=bool(sized))

    def _whole(self, transfer: MasterTransfer, *, sized: bool = True) -> None:
        """Check the size of a complete download, and pass the data to the listeners."""
        try:
            size = self.node.store.size_of(*transfer.mux)
        except SdoServerAbort:
            size = None
        length = len(transfer.data)
        if not sized and size is not None and size <= length:
            length = size
            del transfer.data[size:]
        text = f"{length} bytes for {name_of(transfer.mux)}"
        self.findings.expect(size in (None, length), "MT04", f"{text}, which has {size}")
        if transfer.size is not None:
            self.findings.expect(transfer.size == length, "MT04", f"{text}, announced as {transfer.size}")
        for listener in self.listeners:
            listener.writing(transfer.mux, bytes(transfer.data))

    def _segment(self, data: bytes, now: int, *, upload: bool) -> None:
        transfer, expect = self._transfer, self.findings.expect
        if transfer is None or (transfer.kind == "upload") != upload or "block" in transfer.kind:
            if self._aborted is not None:
                expect(False, "MT07", f"a segment ({data[0]:02X}) after the abort of {name_of(self._aborted)}")
            else:
                expect(False, "MT11", f"a segment ({data[0]:02X}) without its transfer")
            return
        expect(transfer.answered, "MT01", f"a segment of {name_of(transfer.mux)} before the answer")
        expect(data[0] & TOGGLE == transfer.toggle, "MT03", f"toggle bit of {data[0]:02X} at {name_of(transfer.mux)}")
        transfer.toggle ^= TOGGLE
        transfer.requested_at, transfer.answered = now, False
        if upload:
            self._zeros(data[:1], 0x0F, data[1:])
            return
        length = SEGMENT_DATA - (data[0] >> 1 & 7)
        self._zeros(b"\0", 0, data[1 + length :])
        transfer.data += data[1 : 1 + length]
        transfer.last = bool(data[0] & 1)
        if transfer.last:
            self._whole(transfer)

    def _block(self, transfer: MasterTransfer | None, data: bytes, now: int) -> None:
        """Check a subcommand of a block transfer, except for its parameters, which the device checks."""
        if transfer is None or "block" not in transfer.kind:
            self.findings.expect(False, "MT11", f"command specifier {data[0]:02X} without its block transfer")
            return
        transfer.requested_at, transfer.answered = now, False
        if transfer.kind == "block download":  # its end: the unused bytes of the last segment
            unused = data[0] >> 2 & 7
            del transfer.data[len(transfer.data) - unused :]
            self._whole(transfer)
        elif data[0] & 3 == _BLOCK_END:
            self._end(transfer, None)

    def _block_segment(self, transfer: MasterTransfer, data: bytes, now: int) -> None:
        transfer.data += data[1:]
        transfer.count += 1
        transfer.requested_at, transfer.answered = now, False
        if data[0] & LAST_FLAG:
            transfer.last, transfer.in_block = True, False

    def _zeros(self, first: bytes, mask: int, rest: bytes = b"") -> None:
        good = not first[0] & mask and not any(rest)
        self.findings.expect(
            good, "MT06", f"{first.hex().upper()}, with {rest.hex(' ').upper() or 'no byte'} in reserved bytes"
        )

    # -- answers

    def sent(self, frame: CanFrame) -> None:
        transfer = self._transfer
        if frame.can_id != ANSWER_BASE + self.node.node_id or len(frame.data) != 8 or frame.is_remote:
            return
        self._unanswered.clear()
        data = frame.data
        mux = int.from_bytes(data[1:3], "little"), data[3]
        if data[0] == ABORT:
            self._refused(transfer, mux, int.from_bytes(data[4:], "little"))
            return
        if transfer is None:
            return
        if not transfer.begun and mux != transfer.mux:
            transfer.stale = True
            return
        transfer.begun = True
        if transfer.stale:
            self.findings.expect(True, "MT10", "")  # the master has waited for the right answer
            transfer.stale = False
        transfer.answered = True
        self._follow(transfer, data)

    def _follow(self, transfer: MasterTransfer, data: bytes) -> None:
        command = data[0] & COMMAND_MASK
        if transfer.kind == "download":
            if transfer.last:
                self._end(transfer, None)
        elif transfer.kind == "upload":
            if (command == 0x40 and data[0] & 2) or (command == SEGMENT and data[0] & 1):
                self._end(transfer, None)
        elif transfer.kind == "block download":
            if data[0] & 3 == _BLOCK_END and command == 0xA0:
                self._end(transfer, None)
            else:
                self._sub_block(transfer, data)

    @staticmethod
    def _sub_block(transfer: MasterTransfer, data: bytes) -> None:
        """Start the next sub-block, which repeats the segments that the device has not acknowledged."""
        if data[0] & 3 == _BLOCK_ACK and (lost := transfer.count - data[1]) > 0:
            del transfer.data[len(transfer.data) - SEGMENT_DATA * lost :]
            transfer.last = False
        transfer.count, transfer.in_block = 0, not transfer.last

    def _refused(self, transfer: MasterTransfer | None, mux: Mux, code: int) -> None:
        text = f"abort 0x{code:08X} ({abort_text(code)}) of {name_of(mux)}"
        no_blocks = code == AbortCode.UNKNOWN_COMMAND and transfer is not None and "block" in transfer.kind
        self.findings.expect(code not in _PROTOCOL_ERRORS or no_blocks, "MT12", text)
        if transfer is None or mux != transfer.mux:
            if transfer is not None:
                transfer.stale = True
            return
        self._aborted = mux
        self.findings.expect(True, "MT07", "")
        if "download" in transfer.kind:
            self.findings.expect(code not in _MISSING, "MT13", text)
        self._end(transfer, code)

    def _end(self, transfer: MasterTransfer, code: int | None) -> None:
        self._transfer = None
        if code is None:
            self._aborted = None
            self.findings.expect(True, "MT12", "")
        if "download" in transfer.kind:
            if code is None:
                self.findings.expect(True, "MT13", "")
            for listener in self.listeners:
                listener.written(transfer.mux, code)

    # -- time

    def tick(self, now: int) -> None:
        transfer = self._transfer
        if transfer is not None and not transfer.answered and now - transfer.requested_at > _HANG_NS:
            text = f"nothing for 10 s after the {transfer.kind} of {name_of(transfer.mux)} without an answer"
            self.findings.expect(False, "MT08", text)
            self._end(transfer, AbortCode.TIMED_OUT)
