from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.drive_shapes import MAKERS, SHAPES
from support.service_node import NodeStub

from canopen_control.cia402.objects import MOTION
from canopen_control.commissioning.identity import DeviceIdentity
from canopen_control.commissioning.node_session import NodeSession
from canopen_control.commissioning.parameter_set import (
    DifferentParameter,
    ParameterSet,
    backup_text,
    differences,
    follows_node_id,
    lost_in_text,
    parameter_text,
    parameters_of,
    protection_of,
    read_backup,
    read_parameters,
    read_values,
    same_value,
    without_unused_slots,
)
from canopen_control.data_files import data_path
from canopen_control.errors import EdsError, SdoTimeout
from canopen_control.od.codec import default_of, encode
from canopen_control.od.dcf import concise_of
from canopen_control.od.eds import parse_eds, read_eds
from canopen_control.od.model import DataType, Entry, ObjectDictionary
from canopen_control.od.pdos import is_cob_id

OD_OF_READ_PARAMETERS = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od


def node(**changes):
    objects = {
        entry.address: encode(default_of(entry), entry.data_type) for entry in OD_OF_READ_PARAMETERS if entry.readable
    }
    stub = NodeStub(objects | {(int(name[1:5], 16), 0): data for name, data in changes.items()})
    return NodeSession(stub, 5, OD_OF_READ_PARAMETERS)


def test_parameters_are_read_twice_and_progress_is_reported():
    session, reported = node(s6081=b"\x40\x06\0\0"), []
    result, left_out = read_parameters(session, progress=lambda done, of: reported.append((done, of)))
    assert (result.values[0x6081, 0], left_out) == (1600, [])
    assert session.transfers.reads.count((0x6081, 0)) == 2
    assert reported[-1] == (len(reported), reported[0][1])
    assert session.transfers.written == []


def test_what_differs_between_two_readings_is_left_out():
    session = node()
    counter = iter(range(100))
    plain = session.transfers.read

    def read(index, subindex, *, block=False):
        data = plain(index, subindex, block=block)
        return next(counter).to_bytes(4, "little") if index == 0x6081 else data

    session.transfers.read = read
    result, left_out = read_parameters(session)
    assert (0x6081, 0) not in result.values
    assert [str(item) for item in left_out] == [
        "0x6081:00 Profile velocity: two readings differed, so the object is not a parameter"
    ]


def test_what_the_node_refuses_or_answers_in_another_length_is_left_out_with_the_reason():
    session = node(s6083=b"\1")
    del session.transfers.objects[0x6081, 0]
    result, left_out = read_parameters(session)
    assert {(0x6081, 0), (0x6083, 0)}.isdisjoint(result.values)
    assert [(item.entry.index, item.why.split(",")[0][:16]) for item in left_out] == [
        (0x6081, "abort 0x06020000"),
        (0x6083, "node 5: 0x6083:0"),
    ]


def test_a_node_that_does_not_answer_ends_it():
    session = node()
    session.transfers.error = SdoTimeout(5, 0x1000, 0, 0.5)
    with pytest.raises(SdoTimeout):
        read_values(session, [OD_OF_READ_PARAMETERS[0x6081, 0]])
    with pytest.raises(SdoTimeout):
        session.identity()


def test_the_identity_is_numbers_and_names():
    identity = node(s1008=b"PD42\0\0", s1000=b"\x92\1\xff\xff").identity()
    assert (identity.device_type, identity.device_name) == (0xFFFF0192, "PD42")


OD = read_eds(data_path("eds", "TMCM-1270.eds")).od


def side(node_id, **values):
    result = {(int(name[1:5], 16), int(name[6:8], 16)): value for name, value in values.items()}
    return ParameterSet(OD.for_node(node_id), node_id, DeviceIdentity(), result, f"node {node_id}")


def test_what_follows_the_node_id_is_compared_without_it():
    a = side(5, s1800_01=0x40000185)
    assert [*differences(a, side(6, s1800_01=0x40000186))] == []
    (result,) = differences(a, side(6, s1800_01=0x40000185))
    assert (result.a, result.b) == ("$NODEID+0x40000180", "0x40000185")


def test_a_difference_has_name_and_both_values():
    (result,) = differences(side(5, s6081_00=3), side(5, s6081_00=4))
    assert result == DifferentParameter(0x6081, 0, "Profile velocity", "3", "4")


def test_what_one_side_lacks_differs_unless_it_is_skipped():
    (result,) = differences(side(5, s6081_00=3), side(5))
    assert (result.a, result.b) == ("3", None)


