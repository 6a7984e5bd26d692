"""PDO records that the file leaves out."""

from support.eds import codes, eds, parse, section

from canopen_control.od.dcf import eds_text
from canopen_control.od.eds import parse_eds


def compact(mask, rx, tx):
    return section("DeviceInfo", CompactPDO=mask, NrOfRXPDO=rx, NrOfTXPDO=tx)


def test_records_are_made_as_the_mask_says():
    od = parse(compact("0x13", 5, 1), eds()).od
    assert sorted(od.objects) == [*range(0x1400, 0x1405), *range(0x1600, 0x1605), 0x1800, 0x1A00, 0x2000]
    assert od.subindices(0x1400) == [0, 1, 2, 5]
    assert od[0x1400, 0].default == 5
    assert [od[0x1400 + k, 1].default for k in range(5)] == [0x200, 0x300, 0x400, 0x500, 0x80000000]
    assert (od[0x1800, 1].default, od[0x1800, 1].relative, od[0x1404, 1].relative) == (0x180, True, False)
    assert od.subindices(0x1A00) == list(range(65))


def test_the_node_id_is_in_the_cob_ids():
    assert parse(compact(3, 1, 0), eds(), node_id=3).od[0x1400, 1].default == 0x203


def test_what_the_file_describes_stays():
    own = section("1400", ParameterName="Own", ObjectType=9, SubNumber=0)
    file = parse(compact(3, 1, 0), own, eds())
    assert file.od.objects[0x1400].name == "Own"
    assert file.od.subindices(0x1400) == []
    assert "compact-pdo" in codes(file)


def test_without_a_mask_nothing_is_made():
    assert list(parse(compact(0, 4, 4), eds()).od.objects) == [0x2000]


def test_no_more_than_the_standard_has():
    file = parse(compact(1, 100_000, -1), eds())
    assert len(file.od.objects) == 1 + 2 * 512
    assert codes(file).count("compact-count") == 2


def test_written_out_they_are_plain_records():
    od = parse(compact("0x3F", 2, 2), eds()).od
    again = parse_eds(eds_text(od).encode())
    assert again.od.entries == od.entries
    assert "compact-pdo" not in codes(again)
