import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.service_node import NodeStub

from canopen_control.cia402.state import State
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, RemoteError, SdoLengthError, SdoTimeout
from canopen_control.od.codec import decode
from canopen_control.od.eds import read_eds
from canopen_control.service.node_session import NodeSession, is_abort

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od


def session(objects=None, od=OD, **others):
    return NodeSession(NodeStub(objects or {}), 5, od, **others)


def test_values_have_the_types_of_the_eds_both_ways():
    node = session({(0x6081, 0): bytes(4)})
    entry = OD[0x6081, 0]
    node.write_value(entry, 1600)
    assert node.transfers.objects[0x6081, 0] == (1600).to_bytes(4, "little")
    assert node.read_value(entry) == 1600


def test_a_value_that_the_type_cannot_hold_is_told_with_its_object():
    with pytest.raises(ConfigError, match=r"node 5 \(turn\): 0x6060:00 .*holds -128 to 127"):
        session(name="turn").write_value(OD[0x6060, 0], 500)


def test_an_answer_of_another_length_is_told_with_its_object():
    with pytest.raises(SdoLengthError, match=r"0x6081:00.*2 bytes \(01 02\), UNSIGNED32 has 4; is this the EDS"):
        session({(0x6081, 0): b"\1\2"}).read_value(OD[0x6081, 0])


@given(st.sampled_from([entry for entry in OD if entry.data_type.bits]), st.data())
def test_what_is_written_is_read_back(entry, data):
    size = ((entry.data_type.bits or 0) + 7) // 8
    value = decode(data.draw(st.binary(min_size=size, max_size=size)), entry.data_type)
    node = session()
    if value == value:  # a nan is read back as one, and equals nothing
        node.write_value(entry, value)
        assert node.read_value(entry) == value


def test_an_identity_is_compared_to_the_eds_where_that_tells_one():
    good = {(0x1018, 1): (0x286).to_bytes(4, "little"), (0x1018, 2): (0x4F6).to_bytes(4, "little")}
    assert session(good).identity_differences() == []
    assert session({**good, (0x1018, 1): (0x287).to_bytes(4, "little")}).identity_differences() == [
        "vendor 0x00000286 in the EDS, 0x00000287 found"
    ]
    assert session().identity_differences()[1] == "product 0x000004F6 in the EDS, none found"
    assert session(good).identity() == {1: 0x286, 2: 0x4F6, 3: None, 4: None}


@pytest.mark.parametrize(
    ("word", "state", "powered"),
    [(0x0237, State.OPERATION_ENABLED, [0]), (0x0250, State.SWITCH_ON_DISABLED, []), (0x0001, None, [0])],
)
def test_the_state_of_the_drive_is_that_of_its_statusword(word, state, powered):
    node = session({(0x6041, 0): word.to_bytes(2, "little")})
    assert node.drive_states() == {0: state}
    assert node.powered_axes() == powered


def test_a_node_that_is_no_drive_has_no_states():
    assert session(od=None).drive_states() == {}


def test_without_an_eds_the_user_is_told_how_to_give_one():
    with pytest.raises(ConfigError, match="node 5: nothing tells what its objects are; give its EDS with --eds FILE"):
        assert session(od=None).dictionary


def test_a_silent_node_is_no_missing_object():
    node = session()
    node.transfers.error = SdoTimeout(5, 0x1018, 1, 0.5)
    with pytest.raises(SdoTimeout):
        node.number(0x1018, 1)


def test_a_refusal_of_one_object_is_known_through_a_robot_too():
    assert is_abort(RemoteError("SdoAbort", "node 5: no such object"))
    assert not is_abort(RemoteError("SdoTimeout", "node 5: no answer"))
