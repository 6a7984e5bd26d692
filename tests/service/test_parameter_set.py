import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.drive_shapes import MAKERS, SHAPES

from canopen_control.data_files import data_path
from canopen_control.errors import EdsError
from canopen_control.od.codec import default_of
from canopen_control.od.dcf import concise_of
from canopen_control.od.eds import parse_eds, read_eds
from canopen_control.od.model import DataType, Entry, ObjectDictionary
from canopen_control.service.parameter_set import (
    DeviceIdentity,
    ParameterSet,
    backup_text,
    differences,
    lost_in_text,
    parameters_of,
    read_backup,
    same_value,
    without_unused_slots,
)

TMCM = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
IDENTITY = DeviceIdentity(0xFFFF0192, 0x286, 0x4F6, 0x3001A, 77, "TMCM-1270", "1.0", "3.26")


def parameters(values=None, od=TMCM, node_id=5, identity=IDENTITY):
    values = {entry.address: default_of(entry) for entry in parameters_of(od)} | (values or {})
    return ParameterSet(od, node_id, identity, without_unused_slots(values), f"node {node_id}")


def written(tmp_path, backup, **how):
    path = tmp_path / "backup.dcf"
    path.write_text(backup_text(backup, **how), encoding="utf-8")
    return path


def test_a_backup_comes_back_with_identity_and_date(tmp_path):
    backup = parameters({(0x6081, 0): 1600, (0x607C, 0): -7})
    found = read_backup(written(tmp_path, backup))
    assert differences(backup, found) == []
    assert (found.identity, found.node_id, found.values[0x6081, 0]) == (IDENTITY, 5, 1600)
    assert found.date.startswith("20")
    assert found.date.endswith("Z")


def test_a_backup_is_a_dcf_that_a_master_downloads(tmp_path):
    path = written(tmp_path, parameters({(0x6081, 0): 1600}), eds_name="TMCM-1270.eds", node_name="left")
    file = read_eds(path)
    assert [issue for issue in file.issues if issue.severity == "error"] == []
    assert (0x6081, 0, (1600).to_bytes(4, "little")) in concise_of(file.od)
    assert file.od.commissioning.node_name == "left"
    assert file.od.sections["FileInfo"]["LastEDS"] == "TMCM-1270.eds"


def test_what_follows_the_node_id_does_so_in_the_file(tmp_path):
    path = written(tmp_path, parameters({(0x1800, 1): 0x40000185}))
    assert "ParameterValue=$NODEID+0x40000180" in path.read_text()
    assert read_backup(path, 9).values[0x1800, 1] == 0x40000189
    assert parameters({(0x1800, 1): 0x40000185}).for_node(9)[0x1800, 1] == 0x40000189


@pytest.mark.parametrize("name", [*SHAPES, *MAKERS])
def test_every_makers_shape_comes_back(tmp_path, name):
    od = (SHAPES | MAKERS)[name][0]()
    backup = parameters(od=od)
    found = read_backup(written(tmp_path, backup))
    assert differences(backup, found) == []
    assert found.values.keys() == backup.values.keys()


def with_text(value):
    od = read_eds(data_path("eds", "generic_cia402.eds"), 5).od
    od.add(Entry(0x2100, 0, "Label", DataType.VISIBLE_STRING))
    return ParameterSet(od, 5, IDENTITY, {(0x2100, 0): value, (0x6081, 0): 3}, "node 5")


def test_empty_texts_come_back_and_impossible_ones_are_told(tmp_path):
    assert read_backup(written(tmp_path, with_text(""))).values[0x2100, 0] == ""
    assert lost_in_text(with_text("left wheel"), backup_text(with_text("left wheel"))) == []
    assert lost_in_text(with_text(" a\n"), backup_text(with_text(" a\n"))) == [(0x2100, 0)]


TYPES = [each for each in DataType if each.is_integer]


@given(st.sampled_from(TYPES), st.data())
def test_any_value_comes_back(data_type, data):
    value = data.draw(st.integers(data_type.minimum, data_type.maximum))
    od = ObjectDictionary(node_id=5)
    od.add(Entry(0x2100, 0, "value", data_type))
    found = parse_eds(backup_text(ParameterSet(od, 5, IDENTITY, {(0x2100, 0): value}, "node 5")).encode(), 5).od
    assert found[0x2100, 0].parameter_value == value


def test_an_eds_and_a_dcf_without_parameters_are_refused(tmp_path):
    with pytest.raises(EdsError, match="no node id"):
        read_backup(data_path("eds", "TMCM-1270.eds"))
    empty = ParameterSet(TMCM, 5, IDENTITY, {}, "node 5")
    with pytest.raises(EdsError, match="no ParameterValue of a parameter"):
        read_backup(written(tmp_path, empty))


def test_a_dcf_of_another_tool_has_the_identity_of_its_objects(tmp_path):
    path = written(tmp_path, parameters())
    path.write_text(path.read_text().replace("[Backup]", "[Unknown]"))
    found = read_backup(path)
    assert (found.identity.vendor, found.identity.product, found.date) == (0x286, 0x4F6, "")


def test_what_moves_is_not_taken_from_a_file(tmp_path):
    text = backup_text(parameters()).replace("[60FF]\n", "[60FF]\nParameterValue=5000\n")
    path = tmp_path / "moves.dcf"
    path.write_text(text)
    assert read_eds(path).od[0x60FF, 0].parameter_value == 5000
    assert (0x60FF, 0) not in read_backup(path).values


def test_a_value_that_is_none_is_told_with_its_line(tmp_path):
    path = written(tmp_path, parameters())
    lines = path.read_text().splitlines()
    number = next(at for at, line in enumerate(lines) if line.startswith("ParameterValue="))
    lines[number] = "ParameterValue=many"
    path.write_text("\n".join(lines))
    with pytest.raises(EdsError, match=rf"backup\.dcf:{number + 1}: ParameterValue=many is no .*; correct it"):
        read_backup(path)


def test_a_backup_that_was_cut_is_refused(tmp_path):
    path = written(tmp_path, parameters())
    whole = path.read_text()
    path.write_text(whole[: len(whole) // 2])
    with pytest.raises(EdsError, match=r"backup\.dcf:\d+: 0x.* has no section: the backup was cut, make a new one"):
        read_backup(path)


def test_values_that_nothing_writes_are_named(tmp_path):
    path = written(tmp_path, parameters())
    assert read_backup(path).foreign == ()
    text = path.read_text()
    at = text.index("[6502]") + len("[6502]")
    path.write_text(f"{text[:at]}\nParameterValue=7{text[at:]}")
    assert read_backup(path).foreign == ((0x6502, 0),)


def test_identities_say_what_makes_a_stranger():
    other = DeviceIdentity(0xFFFF0192, 0x286, 0x4F5, 0x3001B, 78)
    assert IDENTITY.strangers(other) == ["product 0x000004F6 and 0x000004F5"]
    assert IDENTITY.variations(other) == ["revision 0x0003001A and 0x0003001B"]
    assert IDENTITY.strangers(DeviceIdentity()) == []


def test_values_are_the_same_as_bytes_are():
    real = Entry(0x2100, 0, "gain", DataType.REAL32)
    assert same_value(real, 0.1, 0.10000000149011612)
    assert same_value(real, float("nan"), float("nan"))
    assert not same_value(Entry(0x2100, 0, "x", DataType.UNSIGNED8), "text", 5)
