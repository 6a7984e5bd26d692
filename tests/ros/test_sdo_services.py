"""SDO through services: ros2_canopen's, and those for every type."""

from __future__ import annotations

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.ros.sdo_services import Address, as_uint32, decode, encode, of_datatype, of_uint32, parse_address


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("0x6041", Address(0x6041, 0, "")),
        ("6041:1f", Address(0x6041, 0x1F, "")),
        ("0x1008:00 str", Address(0x1008, 0, "str")),
        ("0x60FF:00/i32", Address(0x60FF, 0, "i32")),
    ],
)
def test_an_object_is_written_in_hexadecimal_with_or_without_a_type(text, address):
    assert parse_address(text) == address
    assert str(address) == f"0x{address.index:04X}:{address.subindex:02X}"


@pytest.mark.parametrize("text", ["", "x", "0x60411", "0x6041:100", "0x6041 u128", "speed"])
def test_what_is_not_an_object_is_a_sentence(text):
    with pytest.raises(ValueError, match=r"is not an object|is not a type"):
        parse_address(text)


@given(st.text())
def test_any_text_is_an_address_or_a_sentence(text):
    with contextlib.suppress(ValueError):
        assert 0 <= parse_address(text).index <= 0xFFFF


@pytest.mark.parametrize(
    ("value", "kind"),
    [(True, "bool"), (-1, "i8"), (-300, "i16"), (-70000, "i32"), (-(1 << 40), "i64"), (200, "u8"), (60000, "u16"),
     (1 << 31, "u32"), (1 << 63, "u64"), (0.5, "f32"), (math.pi, "f64"), ("TMCM-1270", "str"), (b"\0\1\2", "bytes")],
)  # fmt: skip
def test_every_type_goes_out_and_returns(value, kind):
    assert decode(encode(value, kind, 0), kind) == value


def test_without_a_type_the_length_decides():
    assert decode(b"\x2c\x01", "") == 300
    assert decode(b"abc", "") == b"abc"
    assert encode(-2, "", 2) == b"\xfe\xff"
    assert encode(1.0, "", 4) == b"\0\0\x80\x3f"


@pytest.mark.parametrize(("value", "kind", "length"), [(256, "u8", 0), (-1, "u32", 0), (70000, "", 2), ("x", "", 4)])
def test_what_does_not_fit_is_a_sentence(value, kind, length):
    if isinstance(value, str):
        assert encode(value, kind, length) == b"x"
    else:
        with pytest.raises(ValueError, match="does not fit"):
            encode(value, kind, length)
    with pytest.raises(ValueError, match="bytes"):
        decode(b"abc", "u16")


@given(st.integers(1, 4), st.data())
def test_data_of_a_service_is_the_objects_bytes_also_where_they_are_negative(length, data):
    raw = data.draw(st.binary(min_size=length, max_size=length))
    assert of_uint32(as_uint32(raw), length) == raw
    signed = int.from_bytes(raw, "little", signed=True)
    assert of_uint32(signed & 0xFFFFFFFF, length) == raw


def test_data_that_is_too_large_for_the_object_is_refused():
    with pytest.raises(ValueError, match="does not fit"):
        of_uint32(256, 1)
    with pytest.raises(ValueError, match="set_objects"):
        of_uint32(1, 8)
    with pytest.raises(ValueError, match="get_objects"):
        as_uint32(bytes(5))


def test_the_data_types_of_the_services_are_those_of_the_standard():
    assert [of_datatype(number) for number in range(2, 8)] == [1, 2, 4, 1, 2, 4]
    with pytest.raises(ValueError, match="data type 8 is not supported"):
        of_datatype(8)


NODES = [{"name": "left_drive", "node_id": 3}]
ABORT = "node 3 (left_drive): 0x{index:04X}:{subindex:02X}: abort 0x06020000 (object does not exist)"
LENGTH = "node 3 (left_drive): 0x{index:04X}:{subindex:02X}: abort 0x06070010 (length does not match)"


class Objects:
    """The objects of a node; some can only be written."""

    def __init__(self):
        self.held = {
            (0x6083, 0): b"\x80\x3e\0\0",
            (0x6098, 0): b"\xff",
            (0x1008, 0): b"TMCM-1270",
            (0x2100, 0): b"12345678",
        }
        self.writable = {(0x2001, 0): 2}

    def read(self, params):
        return {"data": self.held[self.key(params, self.held)].hex()}

    def write(self, params):
        key, data = self.key(params, {**self.held, **self.writable}), bytes.fromhex(params["data"])
        length = self.writable.get(key)
        if length is not None and len(data) != length:
            raise LookupError(LENGTH.format(**params))
        self.held[key] = data
        return {}

    def key(self, params, known):
        key = (params["index"], params["subindex"])
        if params["node"] not in ("left_drive", "3") or key not in known:
            raise LookupError(ABORT.format(**params))
        return key


