"""Messages as JSON objects, one a line: the codec and the splitter of the stream.

A message is one JSON object in UTF-8, ended by a newline, at most 1 MiB long. A number that is not finite has no name
in JSON: `encode` writes null, unknown; `encode_strict`, for those who command, refuses it.
"""

from __future__ import annotations

import json
import math
from typing import Any, Final, TypeAlias

__all__ = ["MAX_LINE", "LineBuffer", "Message", "decode", "encode", "encode_strict"]

Message: TypeAlias = dict[str, Any]

MAX_LINE: Final = 1 << 20


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no JSON")


_decoder: Final = json.JSONDecoder(parse_constant=_refuse_constant)
_encoder: Final = json.JSONEncoder(separators=(",", ":"), allow_nan=False)  # ASCII: takes half a surrogate pair too


def decode(line: bytes | bytearray) -> Message:
    """Return the object in a line; ValueError with a sentence when it holds none."""
    try:
        message = _decoder.decode(line.decode())
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if not isinstance(message, dict):
        raise ValueError(f"a message is a JSON object, this is a {type(message).__name__}")
    return message


def encode_strict(message: Message) -> bytes:
    """Return the line of a message; ValueError when it holds a number that is not finite."""
    return _encoder.encode(message).encode() + b"\n"


def encode(message: Message) -> bytes:
    """Return the line of a message; numbers that are not finite become null."""
    try:
        return encode_strict(message)
    except ValueError:  # found while encoding, so that the usual message is walked through once
        return encode_strict(_without_nan(message))


def _without_nan(value: object) -> Any:  # noqa: ANN401 - JSON has no type of its own
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class LineBuffer:
    """Bytes in, lines out: a stream cut anywhere gives the same lines.

    `overflow` turns true when a line is longer than `limit` bytes; nothing comes out after that.
    """

    __slots__ = ("_data", "_limit", "_searched", "overflow")

    def __init__(self, limit: int = MAX_LINE) -> None:
        self._data = bytearray()
        self._searched = 0  # no newline before this position
        self._limit = limit
        self.overflow = False

    def feed(self, data: bytes) -> None:
        """Take the next piece of the stream."""
        if not self.overflow:
            self._data += data

    def next_line(self) -> bytes | None:
        """Return the next line without its end, or None when none is complete; empty lines are skipped."""
        while not self.overflow:
            end = self._data.find(b"\n", self._searched)
            length = len(self._data) if end < 0 else end
            if length > self._limit:
                self.overflow = True
                self._data.clear()
                break
            if end < 0:
                self._searched = length
                break
            line = bytes(self._data[:end])
            del self._data[: end + 1]
            self._searched = 0
            if line.strip():
                return line
        return None
