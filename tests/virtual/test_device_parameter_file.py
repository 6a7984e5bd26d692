from __future__ import annotations

import json
from dataclasses import replace

import pytest
from support.virtualbench import Bench, servo_od

from canopen_control.errors import ConfigError
from canopen_control.virtual.device import ParameterFile, make_device

SAVE, LOAD = 0x65766173, 0x64616F6C


def bench(path, node_id=5, started_with=None, lss=False):
    messages = []
    storage = ParameterFile(path, messages.append)
    od = servo_od(node_id)
    od.device = replace(od.device, lss_supported=lss)
    node = make_device(od, storage.node_id(node_id))
    storage.attach(node, started_with or node_id)
    b = Bench(node)
    b.said = messages
    return b


def test_a_file_that_is_not_there_is_made_by_the_first_store(tmp_path):
    path = tmp_path / "store.json"
    b = bench(path)
    assert not path.exists()
    b.write(0x6083, 4321)
    b.write(0x1010, SAVE, 1)
    content = json.loads(path.read_text())
    assert content["nodes"]["5"]["values"]["6083:00"] == "e1100000"
    assert content["nodes"]["5"]["device"] == [0x99, 0x1234]
    again = bench(path)
    assert again.number(0x6083) == 4321
    assert again.said == []


def test_what_was_not_stored_is_not_there(tmp_path):
    b = bench(tmp_path / "s")
    b.write(0x6083, 4321)
    b.write(0x1010, SAVE, 2)  # communication parameters only
    assert bench(tmp_path / "s").number(0x6083) == 10000


def test_restore_defaults_reaches_the_file(tmp_path):
    b = bench(tmp_path / "s")
    b.write(0x6083, 4321)
    b.write(0x1010, SAVE, 1)
    b.write(0x1011, LOAD, 1)
    assert bench(tmp_path / "s").number(0x6083) == 10000


def test_several_nodes_share_a_file(tmp_path):
    first, second = bench(tmp_path / "s", 5), bench(tmp_path / "s", 6)
    for b, value in ((first, 55), (second, 66)):
        b.write(0x6083, value)
        b.write(0x1010, SAVE, 1)
    assert [bench(tmp_path / "s", n).number(0x6083) for n in (5, 6)] == [55, 66]


def test_a_node_id_of_lss_outlasts_the_process(tmp_path):
    b = bench(tmp_path / "s", lss=True)
    b.node.lss.slave.pending_node_id = 9
    assert b.node.lss.slave.store(9, 250_000)
    again = bench(tmp_path / "s", lss=True)
    assert (again.node.node_id, again.node.lss.stored_bitrate) == (9, 250_000)


def test_a_store_that_cannot_be_written_fails_with_an_abort_and_keeps_nothing(tmp_path):
    folder = tmp_path / "gone"
    b = bench(folder / "s")
    b.write(0x6083, 4321)
    assert b.abort_of(0x1010, SAVE, 1) == 0x06060000
    assert "cannot be written" in b.said[0]
    b.node.power_on(b.now)
    b.on(0.1)
    assert b.number(0x6083) == 10000


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"format": "x", "nodes": {}}', '{"format": "canopen_control store 1"}']
)
def test_a_file_that_is_something_else_is_refused_and_left_alone(tmp_path, text):
    path = tmp_path / "s"
    path.write_text(text)
    with pytest.raises(ConfigError, match="is not a store of virtual drives"):
        ParameterFile(path, print)
    assert path.read_text() == text


def test_what_does_not_fit_is_ignored_and_reported_and_another_device_refused(tmp_path):
    values = {"6083:00": "e1100000", "6084:00": "zz", "9999:00": "00", "nonsense": 5, "6085:00": "01"}
    record = {"device": [0x99, 0x1234], "node_id": "x", "values": values}
    path = tmp_path / "s"
    path.write_text(json.dumps({"format": "canopen_control store 1", "nodes": {"5": record}}))
    b = bench(path)
    assert b.number(0x6083) == 4321
    assert [line.split(": ")[1].split()[0] for line in b.said] == ["6084:00", "9999:00", "nonsense", "6085:00"]
    record["device"] = [1, 2]
    path.write_text(json.dumps({"format": "canopen_control store 1", "nodes": {"5": record}}))
    with pytest.raises(ConfigError, match="use another --store file"):
        bench(path)
