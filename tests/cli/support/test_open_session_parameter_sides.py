import argparse

import pytest
from support.service_node import NodeStub

from canopen_control.cli.support.open_session import as_file, backup_file, reached, read_like
from canopen_control.commissioning.identity import DeviceIdentity
from canopen_control.commissioning.jobs import Reached
from canopen_control.commissioning.node_session import NodeSession
from canopen_control.commissioning.parameter_jobs import like_file
from canopen_control.commissioning.parameter_set import ParameterSet
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
FILE = ParameterSet(OD, 5, DeviceIdentity(), {(0x6081, 0): 3, (0x6083, 0): 4}, "left.dcf")


def test_a_word_is_a_file_where_there_is_one_or_it_resembles_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "3").touch()
    assert as_file("3").name == "3"
    assert as_file("left_drive") is None
    for word, why in (("gone.dcf", "no such file"), ("a/b", "no such file"), (str(tmp_path), "is a folder")):
        with pytest.raises(ConfigError, match=why):
            as_file(word)
    with pytest.raises(ConfigError, match="backup NODE -o nothing"):
        backup_file("nothing")


def test_a_node_is_asked_for_what_the_file_holds_by_its_dictionary():
    stub = NodeStub({(0x6081, 0): bytes(4), (0x1000, 0): b"\x92\1\2\0"})
    session = like_file(NodeSession(stub, 9, None), FILE)
    assert session.od.node_id == 9
    side = read_like(session, FILE)
    assert side.parameters.values == {(0x6081, 0): 0}
    assert [item.entry.index for item in side.left_out] == [0x6083]
    assert side.parameters.identity.device_type == 0x20192


def test_how_a_node_is_reached_is_reported_by_its_arguments():
    assert reached(argparse.Namespace(can="can0", name=None)) == Reached("can0")
    assert reached(argparse.Namespace(name="robby", include_protected=True)) == Reached("", "robby", True)
