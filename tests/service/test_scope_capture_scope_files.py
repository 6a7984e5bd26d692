import math
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.service_node import NodeStub

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.service.node_session import NodeSession
from canopen_control.service.scope_capture import NamedShot, Shot, csv_of, named_shot, parse_csv, picture_of, write_bag
from canopen_control.service.scope_signals import joint_signal_of, signal_of

NODE = NodeSession(NodeStub({}), 5, read_eds(data_path("eds", "TMCM-1270.eds"), 5).od)
SIGNALS = [signal_of("5:0x6064", NODE), joint_signal_of("wheel:velocity")]
SHOT = Shot(tuple((100.0 + n / 10, (float(n), None)) for n in range(11)), triggered=100.5)
NAMED = named_shot(SHOT, SIGNALS)


def test_csv_has_times_from_the_trigger_and_nothing_where_nothing_is_known():
    lines = csv_of(NAMED).splitlines()
    assert lines[:2] == ["time,t,5:0x6064,wheel:velocity", "100.000000,-0.500000,0,"]
    assert lines[-1] == "101.000000,0.500000,10,"


@given(
    st.lists(st.tuples(st.integers(0, 10**6), st.none() | st.integers(-(10**8), 10**8)), min_size=1, max_size=30),
    st.none() | st.integers(0, 29),
)
def test_what_was_written_is_read_back(samples, trigger):
    now, rows = 1_000_000, []
    for step, value in samples:
        now += step
        rows.append((now / 1e6, (None if value is None else float(value),)))
    shot = Shot(tuple(rows), None if trigger is None else rows[min(trigger, len(rows) - 1)][0])
    back = parse_csv(csv_of(NamedShot(shot, ("a,b",))), "x.csv")
    assert (back.names, back.label, back.place("a,b"), back.place("c")) == (("a,b",), "x.csv", 0, None)
    assert [row for _, row in back.shot.rows] == [row for _, row in rows]
    assert [time for time, _ in back.shot.rows] == pytest.approx([time for time, _ in rows], abs=2e-6)
    assert back.shot.zero == pytest.approx(shot.zero, abs=3e-6)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "is no shot of a scope"),
        ("time_s,command\n0,1\n", "is no shot of a scope"),
        ("time,t,a\n", "is no shot of a scope"),
        ("time,t,a\n1,0,x\n", "a cell is no number"),
        ("time,t,a\n1\n", "a cell is no number"),
        ("time,t,a\n1,0,2,3\n", "more or fewer cells"),
    ],
)
def test_what_is_no_shot_is_told(text, why):
    with pytest.raises(ConfigError, match=why):
        parse_csv(text, "file.csv")


def pixels(data):
    """Return the size of a picture, and how many of its pixels have each of some colours."""
    image = pytest.importorskip("matplotlib.image")
    import io

    found = image.imread(io.BytesIO(data))[:, :, :3]

    def count(red, green, blue):
        near = abs(found - [red / 255, green / 255, blue / 255]).max(axis=2) < 0.2
        return int(near.sum())

    return found.shape, count(0x1F, 0x77, 0xB4), count(0x9A, 0xA5, 0xB1), count(0x16, 0x32, 0x4F)


@pytest.mark.rest
def test_a_picture_has_the_signal_its_overlay_and_the_cursors():
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install canopen-control[plot]")
    size, signal, overlay, cursor = pixels(picture_of(NAMED))
    assert size[1] > size[0] > 300
    assert signal > 200
    other = NamedShot(Shot(tuple((time, (5.0,)) for time, _ in SHOT.rows), 100.2), ("5:0x6064",), ("",), "old")
    _, again, below, lines = pixels(picture_of(NAMED, other, (-0.2, 0.2)))
    assert again > 200
    assert below > overlay + 200
    assert lines > cursor + 200


def test_a_signal_that_is_never_known_is_an_empty_picture():
    pytest.importorskip("matplotlib")
    unknown = NamedShot(Shot(((0.0, (None,)), (1.0, (math.nan,)))), ("a",))
    assert picture_of(unknown).startswith(b"\x89PNG")


def test_without_matplotlib_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(ConfigError, match=r"pip install canopen-control\[plot\]; or write NAME\.csv"):
        picture_of(NAMED)


@pytest.mark.rest
def test_a_bag_has_a_topic_for_each_signal(tmp_path):
    reader = pytest.importorskip("rosbags.rosbag2")
    both = Shot(tuple((time, (value[0], 2.0)) for time, value in SHOT.rows))
    write_bag(tmp_path / "shot", both, SIGNALS)
    with reader.Reader(tmp_path / "shot") as bag:
        topics = {each.topic: each.msgcount for each in bag.connections}
    assert topics == {"/scope/node_5/o6064_00": 11, "/scope/wheel/velocity": 11}
