"""Conversion between typed messages and lines of JSON.

A request is `{"id", "method", "params"}`, its answer `{"id", "result"}` or `{"id", "error": {"kind", "message"}}`; a
request without an id is not answered. A pushed message is an object with one key, which identifies its type. A number
that is not finite becomes null; bytes are base64.
"""

from __future__ import annotations

import re
from typing import Any, Final, TypeVar

import msgspec

from canopen_control.host.lineclient import MAX_VALUES, too_many_values
from canopen_control.rpc.messages.declare import Refusal

T = TypeVar("T")
Id = int | str | None
Raw = msgspec.Raw

_encode: Final = msgspec.json.Encoder().encode
_fields: Final = msgspec.json.Decoder(dict[str, msgspec.Raw])
_id: Final = msgspec.json.Decoder(int | str | None)
_name: Final = msgspec.json.Decoder(str)
_NOTHING: Final = msgspec.Raw(b"{}")
_NULL: Final = msgspec.Raw(b"null")


class Incoming(msgspec.Struct, frozen=True):
    """Received request with undecoded parameters; `method` is "" if missing or not text."""

    number: Id
    method: str
    params: msgspec.Raw


def read_line(line: bytes) -> dict[str, Raw]:
    """Return the undecoded members of a JSON object; raise ValueError if the line is anything else."""
    try:
        return _fields.decode(line)
    except msgspec.ValidationError:
        raise ValueError("a message is a JSON object") from None
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise ValueError(str(error)) from None


def read_request(line: bytes) -> Incoming:
    """Decode a client's line as a request.

    Raise ValueError if it is invalid or has too many values to decode in time.
    """
    if too_many_values(line):
        raise ValueError(f"more than {MAX_VALUES} values")
    fields = read_line(line)
    try:
        number = _id.decode(fields.get("id", _NULL))
    except msgspec.DecodeError:
        raise ValueError("an id is a number or a text") from None
    try:
        method = _name.decode(fields.get("method", _NULL))
    except msgspec.DecodeError:
        method = ""
    return Incoming(number, method, fields.get("params", _NOTHING))


def decode(raw: Raw | bytes, kind: Any) -> Any:  # noqa: ANN401 - the type that `kind` names, perhaps a union
    """Decode JSON as the type `kind`; raise ValueError with msgspec's message, which includes the path of the error."""
    try:
        return msgspec.json.decode(raw, type=kind)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except msgspec.DecodeError as error:
        raise ValueError(mistake(error)) from None


def mistake(error: Exception) -> str:
    """Return msgspec's error message; for a null in place of a number, add that the number was not finite."""
    return _NO_NUMBER.sub(_NOT_FINITE, str(error))


_NO_NUMBER: Final = re.compile(r"Expected `(?:float|int)(?: \| \w+)*`, got `null`")
_NOT_FINITE: Final = "NaN or an infinite number (null in JSON) where a finite one is needed"


def request_line(number: int | None, method: str, request: object) -> bytes:
    """Encode a request as a line; a request whose `number` is None is not answered."""
    message = {"method": method, "params": request} if number is None else _request(number, method, request)
    return _encode(message) + b"\n"


def _request(number: int, method: str, request: object) -> dict[str, object]:
    return {"id": number, "method": method, "params": request}


def answer_line(number: Id, answer: object) -> bytes:
    """Encode the reply to a request as a line."""
    return _encode({"id": number, "result": answer}) + b"\n"


def error_line(number: Id, kind: str, message: str) -> bytes:
    """Encode the refusal of a request as a line."""
    return _encode({"id": number, "error": Refusal(kind, message)}) + b"\n"


def push_line(key: str, message: object) -> bytes:
    """Encode a pushed message as a line."""
    return _encode({key: message}) + b"\n"


def text_of(message: object, *, indent: int = 0) -> bytes:
    """Encode a message as JSON without a final newline, on several lines if `indent` is set."""
    return msgspec.json.format(_encode(message), indent=indent) if indent else _encode(message)


def plain(message: object) -> Any:  # noqa: ANN401 - what JSON holds
    """Convert a message to dicts, lists, texts and numbers, as in `--json` and files; nan becomes None."""
    return msgspec.json.decode(_encode(message))


def attributes(source: object, kind: Any) -> Any:  # noqa: ANN401 - the type that `kind` names
    """Convert an object, or a list of objects, to the type `kind` by reading attributes."""
    return msgspec.convert(source, kind, from_attributes=True)


def convert(document: object, kind: type[T]) -> T:
    """Convert dicts and lists (see `plain`) to a message; raise ValueError with the path of the error."""
    try:
        return msgspec.convert(document, kind)
    except msgspec.ValidationError as error:
        raise ValueError(str(error)) from None
