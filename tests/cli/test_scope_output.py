import pytest
from support.service_node import NodeStub

from canopen_control.cli.scope import (
    check_output,
    cursor_lines,
    curve,
    numbered,
    read_overlay,
    shot_lines,
    write_shot,
)
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.service.node_session import NodeSession
from canopen_control.service.scope_capture import Shot
from canopen_control.service.scope_signals import signal_of

NODE = NodeSession(NodeStub({}), 5, read_eds(data_path("eds", "TMCM-1270.eds"), 5).od)
SIGNALS = [signal_of("5:0x6064", NODE), signal_of("5:0x606C", NODE)]
SHOT = Shot(tuple((100.0 + n / 10, (float(n), None)) for n in range(11)), triggered=100.5)


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


@pytest.mark.parametrize("text", ["scope", "scope.svg", "nowhere/scope.csv"])
def test_another_ending_or_place_is_refused_before_anything_is_looked_at(text):
    with pytest.raises(ConfigError, match=r"-o .*(write NAME\.csv|no folder)"):
        check_output(text)


def test_cursors_tell_what_is_between_them():
    lines = list(cursor_lines(SHOT, SIGNALS, (-0.2, 0.3)))
    assert lines[0] == "cursors at -0.2 s and 0.3 s: dt 0.5 s (2 Hz)"
    assert lines[2].split()[2:5] == ["3", "8", "5"]
    assert lines[3].split()[-4:] == ["-"] * 4


def test_an_overlay_is_measured_below_the_same_signal_and_may_be_of_other_ones(tmp_path):
    write_shot(tmp_path / "old.csv", SHOT, SIGNALS[:1])
    overlay = read_overlay(str(tmp_path / "old.csv"))
    lines = list(shot_lines(SHOT, SIGNALS, overlay))
    assert len(lines) == 5
    assert lines[3].split()[:5] == ["old.csv", "0", "10", "4.5", lines[2].split()[8]]


@pytest.mark.parametrize("name", ["gone.csv", "pixels.csv", "empty.csv"])
def test_what_is_no_overlay_is_told(tmp_path, name):
    (tmp_path / "pixels.csv").write_bytes(b"\x89PNG\xff")
    (tmp_path / "empty.csv").write_text("")
    with pytest.raises(ConfigError, match=name):
        read_overlay(str(tmp_path / name))


@pytest.mark.rest
@pytest.mark.parametrize(("name", "begins"), [("a.csv", b"time,t,5:0x6064"), ("a.png", b"\x89PNG\r\n")])
def test_the_ending_says_what_is_written(tmp_path, name, begins):
    assert write_shot(tmp_path / name, SHOT, SIGNALS, cursors=(0.0, 0.1)) == tmp_path / name
    assert (tmp_path / name).read_bytes().startswith(begins)


def test_a_bag_is_a_folder(tmp_path):
    pytest.importorskip("rosbags.rosbag2")
    assert write_shot(tmp_path / "shot.mcap", SHOT, SIGNALS) == tmp_path / "shot"
    assert (tmp_path / "shot" / "metadata.yaml").exists()
