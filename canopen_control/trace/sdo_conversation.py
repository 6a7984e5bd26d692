"""SDO transfers of one node as seen by a listener, including segments and blocks (CiA 301, 7.2.4.3).

The protocol is not checked. A frame that does not fit the transfer is described as such, and the next initiate frame
starts a new transfer, because a listener may have started late or lost frames. Up to `LIMIT` bytes of a transfer are
stored, and all bytes are counted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

from canopen_control.cia301.abort import abort_text
from canopen_control.cia301.sdo_codec import (
    ABORT,
    BLOCK_ACK,
    BLOCK_DOWNLOAD,
    BLOCK_DOWNLOAD_ANSWER,
    BLOCK_END_ANSWER,
    BLOCK_START,
    BLOCK_UPLOAD,
    BLOCK_UPLOAD_ANSWER,
    COMMAND_MASK,
    DOWNLOAD,
    DOWNLOAD_ANSWER,
    DOWNLOAD_SEGMENT_ANSWER,
    LAST_FLAG,
    SEGMENT,
    SEGMENT_DATA,
    SIZED_FLAG,
    UPLOAD,
    UPLOAD_SEGMENT,
)
from canopen_control.trace.values import SignalValue, decoded

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.od.model import ObjectDictionary
    from canopen_control.trace.values import NodeWords


LIMIT: Final = 1 << 16  # maximum number of bytes kept of one transfer
_EXPEDITED, _SIZED = 0x02, 0x01


class SdoText(NamedTuple):
    """Description of an SDO frame, with the value if the frame completes one, and whether the frame is an abort.

    `held` is a short value that the node now has, because it has sent the value or confirmed its download.
    """

    text: str
    value: SignalValue | None = None
    is_abort: bool = False
    held: SignalValue | None = None


class SdoConversation:
    """State of the SDO transfers between a client and the server of one node."""

    def __init__(self, od: ObjectDictionary | None, words: NodeWords) -> None:
        self._od, self._words = od, words
        self._end()

    def _end(self) -> None:
        self._address: tuple[int, int] | None = None
        self._kind = ""  # "read", "write", "block read", "block write"
        self._data = bytearray()
        self._length = 0
        self._size = 0
        self._pending: SignalValue | None = None  # short value of a download that was not confirmed yet
        self._open = False  # a segmented download has more segments
        self._streams = False  # the next frames of the sender are segments of a block
        self._block: dict[int, bytes] = {}
        self._last = 0  # sequence number of the block's last segment

    def receive(self, data: bytes, *, from_client: bool) -> SdoText:
        """Describe a frame; a frame that was truncated after its last used byte is padded."""
        if not data:
            return SdoText("malformed: no data")
        data = data.ljust(8, b"\0")
        if self._streams and from_client == (self._kind == "block write") and data[0] != ABORT:
            return self._block_segment(data)
        handler = (self._CLIENT if from_client else self._SERVER).get(data[0] & COMMAND_MASK)
        return SdoText(f"unknown command 0x{data[0]:02X}") if handler is None else handler(self, data)

    # -- object of the transfer

    def _begin(self, data: bytes, kind: str) -> str:
        self._end()
        self._address, self._kind = (data[1] | data[2] << 8, data[3]), kind
        return self._where()

    def _where(self) -> str:
        if self._address is None:
            return "a transfer with unknown start"
        return self._named(*self._address)

    def _named(self, index: int, subindex: int) -> str:
        name = self._words.name(index, subindex)
        return f"0x{index:04X}:{subindex:02X}" + (f" {name}" if name else "")

    def _value(self, data: bytes) -> SignalValue | None:
        if self._address is None:
            return None
        index, subindex = self._address
        entry = self._od.get(index, subindex) if self._od is not None else None
        data_type = entry.data_type if entry is not None else None
        value = decoded(data, data_type)
        text = self._words.text(index, subindex, value)
        if isinstance(value, int) and text == str(value) and value > 9:
            text = f"{value} (0x{value:X})"
        return SignalValue(index, subindex, self._words.name(index, subindex), value, text)

    def _sized_for(self, data: bytes) -> bytes:
        """Truncate an expedited value without a size indication to the size of the object's data type."""
        entry = self._od.get(*self._address) if self._od is not None and self._address is not None else None
        bits = entry.data_type.bits if entry is not None else None
        return data if bits is None else data[: (bits + 7) // 8]

    def _carried(self, data: bytes) -> bytes:
        sized = data[4 : 8 - (data[0] >> 2 & 3)]
        return sized if data[0] & _SIZED else self._sized_for(data[4:8])

    def _announced(self, data: bytes) -> str:
        self._size = int.from_bytes(data[4:8], "little")
        return f"{self._size} bytes"

    # -- expedited and segmented transfers

    def _download(self, data: bytes) -> SdoText:
        place = self._begin(data, "write")
        if data[0] & _EXPEDITED:
            value = self._pending = self._value(self._carried(data))
            return SdoText(f"write {place} = {value.text if value else ''}", value)
        self._open = True
        size = f", {self._announced(data)}" if data[0] & _SIZED else ""
        return SdoText(f"write {place}{size} in segments")

    def _download_answer(self, data: bytes) -> SdoText:
        address = data[1] | data[2] << 8, data[3]
        if address != self._address:
            self._begin(data, "write")
        value, self._pending = self._pending, None
        return SdoText(f"{'continue' if self._open else 'written'} {self._where()}", held=value)

    def _segment_answer(self, data: bytes) -> SdoText:  # noqa: ARG002 - one shape for all
        place = self._where()
        if self._open or self._address is None:
            return SdoText(f"segment of {place} acknowledged")
        self._end()
        return SdoText(f"written {place}")

    def _upload(self, data: bytes) -> SdoText:
        return SdoText(f"read {self._begin(data, 'read')}")

    def _upload_answer(self, data: bytes) -> SdoText:
        address = data[1] | data[2] << 8, data[3]
        if address != self._address or self._kind != "read":
            self._begin(data, "read")
        if data[0] & _EXPEDITED:
            text = self._completed(self._carried(data))
            return text._replace(held=text.value)
        size = self._announced(data) if data[0] & _SIZED else "length unknown"
        return SdoText(f"{self._where()}: {size}, in segments")

    def _segment(self, data: bytes, kind: str) -> SdoText:
        if self._address is None or self._kind != kind:
            return SdoText("segment of a transfer with unknown start")
        self._keep(data[1 : 8 - (data[0] >> 1 & 7)])
        if not data[0] & 1:
            return SdoText(f"segment of {self._where()}, {self._progress()}")
        return self._completed(bytes(self._data), kind=kind)

    def _keep(self, part: bytes) -> None:
        self._length += len(part)
        if len(self._data) < LIMIT:
            self._data += part[: LIMIT - len(self._data)]

    def _progress(self) -> str:
        return f"{self._length} of {self._size} bytes" if self._size else f"{self._length} bytes"

    def _completed(self, data: bytes, *, kind: str = "read") -> SdoText:
        value = None if self._length > LIMIT else self._value(data)
        verb = "write " if kind == "write" else ""
        text = f"{verb}{self._where()} = {value.text if value else f'{self._length} bytes'}"
        self._open = False
        if kind == "read":
            self._end()
        return SdoText(text, value)

    def _abort(self, data: bytes, side: str) -> SdoText:
        code = int.from_bytes(data[4:8], "little")
        index, subindex = data[1] | data[2] << 8, data[3]
        place = self._named(index, subindex) if index else self._where()
        self._end()
        return SdoText(f"ABORT by {side}, {place}: 0x{code:08X} {abort_text(code)}", is_abort=True)

    # -- block transfers

    def _block_download_client(self, data: bytes) -> SdoText:
        if data[0] & 1:
            return self._block_end(data, "block write")
        place = self._begin(data, "block write")
        size = f", {self._announced(data)}" if data[0] & SIZED_FLAG else ""
        return SdoText(f"write {place}{size} in blocks")

    def _block_download_server(self, data: bytes) -> SdoText:
        if data[0] == BLOCK_ACK:
            return self._acknowledged(data)
        if data[0] == BLOCK_END_ANSWER:
            place = self._where()
            self._end()
            return SdoText(f"written {place}")
        if self._kind != "block write":
            self._begin(data, "block write")
        self._streams = True
        return SdoText(f"continue {self._where()}, blocks of {data[4]} segments")

    def _block_upload_client(self, data: bytes) -> SdoText:
        if data[0] == BLOCK_ACK:
            return self._acknowledged(data)
        if data[0] == BLOCK_START:
            self._streams = self._kind == "block read"
            return SdoText(f"send {self._where()}")
        if data[0] == BLOCK_END_ANSWER:
            place = self._where()
            self._end()
            return SdoText(f"{place} received")
        return SdoText(f"read {self._begin(data, 'block read')} in blocks of {data[4]} segments")

    def _block_upload_server(self, data: bytes) -> SdoText:
        if data[0] & 1:
            return self._block_end(data, "block read")
        address = data[1] | data[2] << 8, data[3]
        if address != self._address or self._kind != "block read":
            self._begin(data, "block read")
        size = self._announced(data) if data[0] & SIZED_FLAG else "length unknown"
        return SdoText(f"{self._where()}: {size}, in blocks")

    def _block_segment(self, data: bytes) -> SdoText:
        number = data[0] & ~LAST_FLAG
        self._block[number] = data[1:8]
        if data[0] & LAST_FLAG:
            self._last = number
            self._streams = False
        end = ", the last" if data[0] & LAST_FLAG else ""
        return SdoText(f"block segment {number} of {self._where()}{end}")

    def _acknowledged(self, data: bytes) -> SdoText:
        """Store the acknowledged segments of a block; the sender repeats the others."""
        acknowledged, expected = data[1], max(self._block, default=0)
        for number in range(1, acknowledged + 1):
            self._keep(self._block.get(number, bytes(SEGMENT_DATA)))
        again = f", {expected - acknowledged} to be repeated" if acknowledged < expected else ""
        if again or not self._last:
            self._streams, self._last = self._address is not None, 0
        self._block = {}
        return SdoText(f"{acknowledged} segments of {self._where()} acknowledged{again}")

    def _block_end(self, data: bytes, kind: str) -> SdoText:
        if self._kind != kind:
            return SdoText("end of a block transfer with unknown start")
        self._streams = False
        unused = data[0] >> 2 & 7
        self._length = max(0, self._length - unused)
        complete = self._length <= LIMIT
        value = self._value(bytes(self._data[: self._length])) if complete else None
        verb = "write " if kind == "block write" else ""
        return SdoText(f"{verb}{self._where()} = {value.text if value else f'{self._length} bytes'}", value)

    _CLIENT: ClassVar[dict[int, Callable[[Any, bytes], SdoText]]] = {
        DOWNLOAD: _download,
        SEGMENT: lambda self, data: self._segment(data, "write"),
        UPLOAD: _upload,
        UPLOAD_SEGMENT: lambda self, _data: SdoText(f"next segment of {self._where()}"),
        BLOCK_UPLOAD & COMMAND_MASK: _block_upload_client,
        BLOCK_DOWNLOAD & COMMAND_MASK: _block_download_client,
        ABORT: lambda self, data: self._abort(data, "the client"),
    }
    _SERVER: ClassVar[dict[int, Callable[[Any, bytes], SdoText]]] = {
        DOWNLOAD_ANSWER: _download_answer,
        DOWNLOAD_SEGMENT_ANSWER: _segment_answer,
        UPLOAD: _upload_answer,
        SEGMENT: lambda self, data: self._segment(data, "read"),
        BLOCK_DOWNLOAD_ANSWER & COMMAND_MASK: _block_download_server,
        BLOCK_UPLOAD_ANSWER & COMMAND_MASK: _block_upload_server,
        ABORT: lambda self, data: self._abort(data, "the node"),
    }
