"""One SDO request of a client as a state machine: tries, answers, timeouts and aborts (CiA 301, 7.2.4).

The law:
- What is awaited is the `Phase` (sdo_phases.py): nothing, the answer to the first frame (one phase for each), the end
  of a pause, the rest of a transfer. What follows from it is decided in sdo_try.py.
- A request that died (timed out or cancelled) may still be answered: until that is settled, its object is in
  quarantine (sdo_quarantine.py), so that no late answer can be taken for that of the retry.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia301.sdo_client_block import BlockUpload
from canopen_control.cia301.sdo_codec import ABORT
from canopen_control.cia301.sdo_initiate import completed, initiate, initiate_block
from canopen_control.cia301.sdo_phases import (
    AwaitingBlockDownload,
    AwaitingBlockUpload,
    AwaitingDownload,
    AwaitingUpload,
    Probing,
)
from canopen_control.cia301.sdo_try import SdoTry
from canopen_control.frame import CanFrame

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_request import SdoRequest
    from canopen_control.cia301.sdo_try import Phase
    from canopen_control.errors import CanopenError

__all__ = ["SdoExchange"]

_UNARMED: Final = 0  # the deadline of a request whose caller did not say when it is; the next tick does
_UPLOAD: Final = AwaitingUpload()
_DOWNLOAD: Final = AwaitingDownload()
_BLOCK_UPLOAD: Final = AwaitingBlockUpload(block=True)
_BLOCK_DOWNLOAD: Final = AwaitingBlockDownload(block=True)
_PROBING: Final = Probing()


class SdoExchange(SdoTry):
    """The request under way, if there is one, as its client sees it."""

    @property
    def progress(self) -> tuple[int, int | None]:
        """How far the transfer under way is, in bytes; see `SdoClient.progress`."""
        transfer = self.phase.transfer
        return (0, None) if transfer is None else transfer.progress

    def start(self, request: SdoRequest, now: int | None) -> None:
        """Begin a request; with `now` None its timeout starts with the next tick."""
        self.active, self._started, self._budget = request, now, None
        self.begin(request, now)

    def receive(self, data: bytes, now: int) -> None:
        """Take the data of a frame from the server; what answers nothing is counted."""
        if len(data) != 8 and not (data := completed(data)):
            self.ignored += 1
        elif data[0] != ABORT:
            self.phase.receive(self, data, now)
        elif (request := self.active) is not None and self.phase.concerns(self, data[1:4]):
            self.phase.aborted(self, request, data, now)
        else:
            self.ignored += 1

    def receive_records(self, records: bytes, start: int, cob_id: int, now: int) -> int:
        """Take a run of a block upload's segments at once; return how many records, 0 if there is none."""
        transfer, request = self.phase.transfer, self.active
        if not isinstance(transfer, BlockUpload) or request is None:
            return 0
        if count := transfer.receive_records(records, start, cob_id, self.out):
            self.deadline = now + request.timeout_ns
        return count

    def tick(self, now: int) -> None:
        """Start the timeout of a request that has left, or act on one that ran out."""
        request = self.active
        if self.deadline is None or now < self.deadline or request is None:
            return
        if self.deadline == _UNARMED:
            self._started, self.deadline = now, now + request.timeout_ns
        else:
            self.phase.time_out(self, request, now)

    def cancel(self, error: CanopenError) -> None:
        """Give up the request under way without an answer; the server is told if it has heard of it."""
        if (request := self.active) is None:
            return
        self.phase.abandon(self)
        self.idle()
        self.report(request, error)

    def forget(self) -> None:
        """Forget what is known of the server: it has booted."""
        self.quarantine.owed.clear()
        self.block_supported = None

    def begin(self, request: SdoRequest, now: int | None) -> None:
        """Make a try: send the first frame, or read another object before it."""
        if request.block and self.block_supported is not False and not (self._budget and self._budget.plain):
            phase: Phase = _BLOCK_DOWNLOAD if request.is_write else _BLOCK_UPLOAD
            data = initiate_block(request, self.options)
        else:
            phase = _DOWNLOAD if request.is_write else _UPLOAD
            data = initiate(request, self.options)
        mux = data[1:4]
        if mux in self.quarantine.owed:
            phase, data = _PROBING, self.quarantine.probe()
            mux = data[1:4]
        self.phase, self.first, self.mux = phase, data, mux
        self.out.append(CanFrame(self.request_cob_id, data))
        self.deadline = _UNARMED if now is None else now + request.timeout_ns
