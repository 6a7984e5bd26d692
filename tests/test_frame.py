from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.services import frame, frames, vectors

from canopen_control.frame import (
    BROADCAST,
    ERROR_FLAG,
    EXTENDED_BIT,
    EXTENDED_FLAG,
    RECORD_SIZE,
    REMOTE_FLAG,
    CanFrame,
    Service,
    can_id_of,
    cob_id,
    frames_of,
    pack_records,
    remote_frame,
    rpdo_cob_id,
    service_of,
    tpdo_cob_id,
)

COB_IDS = vectors()["cob_ids"]
RPDOS = (Service.RPDO1, Service.RPDO2, Service.RPDO3, Service.RPDO4)
TPDOS = (Service.TPDO1, Service.TPDO2, Service.TPDO3, Service.TPDO4)
FORMULAS = {
    "NMT": Service.NMT,
    "SYNC": Service.SYNC,
    "TIME": Service.TIME,
    "EMCY": Service.EMCY,
    **{f"RPDO{number}": service for number, service in enumerate(RPDOS, 1)},
    **{f"TPDO{number}": service for number, service in enumerate(TPDOS, 1)},
    "SDO_tx(server->client)": Service.SDO_SERVER,
    "SDO_rx(client->server)": Service.SDO_CLIENT,
    "heartbeat": Service.HEARTBEAT,
    "LSS_slave": Service.LSS_SLAVE,
    "LSS_master": Service.LSS_MASTER,
}


@pytest.mark.parametrize("name", COB_IDS["formulas"])
def test_the_formulas_are_the_vectors(name):
    base, _, offset = COB_IDS["formulas"][name].partition("+")
    for node_id in (1, 2, 127):
        assert cob_id(FORMULAS[name], node_id) == int(base, 16) + (node_id if offset else 0)


@pytest.mark.parametrize(("node_id", "expected"), [(int(n), ids) for n, ids in COB_IDS["per_node"].items()])
def test_the_identifiers_of_a_node_are_the_vectors(node_id, expected):
    single = {"emcy": Service.EMCY, "sdo_tx": Service.SDO_SERVER, "sdo_rx": Service.SDO_CLIENT, "hb": Service.HEARTBEAT}
    for key, service in single.items():
        identifier = int(expected[key], 16)
        assert cob_id(service, node_id) == identifier
        assert service_of(identifier) == (service, node_id)
    for key, by_number, services in (("tpdo", tpdo_cob_id, TPDOS), ("rpdo", rpdo_cob_id, RPDOS)):
        for number, (text, service) in enumerate(zip(expected[key], services, strict=True), 1):
            assert by_number(number, node_id) == cob_id(service, node_id) == int(text, 16)
            assert service_of(int(text, 16)) == (service, node_id)


@pytest.mark.parametrize("service", [Service.NMT, Service.SYNC, Service.TIME, Service.LSS_SLAVE, Service.LSS_MASTER])
def test_services_without_a_node_are_for_all(service):
    assert service_of(service.value) == (service, BROADCAST)


@given(st.integers(0, 0x7FF))
def test_service_of_is_the_inverse_of_cob_id(identifier):
    result = service_of(identifier)
    if result is not None:
        assert cob_id(*result) == identifier


@pytest.mark.parametrize("identifier", [0x001, 0x101, 0x180, 0x580, 0x600, 0x680, 0x700, 0x7FF])
def test_identifiers_outside_of_the_set_are_none(identifier):
    assert service_of(identifier) is None


def test_flags_report_what_a_frame_is():
    kinds = [
        (f.is_remote, f.is_error)
        for f in (CanFrame(0x7FF), CanFrame(0x12345 | EXTENDED_FLAG), remote_frame(0x703, 1), CanFrame(4 | ERROR_FLAG))
    ]
    assert kinds == [(False, False), (False, False), (True, False), (False, True)]


@pytest.mark.parametrize("text", ["183#3706", "080#", "703#R1", "000#0100"])
def test_a_frame_reads_as_in_a_log(text):
    assert str(frame(text)) == text


def test_extended_identifiers_have_eight_digits():
    assert str(CanFrame(0x12345 | EXTENDED_FLAG, b"\1")) == "00012345#01"


def test_a_remote_frame_carries_its_length():
    assert remote_frame(0x703, 1) == CanFrame(0x703 | REMOTE_FLAG, b"\0")


@given(st.lists(frames))
def test_records_hold_any_frames(many):
    records = pack_records(many)
    assert len(records) == RECORD_SIZE * len(many)
    assert list(frames_of(records)) == many


def test_the_record_is_the_kernels():
    assert pack_records([CanFrame(0x183, b"\x37\x06")]) == bytes.fromhex("83010000 02000000 3706000000000000")


def test_a_length_above_eight_counts_as_eight():
    assert list(frames_of(bytes.fromhex("83010000 0F000000 0102030405060708"))) == [CanFrame(0x183, bytes(range(1, 9)))]


def test_the_identifier_of_a_cob_id_entry_is_without_its_bits():
    assert can_id_of(1 << 31 | 1 << 30 | 0x181) == 0x181
    assert can_id_of(1 << 31 | EXTENDED_BIT | 0x12345) == EXTENDED_FLAG | 0x12345