def test_mappings_are_shown_as_a_dcf_writes_them():
    assert parameter_text(side(5, s1600_01=0x60400010), (0x1600, 1)) == "0x60400010"


TMCM = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
SERVO = read_eds(data_path("eds", "generic_cia402.eds"), 5).od


def chosen(od):
    return {entry.address for entry in parameters_of(od)}


def test_what_can_be_read_and_written_is_a_parameter():
    assert {(0x6081, 0), (0x6060, 0), (0x2003, 0), (0x1017, 0), (0x607D, 1)} <= chosen(TMCM)
    assert not {(0x1000, 0), (0x6041, 0), (0x1018, 4), (0x1F50, 1)} & chosen(TMCM)


@pytest.mark.parametrize("od", [TMCM, SERVO], ids=["TMCM-1270", "servo"])
def test_commands_and_live_values_are_none(od):
    indices = {index for index, _ in chosen(od)}
    assert not indices & ((MOTION - {0x6060}) | {0x1003, 0x1010, 0x1011, 0x60B8})
    assert (0x60FE, 1) not in chosen(od)


@pytest.mark.parametrize("flags", [1, 2, 3])
def test_obj_flags_are_obeyed(flags):
    od = replace(SERVO, entries={**SERVO.entries, (0x6081, 0): replace(SERVO[0x6081, 0], obj_flags=flags)})
    assert (0x6081, 0) not in chosen(od)


def test_what_belongs_to_one_device_is_protected_with_a_reason():
    assert "node-ID or the bit rate" in protection_of(TMCM, Entry(0x2705, 0, "x", DataType.UNSIGNED8))
    assert "encoder of the original drive" in protection_of(SERVO, Entry(0x687C, 0, "Home offset", DataType.INTEGER32))
    assert protection_of(SERVO, Entry(0x2100, 0, "CANopen Baudrate", DataType.UNSIGNED8)) != ""
    assert protection_of(SERVO, Entry(0x2100, 0, "Velocity", DataType.UNSIGNED8)) == ""
    assert protection_of(SERVO, Entry(0x6081, 0, "Node ID", DataType.UNSIGNED8)) == ""  # a name of the profile's range


@pytest.mark.parametrize(
    ("index", "value", "follows"),
    [
        (0x1800, 0x185, True),
        (0x1800, 0xC0000185, True),
        (0x1800, 0x186, False),
        (0x1800, 0x805, False),
        (0x1014, 0x85, True),
        (0x1014, 0x80000086, False),
        (0x6081, 0x185, False),
    ],
)
def test_identifiers_that_end_in_the_node_id_follow_it(index, value, follows):
    entry = Entry(index, 1 if is_cob_id(index, 1) else 0, "x", DataType.UNSIGNED32)
    assert follows_node_id(entry, value, 5) is follows


def test_what_the_file_makes_of_the_node_id_follows_it():
    entry = Entry(0x2100, 0, "x", DataType.UNSIGNED32, default=0x1005, relative=True)
    assert follows_node_id(entry, 0x1005, 5)
    assert follows_node_id(entry, 0x80001005, 5)  # switched off
    assert not follows_node_id(entry, 0x1006, 5)


@given(st.integers(0, 70), st.integers(1, 64))
def test_mapping_entries_above_the_count_are_left_out(count, slots):
    values = {(0x1600, 0): count, **{(0x1600, sub): 7 for sub in range(1, slots + 1)}, (0x2000, 9): 1}
    kept = without_unused_slots(values)
    assert (0x2000, 9) in kept
    assert sum(index == 0x1600 for index, _ in kept) == 1 + (min(count, slots) if count <= 64 else slots)


IDENTITY = DeviceIdentity(0xFFFF0192, 0x286, 0x4F6, 0x3001A, 77, "TMCM-1270", "1.0", "3.26")


def parameters(values=None, od=TMCM, node_id=5, identity=IDENTITY):
    values = {entry.address: default_of(entry) for entry in parameters_of(od)} | (values or {})
    return ParameterSet(od, node_id, identity, without_unused_slots(values), f"node {node_id}")


def written(tmp_path, backup, **how):
    path = tmp_path / "backup.dcf"
    path.write_text(backup_text(backup, **how), encoding="utf-8")
    return path


def test_a_backup_is_a_dcf_that_a_master_downloads(tmp_path):
    path = written(tmp_path, parameters({(0x6081, 0): 1600}), eds_name="TMCM-1270.eds", node_name="left")
    file = read_eds(path)
    assert [issue for issue in file.issues if issue.severity == "error"] == []
    assert (0x6081, 0, (1600).to_bytes(4, "little")) in concise_of(file.od)
    assert file.od.commissioning.node_name == "left"
    assert file.od.sections["FileInfo"]["LastEDS"] == "TMCM-1270.eds"


