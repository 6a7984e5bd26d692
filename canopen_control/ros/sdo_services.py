"""SDO services as in ros2_canopen, and services for objects of any type that also report errors.

`/NODE/sdo_read`, `/NODE/sdo_write`, `/master/sdo_read` and `/master/sdo_write` answer as in ros2_canopen; they have no
field for a reason, which is logged. `get_objects` and `set_objects` use service types that every ROS installation has
(rcl_interfaces, GetParameters and SetParameters): an object is named "0x1008:00 str", the value is in the field of its
type, and if an object cannot be read or written `string_value` or `reason` contains the reason.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from canopen_control.ros.interfaces import interface
from canopen_control.rpc.messages.robot import SdoRead, SdoWrite

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.ros.endpoint import Handler, NodeContext, Reply, RosMessage
    from canopen_control.rpc.messages.declare import Done
    from canopen_control.rpc.messages.robot import SdoData


# Objects of a node in ROS messages: addresses as text; values as numbers, text or bytes. No ROS is imported here.
#
# Rules (CiA 301): numbers are little endian, with the size of their data type. ros2_canopen transfers every value as an
# unsigned number of 32 bits: negative numbers as two's complement and REAL32 as its bit pattern.


Value = int | float | str | bytes | bool
#: struct formats by the names of the data types in `sdo --type`
_FORMATS: Final = {
    "bool": "<?", "i8": "<b", "i16": "<h", "i32": "<i", "i64": "<q", "u8": "<B", "u16": "<H", "u32": "<I", "u64": "<Q",
    "f32": "<f", "f64": "<d",
}  # fmt: skip
_TEXTS: Final = ("str", "bytes")
#: sizes in bytes of the data types of COReadID and COWriteID, by their index (CiA 301, table 44)
_SIZES: Final = {2: 1, 3: 2, 4: 4, 5: 1, 6: 2, 7: 4}
_ADDRESS: Final = re.compile(r"(?:0x)?([0-9A-Fa-f]{4})(?::([0-9A-Fa-f]{1,2}))?(?:[ /](\w+))?")


@dataclass(frozen=True, slots=True)
class Address:
    """Address of an object with a data type; the type "" means an unsigned integer of the object's length."""

    index: int
    subindex: int
    kind: str

    def __str__(self) -> str:
        return f"0x{self.index:04X}:{self.subindex:02X}"


def parse_address(text: str) -> Address:
    """Parse "0x6041", "6041:00" or "0x1008:00 str"; raise ValueError with the reason if the text is invalid."""
    match = _ADDRESS.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"{text!r} is not an object; write INDEX[:SUB] [TYPE] in hexadecimal, such as 0x6083:00 u32")
    index, subindex, kind = match[1], match[2] or "0", match[3] or ""
    if kind not in ("", *_FORMATS, *_TEXTS):
        raise ValueError(f"{text!r}: {kind!r} is not a type; give one of {', '.join((*_FORMATS, *_TEXTS))}")
    return Address(int(index, 16), int(subindex, 16), kind)


def decode(data: bytes, kind: str) -> Value:
    """Return the value of an object's data; raise ValueError if the length does not match the data type."""
    if kind == "str":
        return data.rstrip(b"\0").decode("utf-8", "replace")
    if kind in _FORMATS:
        layout = struct.Struct(_FORMATS[kind])
        if len(data) != layout.size:
            raise ValueError(f"the object has {len(data)} bytes, but {kind} has {layout.size}")
        value: Value = layout.unpack(data)[0]
        return value
    return int.from_bytes(data, "little") if not kind and len(data) in (1, 2, 4, 8) else data


def encode(value: Value, kind: str, length: int) -> bytes:
    """Return a value as the data of an object of `length` bytes or of type `kind`; raise ValueError if out of range."""
    try:
        if isinstance(value, bytes):
            return value
        if isinstance(value, str):
            return value.encode()
        if kind in _FORMATS:
            return struct.pack(_FORMATS[kind], value)
        if isinstance(value, float):
            return struct.pack("<f" if length == 4 else "<d", value)
        return int(value).to_bytes(length, "little", signed=value < 0)
    except (struct.error, OverflowError) as error:
        raise ValueError(f"{value!r} does not fit into {kind or f'{length} bytes'}: {error}") from None


def of_datatype(datatype: int) -> int:
    """Return the size in bytes of a data type index of COReadID; raise ValueError if the type is not supported."""
    if datatype not in _SIZES:
        raise ValueError(
            f"data type {datatype} is not supported; give INT8 2, INT16 3, INT32 4, UINT8 5, UINT16 6 or UINT32 7"
        )
    return _SIZES[datatype]


