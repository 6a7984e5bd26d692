"""Channel names: kinds, and the correction suggested for an invalid name."""

from __future__ import annotations

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus import channel as channel_module
from canopen_control.bus.channel import (
    ChannelKind,
    ChannelSpec,
    may_host_virtual_drives,
    name_and_channel,
    open_port,
    parse_channel,
)
from canopen_control.errors import BusError, ConfigError


@pytest.fixture(autouse=True)
def no_interfaces(monkeypatch, tmp_path):
    monkeypatch.setattr(channel_module, "NETWORK_CLASS", tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("local:robby", ChannelSpec(ChannelKind.LOCAL, "robby")),
        ("memory:a-b_C9", ChannelSpec(ChannelKind.MEMORY, "a-b_C9")),
        ("virtual:x", ChannelSpec(ChannelKind.VIRTUAL, "x")),
        ("can0", ChannelSpec(ChannelKind.SOCKETCAN, "can0")),
        ("vcan12", ChannelSpec(ChannelKind.SOCKETCAN, "vcan12")),
        ("slcan1", ChannelSpec(ChannelKind.SOCKETCAN, "slcan1")),
        ("pcan:PCAN_USBBUS1", ChannelSpec(ChannelKind.PYTHON_CAN, "PCAN_USBBUS1", "pcan")),
        ("slcan:/dev/ttyACM0@500000", ChannelSpec(ChannelKind.PYTHON_CAN, "/dev/ttyACM0", "slcan", 500_000)),
        ("kvaser:0@1000000", ChannelSpec(ChannelKind.PYTHON_CAN, "0", "kvaser", 1_000_000)),
        ("gs_usb:1:2", ChannelSpec(ChannelKind.PYTHON_CAN, "1:2", "gs_usb")),
        ("canalystii:0,1@500000", ChannelSpec(ChannelKind.PYTHON_CAN, "0,1", "canalystii", 500_000)),
        (
            "kvaser:0@500000,single_handle=true,driver_mode=False",
            ChannelSpec(
                ChannelKind.PYTHON_CAN, "0", "kvaser", 500_000, (("single_handle", "true"), ("driver_mode", "False"))
            ),
        ),
        (
            "slcan:/dev/ttyACM0,ttyBaudrate=115200",
            ChannelSpec(ChannelKind.PYTHON_CAN, "/dev/ttyACM0", "slcan", None, (("ttyBaudrate", "115200"),)),
        ),
        ("socketcand:pi:29536/can0", ChannelSpec(ChannelKind.PYTHON_CAN, "pi:29536/can0", "socketcand")),
        ("remote:ws://pi:54701/", ChannelSpec(ChannelKind.PYTHON_CAN, "ws://pi:54701/", "remote")),
    ],
)
def test_a_name_is_taken_apart_and_put_together_again(text, spec):
    assert parse_channel(text) == spec
    assert str(spec) == text


def test_a_bus_is_inside_one_process_or_open_to_others_or_has_one_owner():
    kinds = {kind: (kind.in_process, kind.shared) for kind in ChannelKind}
    assert kinds == {
        ChannelKind.LOCAL: (False, True),
        ChannelKind.SOCKETCAN: (False, True),
        ChannelKind.MEMORY: (True, False),
        ChannelKind.VIRTUAL: (True, False),
        ChannelKind.PYTHON_CAN: (False, False),
    }


def test_an_unusual_interface_counts_once_it_exists(no_interfaces):
    with pytest.raises(ConfigError, match="no such CAN interface"):
        parse_channel("leftarm")
    (no_interfaces / "leftarm").mkdir()
    (no_interfaces / "leftarm" / "type").write_text("280\n")
    assert parse_channel("leftarm") == ChannelSpec(ChannelKind.SOCKETCAN, "leftarm")


def test_an_interface_that_is_not_a_can_interface_is_refused(no_interfaces):
    (no_interfaces / "eth0").mkdir()
    (no_interfaces / "eth0" / "type").write_text("1\n")
    with pytest.raises(ConfigError, match="eth0"):
        parse_channel("eth0")


