import pytest
from support.service_node import NodeStub

from canopen_control.commissioning.driven_axis import error_history, fault_words, why_not_free
from canopen_control.commissioning.node_session import NodeSession
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds

OD = read_eds(data_path("eds", "generic_cia402.eds"), 5).od
FAULT, ENABLED, OFF = (word.to_bytes(2, "little") for word in (0x0218, 0x0237, 0x0250))


def session(statusword, **objects):
    result = {(0x6041, 0): statusword, **{(int(name[1:], 16), 0): data for name, data in objects.items()}}
    return NodeSession(NodeStub(result), 5, OD)


def test_a_drive_without_a_fault_has_nothing_to_report():
    assert (fault_words(session(OFF)), why_not_free(session(OFF))) == ("", "")


def test_a_fault_is_reported_by_its_code_and_the_error_register():
    words = fault_words(session(FAULT, x603F=b"\x20\x32", x1001=b"\x05"))
    assert words.startswith("0x3220 ")
    assert "register 0x05 (" in words


def test_without_an_error_code_only_the_history_is_reported():
    node = session(FAULT)
    assert fault_words(node) == "unknown (the drive reports no error code)"
    node.transfers.objects[0x1003, 1] = b"\x10\x43\x02\x00"
    assert fault_words(node).startswith("0x4310 ")


@pytest.mark.parametrize(("word", "free"), [(ENABLED, False), (FAULT, True), (b"\x01\x00", True)])
def test_a_drive_enabled_by_another_master_is_not_free(word, free):
    assert (why_not_free(session(word)) == "") is free
    if not free:
        assert "OPERATION ENABLED: another program" in why_not_free(session(word))


def test_the_error_history_is_reported_newest_first():
    held = {(0x1003, 0): b"\2", (0x1003, 1): (0x00012310).to_bytes(4, "little"), (0x1003, 2): b"\x10\x81\0\0"}
    result = error_history(NodeSession(NodeStub(held), 5, None))
    assert [item[:6] for item in result] == ["0x2310", "0x8110"]
    assert result[0].endswith(", additional information 0x0001")
    assert error_history(NodeSession(NodeStub({(0x1003, 0): b"\0"}), 5, None)) == []
    with pytest.raises(ConfigError, match=r"node 5 has no error history \(0x1003\)"):
        error_history(NodeSession(NodeStub({}), 5, None))