def as_uint32(data: bytes) -> int:
    """Return an object's data as the 32-bit `data` field of ros2_canopen; raise ValueError if longer than 4 bytes."""
    if len(data) > 4:
        raise ValueError(f"the object has {len(data)} bytes, but `data` has 4; use get_objects")
    return int.from_bytes(data, "little")


def of_uint32(data: int, length: int) -> bytes:
    """Return the `data` of ros2_canopen as `length` bytes, 1 to 4; raise ValueError if the number does not fit."""
    signed = data - (1 << 32) if data >= 1 << 31 else data
    if not 1 <= length <= 4:
        raise ValueError(f"the object has {length} bytes, but `data` has 4; use set_objects")
    if data >= 1 << 8 * length and not -(1 << 8 * length - 1) <= signed < 0:
        raise ValueError(f"{data} does not fit into {length} bytes")
    return (data & ((1 << 8 * length) - 1)).to_bytes(length, "little")


#: type of rcl_interfaces/msg/ParameterValue -> field of such a value
_FIELDS: Final = {1: "bool_value", 2: "integer_value", 3: "double_value", 4: "string_value", 5: "byte_array_value"}
_TYPE_OF: Final[dict[type, int]] = {bool: 1, int: 2, float: 3, str: 4, bytes: 5}
#: sizes in bytes to try for an object that cannot be read, the most common size first
_WIDTHS: Final = (4, 2, 1)
_WRONG_LENGTH: Final = ("06070010", "06070012", "06070013")  # abort codes for a wrong length (CiA 301, table 22)
_LARGEST: Final = (1 << 63) - 1