def test_an_unusual_interface_can_be_named_before_it_exists():
    assert parse_channel("socketcan:leftarm") == ChannelSpec(ChannelKind.SOCKETCAN, "leftarm")


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("robby", "local:robby"),
        ("", "local:robby"),
        ("local:", "1 to 32 letters"),
        ("local:a b", "1 to 32 letters"),
        ("memory:" + "x" * 33, "1 to 32 letters"),
        (":x", "INTERFACE:CHANNEL"),
        ("pcan:", "INTERFACE:CHANNEL"),
        ("pcan:x@fast", "INTERFACE:CHANNEL@BITRATE"),
        ("pcan:x,bitrate=5", "write bitrate after an @"),
        ("pcan:x,channel=5", "write channel before the comma"),
        ("pcan:x,fd=true,fd=false", "fd is given twice"),
        ("socketcand:can0", "socketcand:HOST:PORT/CHANNEL"),
        ("socketcand:can0,host=pi", "socketcand:HOST:PORT/CHANNEL"),
    ],
)
def test_a_wrong_name_is_answered_with_a_right_one(text, hint):
    with pytest.raises(ConfigError, match=hint):
        parse_channel(text)


@given(st.text(max_size=40))
def test_any_text_is_a_channel_or_a_config_error(text):
    try:
        spec = parse_channel(text)
    except ConfigError as error:
        message = str(error)
    else:
        message = repr(text) if spec.name in text else ""
    assert repr(text) in message


@pytest.mark.parametrize(
    ("text", "may"),
    [("local:a", True), ("memory:a", True), ("virtual:a", True), ("vcan0", True), ("can0", False), ("pcan:x", False)],
)
def test_virtual_drives_live_only_where_no_real_one_can_be(text, may):
    assert may_host_virtual_drives(text) is may


def test_a_memory_port_is_opened_by_its_name():
    port = open_port("memory:by-name", label="me")
    assert (port.channel, port.label) == ("memory:by-name", "me")
    port.close()


@pytest.mark.parametrize(
    ("text", "inputs"),
    [
        ("virtual-like:0@500000,on=true,n=-3,f=1.5,s=a=b", {"bitrate": 500_000, "on": True, "n": -3, "f": 1.5,
                                                            "s": "a=b"}),
        ("socketcand:pi:1234/can7", {"channel": "can7", "host": "pi", "port": 1234}),
        ("socketcand:192.168.0.7/can0,tcp_tune=True", {"channel": "can0", "host": "192.168.0.7", "port": 29536,
                                                       "tcp_tune": True}),
        ("socketcand:can0,host=pi,port=1", {"channel": "can0", "host": "pi", "port": 1}),
    ],
)  # fmt: skip
def test_python_can_gets_the_keywords_with_their_types(monkeypatch, text, inputs):
    requested = {}

    def bus(**keywords):
        requested.update(keywords)
        raise can.CanInitializationError("no such device")

    monkeypatch.setattr(can, "Bus", bus)
    monkeypatch.setattr(can, "VALID_INTERFACES", {*can.VALID_INTERFACES, "virtual-like"})
    with pytest.raises(BusError, match="no such device"):
        open_port(text)
    assert {key: requested[key] for key in inputs} == inputs
    assert requested["interface"] == text.partition(":")[0]


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("can0", ("", "can0")),
        ("front=can0", ("front", "can0")),
        ("front=kvaser:0,fd=false", ("front", "kvaser:0,fd=false")),
        ("kvaser:0,fd=false", ("", "kvaser:0,fd=false")),
        ("socketcand:pi/can0,tcp_tune=true", ("", "socketcand:pi/can0,tcp_tune=true")),
        ("=can0", ("", "=can0")),
    ],
)
def test_the_name_of_a_bus_is_reported_from_keywords(text, parts):
    assert name_and_channel(text) == parts
