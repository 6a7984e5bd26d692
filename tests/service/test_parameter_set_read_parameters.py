import pytest
from support.service_node import NodeStub

from canopen_control.data_files import data_path
from canopen_control.errors import SdoTimeout
from canopen_control.od.codec import default_of, encode
from canopen_control.od.eds import read_eds
from canopen_control.service.node_session import NodeSession
from canopen_control.service.parameter_set import device_identity, read_parameters, read_values

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od


def node(**changes):
    objects = {entry.address: encode(default_of(entry), entry.data_type) for entry in OD if entry.readable}
    stub = NodeStub(objects | {(int(name[1:5], 16), 0): data for name, data in changes.items()})
    return NodeSession(stub, 5, OD)


def test_parameters_are_read_twice_and_progress_is_told():
    session, told = node(s6081=b"\x40\x06\0\0"), []
    found, left_out = read_parameters(session, told=lambda done, of: told.append((done, of)))
    assert (found.values[0x6081, 0], left_out) == (1600, [])
    assert session.transfers.reads.count((0x6081, 0)) == 2
    assert told[-1] == (len(told), told[0][1])
    assert session.transfers.written == []


def test_what_differs_between_two_readings_is_left_out():
    session = node()
    counter = iter(range(100))
    plain = session.transfers.read

    def read(index, subindex, *, block=False):
        data = plain(index, subindex, block=block)
        return next(counter).to_bytes(4, "little") if index == 0x6081 else data

    session.transfers.read = read
    found, left_out = read_parameters(session)
    assert (0x6081, 0) not in found.values
    assert [str(each) for each in left_out] == [
        "0x6081:00 Profile velocity: two readings differed, so it is no parameter"
    ]


def test_what_the_node_refuses_or_answers_in_another_length_is_left_out_with_the_reason():
    session = node(s6083=b"\1")
    del session.transfers.objects[0x6081, 0]
    found, left_out = read_parameters(session)
    assert {(0x6081, 0), (0x6083, 0)}.isdisjoint(found.values)
    assert [(each.entry.index, each.why.split(",")[0][:16]) for each in left_out] == [
        (0x6081, "abort 0x06020000"),
        (0x6083, "node 5: 0x6083:0"),
    ]


def test_a_node_that_does_not_answer_ends_it():
    session = node()
    session.transfers.error = SdoTimeout(5, 0x1000, 0, 0.5)
    with pytest.raises(SdoTimeout):
        read_values(session, [OD[0x6081, 0]])
    with pytest.raises(SdoTimeout):
        device_identity(session)


def test_the_identity_is_numbers_and_names():
    identity = device_identity(node(s1008=b"PD42\0\0", s1000=b"\x92\1\xff\xff"))
    assert (identity.device_type, identity.name) == (0xFFFF0192, "PD42")
