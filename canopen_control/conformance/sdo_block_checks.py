"""Checks of SDO block transfers, of unused bytes and of interrupted transfers (CiA 301, 7.2.4.3).

The checks that download write the current value to 0x1017. `T` in a comment is the number of the case in CiA's
conformance test tool 3.0.3.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_codec import (
    ABORT,
    BLOCK_ACK,
    BLOCK_DOWNLOAD,
    BLOCK_DOWNLOAD_ANSWER,
    BLOCK_END,
    BLOCK_END_ANSWER,
    BLOCK_START,
    BLOCK_UPLOAD,
    BLOCK_UPLOAD_ANSWER,
    COMMAND_MASK,
    CRC_FLAG,
    LAST_FLAG,
    MAX_BLOCK_SIZE,
    SEGMENT_DATA,
    SIZED_FLAG,
    SUB_COMMAND_MASK,
    crc16,
)
from canopen_control.conformance.check import (
    CheckLevel,
    CheckList,
    CheckTouch,
    aborts,
    answer_text,
    client_abort,
    expect,
    expect_abort,
    mux,
    upload_request,
)
from canopen_control.conformance.checked_node import CheckFailed, NotApplicable
from canopen_control.errors import SdoAbort
from canopen_control.od.indices import HEARTBEAT_PRODUCER

if TYPE_CHECKING:
    from canopen_control.conformance.checked_node import CheckedNode


BLOCK_CHECKS = CheckList("301")
_add = BLOCK_CHECKS.add
_SHOULD, _CONFIGURE = CheckLevel.SHOULD, CheckTouch.CONFIGURE
_ANSWERS_S = 0.1  # time in which the segments of a sub-block arrive
_LIMIT_S = 0.05  # response time for a master with short timeouts


def _abort(node: CheckedNode, index: int) -> None:
    node.request(client_abort(index))
    node.listen(0.005)


def _start_upload(node: CheckedNode, index: int, block_size: int) -> tuple[int, bool]:
    """Initiate a block upload or raise NotApplicable; return the announced size, and whether the server uses a CRC."""
    answer = node.ask(bytes((BLOCK_UPLOAD | CRC_FLAG, *mux(index), block_size, 0, 0, 0)))
    if answer is None or answer[0] & COMMAND_MASK != BLOCK_UPLOAD_ANSWER:
        if answer is not None and answer[0] != ABORT:
            _abort(node, index)
        raise NotApplicable(f"the server does not support block upload of 0x{index:04X}: {answer_text(answer)}")
    return int.from_bytes(answer[4:], "little"), bool(answer[0] & CRC_FLAG)


def _object(node: CheckedNode) -> tuple[int, bytes]:
    """Return index and value of the longest object among 0x1000 and 0x1008 to 0x100A."""
    values = {}
    for index in (0x1000, 0x1008, 0x1009, 0x100A):
        try:
            values[index] = node.read(index)
        except SdoAbort:
            continue
    index = max(values, key=lambda key: len(values[key]))
    return index, values[index]


def _uploaded(node: CheckedNode, block_size: int) -> None:
    """Upload an object in sub-blocks, and check the content and the CRC."""
    index, value = _object(node)
    size, with_crc = _start_upload(node, index, block_size)
    expect(size in (0, len(value)), f"{size} bytes announced", f"{len(value)}")
    data = bytearray()
    answers = node.answers(bytes((BLOCK_START, *bytes(7))), _ANSWERS_S)
    for _ in range(len(value) // SEGMENT_DATA + 2):
        expect(0 < len(answers) <= block_size, f"{len(answers)} segments", f"1 to {block_size}")
        numbers = [answer[0] & 0x7F for answer in answers]
        expect(numbers == list(range(1, len(answers) + 1)), f"sequence {numbers}", "1, 2, 3 and so on")
        data += b"".join(answer[1:] for answer in answers)
        last = bool(answers[-1][0] & LAST_FLAG)
        answers = node.answers(bytes((BLOCK_ACK, len(answers), block_size, *bytes(5))), _ANSWERS_S)
        if last:
            break
    end = answers[0] if len(answers) == 1 else None
    expect(end is not None and end[0] & SUB_COMMAND_MASK == BLOCK_END, answer_text(end), "the end of the block upload")
    assert end is not None
    unused = end[0] >> 2 & 7
    data = data[: len(data) - unused]
    node.request(bytes((BLOCK_END_ANSWER, *bytes(7))))
    node.listen(0.005)
    expect(data == value, bytes(data).hex(" ").upper(), "the value of the upload without blocks")
    if with_crc:
        crc = int.from_bytes(end[1:3], "little")
        expect(crc == crc16(data), f"CRC 0x{crc:04X}", f"0x{crc16(data):04X}")


for _id, _size, _title in (
    ("B01", 1, "a block upload in sub-blocks of one segment is complete, with the right CRC"),  # T 2.23
    ("B02", 127, "a block upload in sub-blocks of 127 segments is complete, with the right CRC"),  # T 2.23
    ("B02b", 2, "a block upload in sub-blocks of two segments is complete, with the right CRC"),
):
    _add(_id, "7.2.4.3.13", _title)(partial(_uploaded, block_size=_size))


@_add("S19", "7.2.4.3.15", "an acknowledgement of a segment that was not sent is refused")  # T 2.27
def _wrong_acknowledgement(node: CheckedNode) -> None:
    index, _ = _object(node)
    _start_upload(node, index, MAX_BLOCK_SIZE)
    node.answers(bytes((BLOCK_START, *bytes(7))), _ANSWERS_S)
    codes = AbortCode.INVALID_SEQUENCE_NUMBER, AbortCode.UNKNOWN_COMMAND
    expect_abort(node, bytes((BLOCK_ACK, 0x80, MAX_BLOCK_SIZE, *bytes(5))), *codes)


@_add("S19r", "7.2.4.3.15", "segments that were not acknowledged are sent again", _SHOULD)
def _repeated_segments(node: CheckedNode) -> None:
    index, _ = _object(node)
    _start_upload(node, index, MAX_BLOCK_SIZE)
    first = node.answers(bytes((BLOCK_START, *bytes(7))), _ANSWERS_S)
    again = node.answers(bytes((BLOCK_ACK, 0, MAX_BLOCK_SIZE, *bytes(5))), _ANSWERS_S)
    _abort(node, index)
    expect(bool(first) and again == first, f"{len(again)} segments", f"the {len(first)} segments of the sub-block")


_add("S16x", "7.2.4.3.13", "a block upload of 0x1004, which is reserved, is refused")(
    aborts(bytes((BLOCK_UPLOAD, *mux(0x1004), MAX_BLOCK_SIZE, 0, 0, 0)), AbortCode.NO_OBJECT, AbortCode.UNKNOWN_COMMAND)
)
_add("S17x", "7.2.4.3.9", "a block download to 0x1000 (const) is refused at its initiation")(
    aborts(
        bytes((BLOCK_DOWNLOAD | SIZED_FLAG, *mux(0x1000), 4, 0, 0, 0)),
        AbortCode.READ_ONLY,
        AbortCode.UNSUPPORTED_ACCESS,
        AbortCode.UNKNOWN_COMMAND,
    )
)


@_add("S17y", "7.2.4.3.9", "the server supports block transfers", _SHOULD)
def _has_blocks(node: CheckedNode) -> None:
    answer = node.ask(bytes((BLOCK_UPLOAD | CRC_FLAG, *mux(0x1000), MAX_BLOCK_SIZE, 0, 0, 0)))
    if answer is not None and answer[0] != ABORT:
        _abort(node, 0x1000)
    good = answer is not None and answer[0] != ABORT
    expect(good, answer_text(answer), "block transfers, which firmware and long objects need; they are optional")


def _start_download(node: CheckedNode, size: int, *, crc: bool) -> bool:
    """Initiate a block download to 0x1017 or raise NotApplicable; return whether the server accepts a CRC."""
    command = BLOCK_DOWNLOAD | SIZED_FLAG | (CRC_FLAG if crc else 0)
    answer = node.ask(bytes((command, *mux(HEARTBEAT_PRODUCER), *size.to_bytes(4, "little"))))
    if answer is not None and answer[0] == ABORT:
        code = int.from_bytes(answer[4:], "little")
        if code == AbortCode.UNKNOWN_COMMAND:
            raise NotApplicable("the server has no block download")
        raise CheckFailed(f"abort 0x{code:08X}", f"{BLOCK_DOWNLOAD_ANSWER:02X}")
    good = answer is not None and answer[0] & COMMAND_MASK == BLOCK_DOWNLOAD_ANSWER and 1 <= answer[4] <= MAX_BLOCK_SIZE
    expect(good, answer_text(answer), f"{BLOCK_DOWNLOAD_ANSWER:02X} with a block size of 1 to 127")
    return answer is not None and bool(answer[0] & CRC_FLAG)


def _segment(node: CheckedNode, number: int, value: bytes) -> bytes | None:
    return node.ask(bytes((LAST_FLAG | number,)) + value.ljust(SEGMENT_DATA, b"\0"))


def _end_download(node: CheckedNode, value: bytes, crc: int) -> bytes | None:
    unused = SEGMENT_DATA - len(value)
    return node.ask(bytes((BLOCK_END | unused << 2,)) + crc.to_bytes(2, "little") + bytes(5))


def _downloaded(node: CheckedNode, *, crc: bool) -> None:
    value = node.optional(HEARTBEAT_PRODUCER)
    accepted = _start_download(node, len(value), crc=crc)
    if crc and not accepted:
        _abort(node, HEARTBEAT_PRODUCER)
        raise NotApplicable("the server computes no CRC")
    ack = _segment(node, 1, value)
    expect(ack is not None and ack[:2] == bytes((BLOCK_ACK, 1)), answer_text(ack), "A2 01")
    end = _end_download(node, value, crc16(value) if crc else 0)
    expect(end is not None and end[0] == BLOCK_END_ANSWER, answer_text(end), "A1")
    expect(node.read(HEARTBEAT_PRODUCER) == value, node.read(HEARTBEAT_PRODUCER).hex(" "), value.hex(" "))


for _id, _clause, _title, _with_crc in (
    ("S17", "7.2.4.3.9", "a block download to 0x1017 without a CRC works", False),  # T 2.21
    ("S17c", "7.2.4.3.12", "a block download to 0x1017 with a CRC works", True),  # T 2.25
):
    _add(_id, _clause, _title, touch=_CONFIGURE)(partial(_downloaded, crc=_with_crc))


@_add("S21", "7.2.4.3.12", "a block download with a wrong CRC is refused, and changes nothing", touch=_CONFIGURE)
def _wrong_crc(node: CheckedNode) -> None:
    before = node.optional(HEARTBEAT_PRODUCER)
    if not _start_download(node, len(before), crc=True):
        _abort(node, HEARTBEAT_PRODUCER)
        raise NotApplicable("the server computes no CRC")
    _segment(node, 1, before)
    unused = SEGMENT_DATA - len(before)
    wrong = (crc16(before) ^ 0xFFFF).to_bytes(2, "little")
    expect_abort(node, bytes((BLOCK_END | unused << 2,)) + wrong + bytes(5), AbortCode.CRC_ERROR)
    expect(node.read(HEARTBEAT_PRODUCER) == before, node.read(HEARTBEAT_PRODUCER).hex(" "), before.hex(" "))


@_add("S22", "7.2.4.3.11", "the server requests a missing segment again, and accepts it", touch=_CONFIGURE)
def _missing_segment(node: CheckedNode) -> None:
    value = node.optional(HEARTBEAT_PRODUCER)
    _start_download(node, len(value), crc=False)
    ack = _segment(node, 2, value)
    if ack is not None and ack[0] == ABORT:
        return  # a server may also end the transfer
    expect(ack is not None and ack[:2] == bytes((BLOCK_ACK, 0)), answer_text(ack), "A2 00, or an abort")
    ack = _segment(node, 1, value)
    expect(ack is not None and ack[:2] == bytes((BLOCK_ACK, 1)), answer_text(ack), "A2 01")
    end = _end_download(node, value, 0)
    expect(end is not None and end[0] == BLOCK_END_ANSWER, answer_text(end), "A1")


@_add("S17l", "7.2.4.3.9", "a block download that announces eight bytes for UNSIGNED16 is refused", touch=_CONFIGURE)
def _block_too_long(node: CheckedNode) -> None:
    value = node.optional(HEARTBEAT_PRODUCER)
    command = BLOCK_DOWNLOAD | SIZED_FLAG
    answer = node.ask(bytes((command, *mux(HEARTBEAT_PRODUCER), 8, 0, 0, 0)))
    if answer is not None and answer[0] & COMMAND_MASK == BLOCK_DOWNLOAD_ANSWER:
        node.request(bytes((1, *value, *bytes(5))))
        answer = _segment(node, 2, b"\0")
        if answer is not None and answer[0] == BLOCK_ACK:
            answer = _end_download(node, b"\0", 0)
    expect(answer is not None and answer[0] == ABORT, answer_text(answer), "an abort")
    expect(node.read(HEARTBEAT_PRODUCER) == value, node.read(HEARTBEAT_PRODUCER).hex(" "), value.hex(" "))


# -- unused bytes, lengths and times of answers


@_add("S01l", "7.2.4.3", "an answer has eight bytes, even if fewer are used")
def _answer_length(node: CheckedNode) -> None:
    answer = node.ask(upload_request(0x1001))
    expect(answer is not None and len(answer) == 8, answer_text(answer), "eight bytes")


@_add("S01u", "7.2.4.3.6", "the unused bytes of an expedited upload are 0", _SHOULD)
def _unused_bytes(node: CheckedNode) -> None:
    answer = node.ask(upload_request(0x1001))
    expect(answer is not None and not any(answer[5:]), answer_text(answer), "zeros after the value")


@_add("S01s", "7.2.4.3.6", "an expedited upload of 0x1001 indicates a size of one byte")
def _shown_size(node: CheckedNode) -> None:
    answer = node.ask(upload_request(0x1001))
    expect(answer is not None and answer[0] == 0x4F, answer_text(answer), "4F: one byte")


@_add("S02u", "7.2.4.3.3", "the unused bytes of the answer to a download are 0", _SHOULD, _CONFIGURE)
def _unused_in_confirmation(node: CheckedNode) -> None:
    value = node.optional(HEARTBEAT_PRODUCER)
    with node.kept(HEARTBEAT_PRODUCER):
        answer = node.ask(bytes((0x2B, *mux(HEARTBEAT_PRODUCER), 0x10, 0x27, 0, 0)))
        expect(answer is not None and answer[0] == 0x60, answer_text(answer), "60")
        expect(answer is not None and not any(answer[4:]), answer_text(answer), "zeros after the multiplexer")
    expect(node.read(HEARTBEAT_PRODUCER) == value, node.read(HEARTBEAT_PRODUCER).hex(" "), value.hex(" "))


@_add("S06c", "7.2.4.3.17", "the abort code of a missing object is 0x06020000", _SHOULD)
def _specific_code(node: CheckedNode) -> None:
    answer = node.ask(upload_request(0x1004))
    code = 0 if answer is None else int.from_bytes(answer[4:], "little")
    expect(code == AbortCode.NO_OBJECT, answer_text(answer), "abort 0x06020000, not the general 0x08000000")


@_add("S27t", "7.2.4.3", f"an upload of 0x1000 is answered within {_LIMIT_S * 1000:.0f} ms", _SHOULD)
def _answer_time(node: CheckedNode) -> None:
    begin = node.reactor.now()
    node.read(0x1000)
    seconds = (node.reactor.now() - begin) / 1e9
    expect(seconds <= _LIMIT_S, f"{seconds * 1000:.0f} ms", f"at most {_LIMIT_S * 1000:.0f} ms")


# -- interrupted transfers


@_add("S29", "7.2.4.3.17", "an abandoned download does not block the next request", touch=_CONFIGURE)
def _abandoned_download(node: CheckedNode) -> None:
    node.optional(HEARTBEAT_PRODUCER)
    node.ask(bytes((0x21, *mux(HEARTBEAT_PRODUCER), 2, 0, 0, 0)))
    node.listen(0.2)
    answer = node.ask(upload_request(0x1000))
    expect(answer is not None and answer[0] == 0x43, answer_text(answer), "the answer to the new request")


@_add("S29t", "7.2.4.3.4", "a first segment of a download with toggle bit 1 is refused", touch=_CONFIGURE)
def _download_toggle(node: CheckedNode) -> None:
    value = node.optional(HEARTBEAT_PRODUCER)
    node.ask(bytes((0x21, *mux(HEARTBEAT_PRODUCER), 2, 0, 0, 0)))
    expect_abort(node, bytes((0x1B, *value, *bytes(5))), AbortCode.TOGGLE_NOT_ALTERNATED)


@_add("S29b", "7.2.4.3.15", "an aborted block upload does not block the next request")
def _abandoned_block(node: CheckedNode) -> None:
    index, _ = _object(node)
    _start_upload(node, index, MAX_BLOCK_SIZE)
    _abort(node, index)
    answer = node.ask(upload_request(0x1000))
    expect(answer is not None and answer[0] == 0x43, answer_text(answer), "the answer to the new request")