class NodeSdo:
    """SDO services of one node; `name` is the node's name in the API."""

    def __init__(self, ros: NodeContext, name: str) -> None:
        self._ros, self._name = ros, name

    def handlers(self) -> list[tuple[str, str, Handler]]:
        """Return the name, type and handler of each service."""
        return [
            ("sdo_read", "canopen_interfaces/srv/CORead", self._read),
            ("sdo_write", "canopen_interfaces/srv/COWrite", self._write),
            ("get_objects", "rcl_interfaces/srv/GetParameters", self._get),
            ("set_objects", "rcl_interfaces/srv/SetParameters", self._set),
        ]

    def _read(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        read_uint32(self._ros, self._name, Address(request.index, request.subindex, ""), response, reply)

    def _write(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        address = Address(request.index, request.subindex, "")
        on_done = _responder(self._ros, self._name, response, reply)
        write_object(self._ros, self._name, address, lambda length: of_uint32(request.data, length), on_done)

    def _get(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        make = interface("rcl_interfaces/msg/ParameterValue")
        response.values = [make() for _ in request.names]

        def one(number: int, text: str, done: Callable[[], None]) -> None:
            def answer(result: SdoData | None, error: str | None) -> None:
                _fill(response.values[number], address.kind, result, error)
                done()

            try:
                address = parse_address(text)
            except ValueError as error:
                response.values[number].string_value = str(error)
                done()
                return
            self._ros.ask(_read_request(self._name, address), answer)

        _one_by_one(list(request.names), one, lambda: reply(response))

    def _set(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        make = interface("rcl_interfaces/msg/SetParametersResult")
        response.results = [make() for _ in request.parameters]

        def one(number: int, parameter: RosMessage, done: Callable[[], None]) -> None:
            def answer(error: str | None) -> None:
                response.results[number].successful, response.results[number].reason = error is None, error or ""
                done()

            try:
                address, value = parse_address(parameter.name), _value_of(parameter.value)
            except ValueError as error:
                answer(str(error))
                return
            write_object(self._ros, self._name, address, lambda length: encode(value, address.kind, length), answer)

        _one_by_one(list(request.parameters), one, lambda: reply(response))


def master_handlers(ros: NodeContext) -> list[tuple[str, str, Handler]]:
    """Return the name, type and handler of each SDO service of ros2_canopen's master; requests have a node-ID."""

    def read(request: RosMessage, response: RosMessage, reply: Reply) -> None:
        of_datatype(request.canopen_datatype)
        address = Address(request.index, request.subindex, "")
        read_uint32(ros, str(request.nodeid), address, response, reply)

    def write(request: RosMessage, response: RosMessage, reply: Reply) -> None:
        data = of_uint32(request.data, of_datatype(request.canopen_datatype))
        address = Address(request.index, request.subindex, "")
        node = str(request.nodeid)
        write_object(ros, node, address, lambda _: data, _responder(ros, node, response, reply), width=len(data))

    return [
        ("sdo_read", "canopen_interfaces/srv/COReadID", read),
        ("sdo_write", "canopen_interfaces/srv/COWriteID", write),
    ]


def read_uint32(ros: NodeContext, node: str, address: Address, response: RosMessage, reply: Reply) -> None:
    """Read an object, set `success` and `data` of the response, and send it; errors are logged."""

    def answer(result: SdoData | None, error: str | None) -> None:
        try:
            if result is not None:
                response.data, response.success = as_uint32(result.data), True
        except ValueError as problem:
            error = f"{node} {address}: {problem}"
        if error is not None:
            ros.warn(f"{node}/sdo", error)
        reply(response)

    ros.ask(_read_request(node, address), answer)


def write_object(
    ros: NodeContext,
    node: str,
    address: Address,
    make: Callable[[int], bytes],
    on_done: Callable[[str | None], object],
    *,
    width: int | None = None,
) -> None:
    """Write an object and call `on_done(error)`, with None on success; `make(length)` returns the data.

    The data type of the object is unknown here: the object is read first to find its length; if it cannot be read, the
    common lengths are tried, because a node refuses a wrong length. Neither is needed with a `width`, or with a type in
    the address.
    """
    if width is not None or address.kind:
        _write_as(ros, node, address, make, (width or 0,), on_done)
        return

    def answer(result: SdoData | None, _error: str | None) -> None:
        lengths = _WIDTHS if result is None else (len(result.data),)
        _write_as(ros, node, address, make, lengths, on_done)

    ros.ask(_read_request(node, address), answer)


def _write_as(
    ros: NodeContext,
    node: str,
    address: Address,
    make: Callable[[int], bytes],
    lengths: Sequence[int],
    on_done: Callable[[str | None], object],
) -> None:
    length, *further = lengths

    def answer(_done: Done | None, error: str | None) -> None:
        if error is not None and further and any(code in error.upper() for code in _WRONG_LENGTH):
            _write_as(ros, node, address, make, further, on_done)
        else:
            on_done(error)

    try:
        data = make(length)
    except ValueError as problem:
        if further:
            _write_as(ros, node, address, make, further, on_done)
        else:
            on_done(f"{node} {address}: {problem}")
        return
    ros.ask(SdoWrite(node=node, index=address.index, subindex=address.subindex, data=data), answer)


def _read_request(node: str, address: Address) -> SdoRead:
    return SdoRead(node=node, index=address.index, subindex=address.subindex)


def _responder(ros: NodeContext, node: str, response: RosMessage, reply: Reply) -> Callable[[str | None], None]:
    """Return a callback that sends the response with `success` set, and logs an error."""

    def answer(error: str | None) -> None:
        if error is not None:
            ros.warn(f"{node}/sdo", error)
        response.success = error is None
        reply(response)

    return answer


def _one_by_one(
    items: list[Any], call_one: Callable[[int, Any, Callable[[], None]], None], done: Callable[[], object]
) -> None:
    """Run the requests one after the other, since a node processes one SDO transfer at a time."""

    def call_from(number: int) -> None:
        if number == len(items):
            done()
        else:
            call_one(number, items[number], lambda: call_from(number + 1))

    call_from(0)


def _fill(into: RosMessage, kind: str, result: SdoData | None, error: str | None) -> None:
    """Set a ParameterValue to an object's value; after an error, set its text to the reason, without a type."""
    try:
        if result is None:
            raise ValueError(error)
        value: Value = decode(result.data, kind)
        if isinstance(value, int) and value > _LARGEST:
            value = value.to_bytes(8, "little")  # a parameter is an int64
        content: object = [bytes([octet]) for octet in value] if isinstance(value, bytes) else value
        into.type = _TYPE_OF[type(value)]
        setattr(into, _FIELDS[into.type], content)
    except ValueError as problem:
        into.string_value = str(problem)


def _value_of(value: RosMessage) -> Value:
    if value.type not in _FIELDS:
        raise ValueError(
            f"type {value.type} is not supported; give a bool 1, integer 2, double 3, string 4 or byte array 5"
        )
    content = getattr(value, _FIELDS[value.type])
    return b"".join(content) if value.type == _TYPE_OF[bytes] else content