@pytest.mark.parametrize("name", [*SHAPES, *MAKERS])
def test_every_manufacturers_shape_returns(tmp_path, name):
    od = (SHAPES | MAKERS)[name][0]()
    backup = parameters(od=od)
    result = read_backup(written(tmp_path, backup))
    assert [*differences(backup, result)] == []
    assert result.values.keys() == backup.values.keys()


def with_text(value):
    od = read_eds(data_path("eds", "generic_cia402.eds"), 5).od
    od.add(Entry(0x2100, 0, "Label", DataType.VISIBLE_STRING))
    return ParameterSet(od, 5, IDENTITY, {(0x2100, 0): value, (0x6081, 0): 3}, "node 5")


def test_empty_texts_return_and_impossible_ones_are_reported(tmp_path):
    assert read_backup(written(tmp_path, with_text(""))).values[0x2100, 0] == ""
    assert lost_in_text(with_text("left wheel"), backup_text(with_text("left wheel"))) == []
    assert lost_in_text(with_text(" a\n"), backup_text(with_text(" a\n"))) == [(0x2100, 0)]


TYPES = [each for each in DataType if each.is_integer]


@given(st.sampled_from(TYPES), st.data())
def test_any_value_returns(data_type, data):
    value = data.draw(st.integers(data_type.minimum, data_type.maximum))
    od = ObjectDictionary(node_id=5)
    od.add(Entry(0x2100, 0, "value", data_type))
    result = parse_eds(backup_text(ParameterSet(od, 5, IDENTITY, {(0x2100, 0): value}, "node 5")).encode(), 5).od
    assert result[0x2100, 0].parameter_value == value


def test_an_eds_and_a_dcf_without_parameters_are_refused(tmp_path):
    with pytest.raises(EdsError, match="no node-ID"):
        read_backup(data_path("eds", "TMCM-1270.eds"))
    empty = ParameterSet(TMCM, 5, IDENTITY, {}, "node 5")
    with pytest.raises(EdsError, match="no ParameterValue of a parameter"):
        read_backup(written(tmp_path, empty))


def test_a_dcf_of_another_tool_has_the_identity_of_its_objects(tmp_path):
    path = written(tmp_path, parameters())
    path.write_text(path.read_text().replace("[Backup]", "[Unknown]"))
    backup = read_backup(path)
    assert (backup.identity.vendor_id, backup.identity.product_code, backup.date) == (0x286, 0x4F6, "")


def test_what_moves_is_not_taken_from_a_file(tmp_path):
    text = backup_text(parameters()).replace("[60FF]\n", "[60FF]\nParameterValue=5000\n")
    path = tmp_path / "moves.dcf"
    path.write_text(text)
    assert read_eds(path).od[0x60FF, 0].parameter_value == 5000
    assert (0x60FF, 0) not in read_backup(path).values


def test_a_value_that_is_none_is_reported_with_its_line(tmp_path):
    path = written(tmp_path, parameters())
    lines = path.read_text().splitlines()
    number = next(at for at, line in enumerate(lines) if line.startswith("ParameterValue="))
    lines[number] = "ParameterValue=many"
    path.write_text("\n".join(lines))
    with pytest.raises(
        EdsError, match=rf"backup\.dcf:{number + 1}: ParameterValue=many is not a .*; correct or remove the line"
    ):
        read_backup(path)


def test_a_backup_that_was_cut_is_refused(tmp_path):
    path = written(tmp_path, parameters())
    whole = path.read_text()
    path.write_text(whole[: len(whole) // 2])
    with pytest.raises(
        EdsError, match=r"backup\.dcf:\d+: 0x.* has no section: the backup is incomplete; make a new one"
    ):
        read_backup(path)


def test_identities_report_what_makes_a_stranger():
    other = DeviceIdentity(0xFFFF0192, 0x286, 0x4F5, 0x3001B, 78)
    assert IDENTITY.strangers(other) == ["product 0x000004F6 and 0x000004F5"]
    assert IDENTITY.variations(other) == ["revision 0x0003001A and 0x0003001B"]
    assert IDENTITY.strangers(DeviceIdentity()) == []


def test_values_are_the_same_as_bytes_are():
    real = Entry(0x2100, 0, "gain", DataType.REAL32)
    assert same_value(real, 0.1, 0.10000000149011612)
    assert same_value(real, float("nan"), float("nan"))
    assert not same_value(Entry(0x2100, 0, "x", DataType.UNSIGNED8), "text", 5)
