"""CDR serialisation of messages: the body in little endian, without the four-byte header.

Rules (OMG CDR, XCDR version 1, as written by Fast CDR): a number is aligned to its own size, at most eight, counted
from the beginning of the body; a string is its length including the final zero byte, the text and the zero byte; a
sequence is its length and its elements; an array is only its elements; an empty sequence has no alignment for elements.
Data from the network may be anything: an invalid or short body is a ValueError, never a wrong value.
"""

from __future__ import annotations

import struct
from array import array
from typing import TYPE_CHECKING, Any, Final

from canopen_control.ros.interfaces.definition import BOUNDED_STRING, DUMMY, NESTED, STRING, FieldType, Shape

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.ros.interfaces.definition import Structure

    Encoder = Callable[[Any, bytearray], None]
    Decoder = Callable[[memoryview, int], tuple[Any, int]]
    Codec = tuple[Encoder, Decoder]


#: codes of number types for the modules struct and array, by type id
NUMBERS: Final = {2: "b", 3: "B", 4: "h", 5: "H", 6: "i", 7: "I", 8: "q", 9: "Q", 10: "f", 11: "d"}
_BOOL: Final = 15
_BYTE: Final = 16
_LENGTH: Final = struct.Struct("<I")


class Codecs:
    """Cache of the encoders and decoders of structures; `class_of(name)` returns the Python class of a message."""

    def __init__(self, structure_of: Callable[[str], Structure], class_of: Callable[[str], type]) -> None:
        self._structure_of, self.class_of = structure_of, class_of
        self._codecs: dict[str, Codec] = {}

    def encode(self, name: str, message: object) -> bytes:
        """Return the CDR body of a message of type `name`; raise ValueError if a field has an unsuitable value."""
        body = bytearray()
        try:
            self.codec(name)[0](message, body)
        except (struct.error, TypeError, AttributeError, OverflowError) as error:
            raise ValueError(f"this is not a valid {name}: {error}") from error
        return bytes(body)

    def decode(self, name: str, body: bytes) -> Any:  # noqa: ANN401 - a message of the class of that name
        """Return the message in a CDR body; raise ValueError if the body is invalid. Trailing bytes are ignored."""
        try:
            return self.codec(name)[1](memoryview(body), 0)[0]
        except (struct.error, IndexError) as error:
            raise ValueError(f"not the body of a {name}: {error}") from error

    def codec(self, name: str) -> Codec:
        if name not in self._codecs:
            self._codecs[name] = self._make(name)
        return self._codecs[name]

    def _make(self, name: str) -> Codec:
        fields = [(field.name, self._of_type(field.type)) for field in self._structure_of(name).fields]
        encoders = [(field, codec[0]) for field, codec in fields]
        decoders = [(field, codec[1]) for field, codec in fields]
        make = self.class_of(name)

        def encode(message: object, body: bytearray) -> None:
            for field, encoder in encoders:
                encoder(0 if field == DUMMY else getattr(message, field), body)

        def decode(body: memoryview, at: int) -> tuple[object, int]:
            message = make()
            for field, decoder in decoders:
                value, at = decoder(body, at)
                if field != DUMMY:
                    setattr(message, field, value)
            return message, at

        return encode, decode

    def _of_type(self, kind: FieldType) -> Codec:
        if kind.shape is Shape.SCALAR:
            return self._scalar(kind)
        if kind.base in NUMBERS:
            return _numbers(NUMBERS[kind.base], kind)
        return _elements(self._scalar(FieldType(kind.base, nested=kind.nested)), kind)

    def _scalar(self, kind: FieldType) -> Codec:
        if kind.base == NESTED:
            return self.codec(kind.nested)
        if kind.base in (STRING, BOUNDED_STRING):
            return _encode_string, _decode_string
        if kind.base == _BOOL:
            return (lambda value, body: body.append(bool(value))), (lambda body, at: (body[at] != 0, at + 1))
        if kind.base == _BYTE:
            return _encode_byte, (lambda body, at: (bytes((body[at],)), at + 1))
        return _number(NUMBERS[kind.base])


