from __future__ import annotations

import pytest
from support.services import frame, vectors

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.pdo import PdoParameters
from canopen_control.cia301.remap import MappingTarget, PdoRules
from canopen_control.frame import is_restricted

VALID = PdoParameters(0x203, rtr_allowed=False)
INVALID = PdoParameters(0x203, enabled=False, rtr_allowed=False)

OBJECTS = {
    (0x6040, 0): MappingTarget(16, rpdo_mappable=True, tpdo_mappable=False),
    (0x6041, 0): MappingTarget(16, rpdo_mappable=False, tpdo_mappable=True),
    (0x6060, 0): MappingTarget(8, rpdo_mappable=True, tpdo_mappable=False),
    (0x607A, 0): MappingTarget(32, rpdo_mappable=True, tpdo_mappable=True),
    (0x1000, 0): MappingTarget(32, rpdo_mappable=False, tpdo_mappable=False),
}


def lookup(index: int, subindex: int) -> MappingTarget | AbortCode:
    if index not in {known for known, _ in OBJECTS}:
        return AbortCode.NO_OBJECT
    return OBJECTS.get((index, subindex), AbortCode.NO_SUBINDEX)


def rules(*, is_tpdo: bool = False, **settings: object) -> PdoRules:
    return PdoRules(is_tpdo, lookup, **settings)


def golden() -> list[tuple[int, int, bytes]]:
    """Return the writes of the vector's expedited downloads."""
    writes = []
    for text in vectors()["remap_procedure"]["rpdo1_node3"]:
        data = frame(text).data
        if text.startswith("603"):
            size = 4 - (data[0] >> 2 & 3)
            writes.append((data[1] | data[2] << 8, data[3], data[4 : 4 + size]))
    return writes


def test_a_server_accepts_the_procedure_and_only_in_this_order():
    """Play the golden writes against the rules, then each of them too early."""
    server = Server()
    assert [server.write(*write) for write in golden()] == [None] * len(golden())
    assert server.parameters == PdoParameters(0x203, rtr_allowed=False)
    for position, write in enumerate(golden()[1:5], 1):
        early = Server()
        assert early.write(*write) is AbortCode.INVALID_VALUE, position


class Server:
    """The least server: a valid RPDO with one mapped object, and the rules."""

    def __init__(self) -> None:
        self.parameters = VALID
        self.count = 1
        self.entries = [0x60400010, 0, 0, 0]
        self.rules = rules()

    def write(self, index: int, subindex: int, data: bytes) -> AbortCode | None:
        value = int.from_bytes(data, "little")
        if index == 0x1400:
            refusal = self.rules.check_communication(subindex, value, self.parameters)
            if refusal is None and subindex == 1:
                self.parameters = PdoParameters.from_value(value)
            return refusal
        if subindex == 0:
            refusal = self.rules.check_mapping_count(value, self.entries, self.parameters)
            self.count = self.count if refusal else value
            return refusal
        refusal = self.rules.check_mapping_entry(subindex, value, self.parameters, self.count)
        if refusal is None:
            self.entries[subindex - 1] = value
        return refusal


BAD = AbortCode.INVALID_VALUE


@pytest.mark.parametrize(
    ("subindex", "value", "present", "answer"),
    [
        (0, 6, INVALID, AbortCode.READ_ONLY),
        (1, 0x40000203, VALID, None),
        (1, 0x40000204, VALID, BAD),
        (1, 0xC0000204, VALID, None),
        (1, 0x40000204, INVALID, None),
        (1, 0x40000581, INVALID, BAD),
        (1, 0x40000000, INVALID, BAD),
        (1, 0xC0000000, INVALID, None),
        (1, 0x60012345, INVALID, BAD),
        (2, 0, VALID, None),
        (2, 240, VALID, None),
        (2, 241, VALID, BAD),
        (2, 251, VALID, BAD),
        (2, 252, VALID, BAD),
        (2, 255, VALID, None),
        (3, 10, VALID, BAD),
        (3, 0, VALID, None),
        (3, 10, INVALID, None),
        (4, 0, INVALID, AbortCode.NO_SUBINDEX),
        (5, 100, VALID, None),
        (6, 1, INVALID, AbortCode.NO_SUBINDEX),
        (7, 1, INVALID, AbortCode.NO_SUBINDEX),
    ],
)
def test_writes_to_the_communication_record_of_an_rpdo(subindex, value, present, answer):
    assert rules().check_communication(subindex, value, present) is answer


@pytest.mark.parametrize(
    ("subindex", "value", "present", "answer"),
    [
        (2, 253, PdoParameters(0x183), None),
        (2, 252, PdoParameters(0x183, rtr_allowed=False), BAD),
        (1, 0x40000183, PdoParameters(0x183, enabled=False, transmission_type=253), BAD),
        (1, 0x00000183, PdoParameters(0x183, enabled=False, transmission_type=253), None),
        (6, 3, PdoParameters(0x183), BAD),
        (6, 3, PdoParameters(0x183, enabled=False), None),
        (6, 241, PdoParameters(0x183, enabled=False), BAD),
    ],
)
def test_writes_to_the_communication_record_of_a_tpdo(subindex, value, present, answer):
    assert rules(is_tpdo=True).check_communication(subindex, value, present) is answer


