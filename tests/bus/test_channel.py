"""Names of channels: which kind each is, and what to write instead of a wrong one."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus import channel as channel_module
from canopen_control.bus.channel import ChannelKind, ChannelSpec, may_host_virtual_drives, open_port, parse_channel
from canopen_control.errors import ConfigError


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


def test_an_interface_that_is_no_can_interface_is_refused(no_interfaces):
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
