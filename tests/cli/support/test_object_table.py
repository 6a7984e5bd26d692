import csv
import io

import pytest
from support.service_node import NodeStub

from canopen_control.cli.support import object_table
from canopen_control.cli.support.object_table import csv_text, live_objects, table_lines, tree_lines, values_of
from canopen_control.commissioning.node_session import NodeSession
from canopen_control.commissioning.object_rows import LiveObject, rows_of
from canopen_control.data_files import data_path
from canopen_control.errors import SdoTimeout
from canopen_control.od.eds import read_eds

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
HELD = {
    (0x6041, 0): b"\x50\x02",
    (0x1017, 0): (1600).to_bytes(2, "little"),
    (0x1008, 0): b"TMCM\x1b[2J",
    (0x1A00, 1): (0x60410010).to_bytes(4, "little"),
}


def session(held=HELD, robot=""):
    return NodeSession(NodeStub(held), 5, OD, robot=robot)


def rows(*addresses):
    return rows_of(OD, live_objects(session(), [OD[address] for address in addresses]), 5)


def test_what_the_node_refuses_is_reported_in_its_line_and_the_others_are_read():
    refused, speed = rows((0x6064, 0), (0x1017, 0))
    assert (refused.value, speed.value) == (None, "1600")
    assert refused.error.startswith("abort 0x06020000")
    assert "(abort 0x06020000" in table_lines([refused, speed], live=True)[1]


def test_a_silent_node_ends_it():
    node = session()
    node.transfers.error = SdoTimeout(5, 0x6041, 0, 0.5)
    with pytest.raises(SdoTimeout):
        live_objects(node, [OD[0x6041, 0], OD[0x1017, 0]])


def test_the_table_marks_what_is_not_the_default_and_no_control_character_reaches_a_terminal():
    lines = table_lines(rows((0x1008, 0), (0x1017, 0)), live=True)
    assert lines[0].split() == ["address", "name", "type", "access", "PDO", "default", "value", "unit", "meaning"]
    assert "\x1b" not in lines[1]
    assert lines[2].split()[-3:] == ["*", "1600", "ms"]
    assert len(table_lines(rows((0x1017, 0)), live=False)[0].split()) == 7


def test_a_tree_has_each_object_once_with_its_subindices_below():
    lines = list(tree_lines(OD, rows((0x1018, 1), (0x1018, 2), (0x1017, 0)), live=True))
    assert lines[0] == "0x1018 Identity object"
    assert lines[1].startswith("  :01 Vendor-ID (abort 0x06020000")
    assert lines[3] == "0x1017 Producer heartbeat time = 1600 ms, by default 0  [UNSIGNED16 rw]"


def test_csv_is_read_back_as_it_was():
    dict_reader = list(csv.DictReader(io.StringIO(csv_text(rows((0x6041, 0), (0x1017, 0))))))
    assert [item["value"] for item in dict_reader] == ["0x0250", "1600"]
    assert dict_reader[1]["name"] == "Producer heartbeat time"


def test_a_running_robot_is_asked_no_faster_than_it_may(monkeypatch):
    slept = []
    monkeypatch.setattr(object_table.time, "sleep", slept.append)
    monkeypatch.setattr(object_table.time, "monotonic", lambda: sum(slept))
    entries = [OD[0x6041, 0]] * 5
    live_objects(session(robot="robby"), entries)
    assert sum(slept) == pytest.approx(4 / object_table.READS_PER_S)
    slept.clear()
    live_objects(session(), entries)
    assert slept == []


def test_a_dcf_holds_what_can_be_written():
    objects = [LiveObject(OD[0x6041, 0], 5), LiveObject(OD[0x1017, 0], 7), LiveObject(OD[0x6083, 0], None, "refused")]
    assert values_of(objects) == {(0x1017, 0): 7}