@pytest.fixture
def objects(fresh):
    objects = Objects()
    fresh.robot.answers.update(sdo_read=objects.read, sdo_write=objects.write)
    return objects


@pytest.fixture
def call(fresh, maker):
    def call(service, kind, **data):
        return maker.order("call", service=f"/{service}", of=kind, data=data)["response"]

    return call


@pytest.mark.ros
def test_sdo_read_and_write_are_those_of_ros2_canopen(objects, call):
    assert call("left_drive/sdo_read", "canopen_interfaces/srv/CORead", index=0x6083) == {
        "success": True,
        "data": 16000,
    }
    written = call("left_drive/sdo_write", "canopen_interfaces/srv/COWrite", index=0x6083, data=100)
    assert written == {"success": True}
    assert objects.held[0x6083, 0] == b"\x64\0\0\0"


@pytest.mark.ros
def test_a_negative_value_is_two_complement_in_the_width_of_the_object(objects, call):
    call("left_drive/sdo_write", "canopen_interfaces/srv/COWrite", index=0x6098, data=0xFFFFFFFE)
    assert objects.held[0x6098, 0] == b"\xfe"


@pytest.mark.ros
def test_an_object_that_can_only_be_written_is_written_in_the_width_that_the_node_takes(objects, call):
    assert call("left_drive/sdo_write", "canopen_interfaces/srv/COWrite", index=0x2001, data=7) == {"success": True}
    assert objects.held[0x2001, 0] == b"\7\0"


@pytest.mark.ros
def test_what_the_node_refuses_is_not_a_success(objects, call):
    assert call("left_drive/sdo_read", "canopen_interfaces/srv/CORead", index=0x5FFF)["success"] is False
    assert call("left_drive/sdo_write", "canopen_interfaces/srv/COWrite", index=0x5FFF, data=1) == {"success": False}
    too_long = call("left_drive/sdo_read", "canopen_interfaces/srv/CORead", index=0x1008)
    assert too_long == {"success": False, "data": 0}


@pytest.mark.ros
def test_the_masters_services_name_the_node_by_its_id(objects, call):
    read = "canopen_interfaces/srv/COReadID"
    write = "canopen_interfaces/srv/COWriteID"
    assert call("master/sdo_read", read, nodeid=3, index=0x6083, canopen_datatype=7) == {"success": True, "data": 16000}
    assert call("master/sdo_write", write, nodeid=3, index=0x6083, canopen_datatype=7, data=5) == {"success": True}
    assert objects.held[0x6083, 0] == b"\5\0\0\0"
    assert call("master/sdo_read", read, nodeid=9, index=0x6083, canopen_datatype=7)["success"] is False
    assert call("master/sdo_read", read, nodeid=3, index=0x6083, canopen_datatype=1)["success"] is False


@pytest.mark.ros
def test_objects_of_every_type_are_read_with_the_reason_where_it_fails(objects, call):
    names = ["0x6083", "0x1008:00 str", "0x6098 i8", "0x2100:00 f64", "0x2100 bytes", "0x5FFF", "nonsense"]
    values = call("left_drive/get_objects", "rcl_interfaces/srv/GetParameters", names=names)["values"]
    assert [value["type"] for value in values] == [2, 4, 2, 3, 5, 0, 0]
    assert values[0]["integer_value"] == 16000
    assert values[1]["string_value"] == "TMCM-1270"
    assert values[2]["integer_value"] == -1
    assert values[4]["byte_array_value"] == list(b"12345678")
    assert values[5]["string_value"].endswith("0x5FFF:00: abort 0x06020000 (object does not exist)")
    assert values[6]["string_value"].startswith("'nonsense' is not an object")


@pytest.mark.ros
def test_objects_are_written_one_after_the_other_with_the_reason_where_it_fails(objects, call):
    parameters = [
        {"name": "0x6083", "value": {"type": 2, "integer_value": 77}},
        {"name": "0x1008", "value": {"type": 4, "string_value": "name"}},
        {"name": "0x2100 f64", "value": {"type": 3, "double_value": 0.5}},
        {"name": "0x6098", "value": {"type": 2, "integer_value": 1000}},
        {"name": "0x5FFF", "value": {"type": 2, "integer_value": 1}},
        {"name": "0x6083", "value": {"type": 9}},
    ]
    results = call("left_drive/set_objects", "rcl_interfaces/srv/SetParameters", parameters=parameters)["results"]
    assert [result["successful"] for result in results] == [True, True, True, False, False, False]
    assert objects.held[0x6083, 0] == b"\x4d\0\0\0"
    assert objects.held[0x1008, 0] == b"name"
    assert "does not fit" in results[3]["reason"]
    assert "abort 0x06020000" in results[4]["reason"]
    assert results[5]["reason"].startswith("type 9")