def size_of(base: int) -> int:
    """Return the size in bytes of a number, bool or byte by its type id."""
    return struct.calcsize(f"<{NUMBERS[base]}") if base in NUMBERS else 1


def _number(code: str) -> Codec:
    packer = struct.Struct(f"<{code}")
    size, pack, unpack = packer.size, packer.pack, packer.unpack_from

    def encode(value: object, body: bytearray) -> None:
        body.extend(bytes(-len(body) % size))
        body.extend(pack(value))

    def decode(body: memoryview, at: int) -> tuple[object, int]:
        at += -at % size
        return unpack(body, at)[0], at + size

    return encode, decode


def _encode_byte(value: bytes, body: bytearray) -> None:
    if len(value) != 1:
        raise ValueError(f"a field of type byte needs one byte, not {value!r}")
    body.extend(value)


def _encode_string(value: str, body: bytearray) -> None:
    text = value.encode() + b"\0"
    _put_length(len(text), body)
    body.extend(text)


def _decode_string(body: memoryview, at: int) -> tuple[str, int]:
    length, at = _length(body, at)
    _demand(body, at, length)
    # as in rosidl_generator_py: text that is not UTF-8 does not make the message invalid
    return str(body[at : at + max(length - 1, 0)], "utf-8", "replace"), at + length


def _numbers(code: str, kind: FieldType) -> Codec:
    size = struct.calcsize(f"<{code}")

    def encode(values: Any, body: bytearray) -> None:  # noqa: ANN401 - any sequence of numbers
        numbers = values if isinstance(values, array) and values.typecode == code else array(code, list(values))
        _put_count(len(numbers), kind, body)
        if numbers:
            body.extend(bytes(-len(body) % size))
            body.extend(numbers.tobytes())

    def decode(body: memoryview, at: int) -> tuple[object, int]:
        count, at = _count(kind, body, at)
        numbers = array(code)
        if count:
            at += -at % size
            _demand(body, at, count * size)
            numbers.frombytes(body[at : at + count * size])
        return numbers, at + count * size

    return encode, decode


def _elements(codec: Codec, kind: FieldType) -> Codec:
    encode_one, decode_one = codec

    def encode(values: Any, body: bytearray) -> None:  # noqa: ANN401 - any sequence
        _put_count(len(values), kind, body)
        for value in values:
            encode_one(value, body)

    def decode(body: memoryview, at: int) -> tuple[list[object], int]:
        count, at = _count(kind, body, at)
        _demand(body, at, count)  # no element is smaller than a byte
        values = []
        for _ in range(count):
            value, at = decode_one(body, at)
            values.append(value)
        return values, at

    return encode, decode


def _put_count(count: int, kind: FieldType, body: bytearray) -> None:
    if kind.shape is Shape.ARRAY:
        if count != kind.capacity:
            raise ValueError(f"an array of {kind.capacity} elements cannot have {count}")
        return
    if kind.shape is Shape.BOUNDED_SEQUENCE and count > kind.capacity:
        raise ValueError(f"a sequence of at most {kind.capacity} elements cannot have {count}")
    _put_length(count, body)


def _count(kind: FieldType, body: memoryview, at: int) -> tuple[int, int]:
    return (kind.capacity, at) if kind.shape is Shape.ARRAY else _length(body, at)


def _put_length(length: int, body: bytearray) -> None:
    body.extend(bytes(-len(body) % 4))
    body.extend(_LENGTH.pack(length))


def _length(body: memoryview, at: int) -> tuple[int, int]:
    at += -at % 4
    return int(_LENGTH.unpack_from(body, at)[0]), at + 4


def _demand(body: memoryview, at: int, length: int) -> None:
    if at + length > len(body):
        raise ValueError(f"{length} bytes are announced, but only {max(len(body) - at, 0)} follow")