def test_a_device_without_rtr_keeps_bit_30_of_its_tpdos():
    strict = rules(is_tpdo=True, rtr_supported=False)
    assert strict.check_communication(1, 0x00000203, INVALID) is BAD
    assert strict.check_communication(1, 0x80000203, VALID) is BAD
    assert strict.check_communication(1, 0xC0000203, VALID) is None
    assert rules(extended_supported=True).check_communication(1, 0x60012345, INVALID) is None


@pytest.mark.parametrize(
    ("subindex", "value", "present", "count", "answer"),
    [
        (1, 0x60400010, INVALID, 0, None),
        (1, 0, INVALID, 0, None),
        (1, 0x60400010, VALID, 0, BAD),
        (1, 0x60400010, INVALID, 1, BAD),
        (0x41, 0x60400010, INVALID, 0, AbortCode.NO_SUBINDEX),
        (1, 0x60410010, INVALID, 0, AbortCode.NOT_MAPPABLE),
        (1, 0x10000020, INVALID, 0, AbortCode.NOT_MAPPABLE),
        (1, 0x60400008, INVALID, 0, AbortCode.NOT_MAPPABLE),
        (1, 0x60400020, INVALID, 0, AbortCode.NOT_MAPPABLE),
        (1, 0x60400000, INVALID, 0, AbortCode.NOT_MAPPABLE),
        (1, 0x60FF0020, INVALID, 0, AbortCode.NO_OBJECT),
        (1, 0x60400110, INVALID, 0, AbortCode.NO_SUBINDEX),
        (1, 0x00060010, INVALID, 0, AbortCode.NOT_MAPPABLE),
    ],
)
def test_writes_to_a_mapping_entry(subindex, value, present, count, answer):
    assert rules().check_mapping_entry(subindex, value, present, count) is answer


def test_dummies_fill_rpdos_where_the_device_allows_them():
    allowing = rules(dummy_usage=frozenset({6}))
    assert allowing.check_mapping_entry(1, 0x00060010, INVALID, 0) is None
    assert allowing.check_mapping_entry(1, 0x00060008, INVALID, 0) is AbortCode.NOT_MAPPABLE
    assert allowing.check_mapping_entry(1, 0x00050008, INVALID, 0) is AbortCode.NOT_MAPPABLE
    sending = rules(is_tpdo=True, dummy_usage=frozenset({6}))
    assert sending.check_mapping_entry(1, 0x00060010, INVALID, 0) is AbortCode.NOT_MAPPABLE


def test_a_bit_granular_device_maps_parts():
    partial = rules(partial=True)
    assert partial.check_mapping_entry(1, 0x60400004, INVALID, 0) is None
    assert partial.check_mapping_entry(1, 0x60400010, INVALID, 0) is None
    assert partial.check_mapping_entry(1, 0x60400011, INVALID, 0) is AbortCode.NOT_MAPPABLE
    assert partial.check_mapping_entry(1, 0x60400000, INVALID, 0) is AbortCode.NOT_MAPPABLE


@pytest.mark.parametrize(
    ("value", "entries", "present", "answer"),
    [
        (0, [], INVALID, None),
        (0, [], VALID, BAD),
        (2, [0x607A0020, 0x607A0020], INVALID, None),
        (3, [0x607A0020, 0x607A0020, 0x60600008], INVALID, AbortCode.MAPPING_TOO_LONG),
        (2, [0x607A0020], INVALID, AbortCode.MAPPING_TOO_LONG),
        (2, [0x607A0020, 0], INVALID, AbortCode.NO_OBJECT),
        (1, [0x60410010], INVALID, AbortCode.NOT_MAPPABLE),
        (254, [], INVALID, BAD),
        (255, [], INVALID, BAD),
    ],
)
def test_writes_to_the_mapping_count(value, entries, present, answer):
    assert rules().check_mapping_count(value, entries, present) is answer


def test_a_device_has_its_own_number_of_entries_and_its_own_refusal():
    small = rules(max_entries=1, wrong_state=AbortCode.UNSUPPORTED_ACCESS)
    assert small.check_mapping_count(2, [0x60600008] * 3, INVALID) is AbortCode.MAPPING_TOO_LONG
    assert small.check_mapping_entry(2, 0x60600008, INVALID, 0) is AbortCode.NO_SUBINDEX
    assert small.check_mapping_entry(1, 0x60600008, VALID, 0) is AbortCode.UNSUPPORTED_ACCESS


def test_restricted_identifiers():
    free = [n for n in range(0x800) if not is_restricted(n)]
    assert free[:2] == [0x80, 0x81]
    for low, high in ((0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF)):
        assert not any(low <= n <= high for n in free)
    assert {0x100, 0x181, 0x580, 0x600, 0x680, 0x6DF, 0x700} <= set(free)
