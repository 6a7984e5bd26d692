import csv
import io

import pytest
from support.service_node import NodeStub

from canopen_control.cli.support.scope_output import check_output, csv_of, curve, numbered, shot_lines, write_shot
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.service.node_session import NodeSession
from canopen_control.service.scope_capture import Shot
from canopen_control.service.scope_signals import signal_of

NODE = NodeSession(NodeStub({}), 5, read_eds(data_path("eds", "TMCM-1270.eds"), 5).od)
SIGNALS = [signal_of("5:0x6064", NODE), signal_of("5:0x606C", NODE)]
SHOT = Shot(tuple((100.0 + n / 10, (float(n), None)) for n in range(11)), triggered=100.5)


def test_csv_has_times_from_the_trigger_and_nothing_where_nothing_is_known():
    rows = list(csv.DictReader(io.StringIO(csv_of(SHOT, SIGNALS))))
    assert (rows[0]["t"], rows[0]["5:0x6064"], rows[0]["5:0x606C"]) == ("-0.500000", "0", "")
    assert rows[-1]["time"] == "101.000000"


def test_people_see_measures_and_a_curve():
    lines = list(shot_lines(SHOT, SIGNALS))
    assert lines[0] == "11 samples from -0.500 s to 0.500 s of the trigger"
    assert lines[2].split()[5:8] == ["0", "10", "4.5"]
    assert lines[3].split()[5:8] == ["-", "-", "-"]


def test_a_curve_rises_with_its_signal():
    drawn = curve(SHOT, 0, 11)
    assert (drawn[0], drawn[-1]) == ("▁", "█")
    assert list(drawn) == sorted(drawn)
    assert curve(SHOT, 1, 5) == "     "


def test_the_shots_of_a_series_have_numbers():
    path = check_output("scope.csv")
    assert [str(numbered(path, 3, several=each)) for each in (False, True)] == ["scope.csv", "scope_3.csv"]


@pytest.mark.parametrize("text", ["scope", "scope.png", "nowhere/scope.csv"])
def test_another_ending_or_place_is_refused_before_anything_is_looked_at(text):
    with pytest.raises(ConfigError, match=r"-o .*(write NAME\.csv|no folder)"):
        check_output(text)


def test_a_bag_has_a_topic_for_each_signal(tmp_path):
    reader = pytest.importorskip("rosbags.rosbag2")
    folder = write_shot(tmp_path / "shot.mcap", SHOT, SIGNALS)
    assert folder == tmp_path / "shot"
    with reader.Reader(folder) as bag:
        assert [(each.topic, each.msgcount) for each in bag.connections] == [("/scope/node_5/o6064_00", 11)]
