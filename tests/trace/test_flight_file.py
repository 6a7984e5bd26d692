"""The file of a flight recorder: written whole, read back equal, and never too many of them."""

import errno
import json
import tracemalloc
import zipfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from canopen_control.bus.recordings import line_of
from canopen_control.errors import ConfigError, DiskFull
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, CanFrame, pack_records, remote_frame
from canopen_control.rpc.messages.layout import BusLayout, Layout, NodeLayout
from canopen_control.rpc.messages.robot import RequestSeen
from canopen_control.rpc.messages.state import RobotEvent, StateSample
from canopen_control.rpc.wire import Raw, plain, text_of
from canopen_control.trace import flight_file
from canopen_control.trace.flight_file import (
    MAX_FILES,
    FlightMeta,
    FrameRing,
    KeptFrame,
    LineRing,
    candump_lines,
    is_flight_file,
    newest,
    read_flight,
    read_meta,
    save,
    write_flight,
)
from canopen_control.trace.report_build import facts_of
from canopen_control.trace.report_page import page_of

S = 1_000_000_000


def record(number):
    return number.to_bytes(16, "little")


def test_a_bus_that_is_silent_keeps_nothing_of_another():
    ring = FrameRing(60 * S, 1 << 20)
    ring.add(0, record(0), [0])
    for second in range(200):
        ring.add(1, record(second), [second * S])
    assert [frame.bus for frame in ring.frames(0)] == [1] * 61
    assert ring.size == 61 * 24
    ring.add(0, record(0), [200 * S])
    assert [frame.bus for frame in ring.frames(0)][-1] == 0


def test_a_bus_at_full_speed_shortens_the_window_instead_of_filling_the_memory():
    ring = FrameRing(60 * S, 100_000)
    for number in range(50_000):
        ring.add(0, record(number), [number * 1000])
    assert ring.size < 2 * 100_000
    kept = list(ring.frames(0))
    assert kept[-1].record == record(49_999)
    assert len(kept) > 100_000 / (16 + 8) / 2


@given(st.lists(st.tuples(st.integers(1, 3 * S), st.integers(0, 2), st.integers(1, 50))))
def test_the_newest_frames_are_there_in_order_and_the_memory_is_bounded(additions):
    ring, now, added = FrameRing(10 * S, 4000), 0, []
    for pause, bus, count in additions:
        times = [now + pause + item for item in range(count)]
        now = times[-1]
        numbers = [len(added) + item for item in range(count)]
        ring.add(bus, b"".join(map(record, numbers)), times)
        added += [(time, bus, record(number)) for time, number in zip(times, numbers, strict=True)]
        kept = list(ring.frames(0))
        assert kept == sorted(kept)
        assert set(kept) <= set(added)
        assert kept[-count:] == added[-count:]
        assert ring.size == 24 * len(kept) <= 4000 + 3 * (4000 // 8 * 24 // 16 + 51 * 24)


def test_lines_are_kept_by_age_and_by_bytes():
    lines = LineRing(10 * S, 1000)
    for second in range(20):
        lines.add(b"x%d" % second, second * S)
    assert list(lines.lines()) == [b"x%d" % second for second in range(9, 20)]
    assert list(lines.lines(since=18 * S)) == [b"x18", b"x19"]
    lines.add(b"y" * 990, 19 * S)
    assert lines.size <= 1000


RELEASED = Path(__file__).parents[1] / "data" / "flight_recording.zip"  # as it was written before protocol 2
REASON = RobotEvent(time=1.0, kind="heartbeat_lost", node="left_drive", level="error", text="gone")
META = FlightMeta(robot="robby", reason=REASON, written=1_700_000_000.0, buses={"can": "local:robby"})
FRAMES = [
    CanFrame(0x183, bytes.fromhex("370603")),
    CanFrame(0x80),
    remote_frame(0x701, 1),
    CanFrame(0x12345678 | EXTENDED_FLAG, b"\x01"),
    CanFrame(ERROR_FLAG | 0x40, bytes(8)),
]


def sample(time, **more):
    """Return a line of states.jsonl."""
    cycle = {"period_s": 0.02, "count": 1, "missed": 0, "late_max_s": 0.0, "work_max_s": 0.0}
    state = {"time": time, "state": "running", "nodes": {}, "joints": {}, "cycle": cycle, **more}
    return json.dumps(state).encode()


def write(folder, frames=FRAMES, **meta):
    kept = [KeptFrame(5_000_000_123, 0, pack_records([frame])) for frame in frames]
    lines = candump_lines(kept, ["can"], 1_600_000_000_000_000_000)
    return save(folder, replace(META, **meta), lines, [text_of(REASON)], [sample(1) + b"\n", sample(2) + b"\n"])


def test_what_clients_asked_for_is_read_back_where_it_is_there(tmp_path):
    request_seen = RequestSeen(2.0, "stop", Raw(b'{"latch":true}'))
    path = tmp_path / "run.zip"
    write_flight(path, META, iter(()), [], [], [text_of(request_seen)])
    [result] = read_flight(path).requests
    assert (result.time, result.method, bytes(result.params)) == (2.0, "stop", b'{"latch":true}')
    assert read_flight(RELEASED).requests == []


def test_what_is_written_is_read_back(tmp_path):
    path = write(tmp_path)
    assert is_flight_file(path)
    file = read_flight(path)
    assert file.meta == read_meta(path) == META
    assert file.events == [REASON]
    assert [state.time for state in file.states] == [1, 2]
    assert [frame for _, _, frame in file.frames] == FRAMES
    times = [1_600_000_005_000_000_000 + 1000 * number for number in range(len(FRAMES))]
    assert [(time, bus) for time, bus, _ in file.frames] == [(time, "can") for time in times], "none at the same time"
    assert file.unread_lines == 0


def test_a_recording_of_before_protocol_2_still_opens():
    file = read_flight(RELEASED)
    assert (file.meta.robot, file.meta.reason.kind, file.meta.reason.node) == ("robby", "pdo_stale", "left_drive")
    assert [len(part) for part in (file.events, file.states, file.frames, file.eds)] == [28, 30, 806, 1]
    assert file.states[0].nodes["left_drive"].axes[0].state == "OPERATION_ENABLED"
    facts = facts_of(file)
    assert facts.fault.text == file.meta.reason.text
    assert [span.state for span in facts.nodes["left_drive"].axes["left_wheel_joint"]] == ["OPERATION_ENABLED", None]
    assert {step.node for step in facts.boot} == {"left_drive", "right_drive"}
    assert facts.cycle.count == (file.states[-1].cycle.count - file.states[0].cycle.count)
    assert file.unread_lines == 0


def test_the_name_specifies_when_and_why_and_is_never_taken_twice(tmp_path):
    first, second = write(tmp_path), write(tmp_path)
    assert first.name.endswith("-heartbeat_lost-left_drive.zip")
    assert second.name.endswith("-heartbeat_lost-left_drive-2.zip")
    odd = write(tmp_path, reason=replace(REASON, kind="../x y", node=None))
    assert odd.parent == tmp_path
    assert odd.name.endswith("-_x_y.zip")


def test_a_folder_keeps_the_newest(tmp_path):
    paths = [write(tmp_path, written=1_700_000_000.0 + number) for number in range(MAX_FILES + 5)]
    assert sorted(tmp_path.iterdir()) == paths[5:]
    assert newest(tmp_path) == paths[-1]
    assert newest(tmp_path / "nowhere") is None


def test_a_file_is_whole_or_not_there(tmp_path):
    def failing():
        yield "(1.0) can 080#\n"
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(DiskFull, match=r"left_drive\.zip: No space left on device; this recording is lost"):
        save(tmp_path, META, failing(), [], [])
    assert list(tmp_path.iterdir()) == []


def test_the_eds_files_of_the_nodes_come_along(tmp_path):
    eds = tmp_path / "drive.eds"
    eds.write_bytes(b"[FileInfo]")
    paths = [str(eds), str(eds), str(tmp_path / "gone.eds"), ""]
    nodes = tuple(NodeLayout("a", 3, path) for path in paths)
    layout = Layout({"can": BusLayout("local:x", 500_000, 1, nodes=nodes)})
    assert read_flight(write(tmp_path / "flight", layout=layout)).eds == {"drive.eds": b"[FileInfo]"}


@pytest.mark.parametrize("content", [b"", b"no zip", None, {"format": "another"}, {"version": 99}])
def test_what_is_not_a_recording_is_refused_in_a_sentence(tmp_path, content):
    path = tmp_path / "x.zip"
    if isinstance(content, dict):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("meta.json", json.dumps({"format": flight_file.FORMAT, "version": 1, **content}))
    elif content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"x\.zip"):
        read_flight(path)


def rewritten(path, **content):
    """Write a recording again with other bytes in some of its files; return the path."""
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in {**files, **content}.items():
            archive.writestr(name, data)
    return path


def changed(document, changes):
    """Return a document as bytes, with other members; without those that are changed to ..."""
    return json.dumps({key: each for key, each in {**document, **changes}.items() if each is not ...}).encode()


def meta(**changes):
    return changed(json.loads(text_of(META)), changes)


def event(**changes):
    return changed(json.loads(text_of(REASON)), changes)


def bus(**changes):
    return {"buses": {"can": {"channel": "local:x", "bitrate": 500_000, **changes}}}


MIB = bytes(1 << 20)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("meta.json", b'{"a":' + b"[" * 200_000, "meta.json: it is nested too deep"),
        ("meta.json", b"[]", "meta.json: Expected `object`, got `array`"),
        ("meta.json", meta(robot=...), "meta.json: Object missing required field `robot`"),
        ("meta.json", meta(reason=...), "meta.json: Object missing required field `reason`"),
        ("meta.json", meta(reason={"time": 1}), "Object missing required field `kind` - at `$.reason`"),
        ("meta.json", meta(buses={"can": 1}), "Expected `str`, got `int` - at `$.buses[...]`"),
        ("meta.json", meta(layout=bus(bitrate=0)), "Expected `int` >= 1 - at `$.layout.buses[...].bitrate`"),
        ("meta.json", meta(layout=bus(nodes=[{"name": "a", "node_id": 200}])), "`int` <= 127 - at `$.layout.buses"),
        ("meta.json", meta(status={"boot": [{"node": "a", "step": "b", "seconds": "long"}]}),
         "Expected `float`, got `str` - at `$.status.boot[0].seconds`"),
        ("events.jsonl", b'{"time": 1', "events.jsonl, line 1: Input data was truncated"),
        ("events.jsonl", event(time="soon"), "events.jsonl, line 1: Expected `float`, got `str` - at `$.time`"),
        ("events.jsonl", event(time=1e300), "events.jsonl, line 1: Expected `float` < 1"),
        ("events.jsonl", event(level=3), "line 1: Expected `str`, got `int` - at `$.level`"),
        ("events.jsonl", event(text=...), "line 1: Object missing required field `text`"),
        ("events.jsonl", event() + b"\n" + b"\xff\xfe\x00", "events.jsonl, line 2: JSON is malformed"),
        ("events.jsonl", event(count=10**30), "at `$.count`"),
        ("states.jsonl", sample(1) + b"\n" + sample(2, joints={"a": {"velocity": "fast"}}),
         "states.jsonl, line 2: Expected `float | null`, got `str` - at `$.joints[...].velocity`"),
        ("states.jsonl", sample(1, joints={"a": {"velocity": float("nan")}}), "line 1: JSON is malformed"),
        ("states.jsonl", sample(1, nodes={"a": {}}), "line 1: Object missing required field `node_id` - at `$.nodes"),
        ("states.jsonl", b'{"state": "running"}', "line 1: Object missing required field `time`"),
        ("states.jsonl", b'{"a":' + b"[" * 200_000, "states.jsonl, line 1: it is nested too deep"),
        ("events.jsonl", MIB * 5, "events.jsonl is larger than 4 MiB"),
        ("states.jsonl", MIB * 33, "states.jsonl is larger than 32 MiB"),
        ("eds/a.eds", MIB * 17, "eds/a.eds is larger than 16 MiB"),
    ],
)  # fmt: skip
def test_what_is_damaged_or_made_to_harm_is_reported_with_its_place(tmp_path, name, data, words):
    path = rewritten(write(tmp_path), **{name: data})
    with pytest.raises(ConfigError) as caught:
        read_flight(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The members of a recording of a robot whose drive fails, small, with the bytes of each of its files."""
    path = tmp_path_factory.mktemp("whole") / "x.zip"
    file = read_flight(RELEASED)
    kept = (
        [text_of(state) for state in file.states[:3]],
        [text_of(item) for item in file.events if item.level != "info"],
    )
    return path, {
        "meta.json": [text_of(file.meta)],
        "states.jsonl": kept[0],
        "events.jsonl": kept[1],
        "can.log": [line_of(*frame).rstrip().encode() for frame in file.frames[-50:]],
    }


def places(value, way=()):
    """Yield the way to every value inside a value."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, each in inside:
        yield (*way, key)
        yield from places(each, (*way, key))


def damaged(value, way, new):
    """Return it with another value, or none at all (`new` is ...), at a place."""
    inside = value
    for key in way[:-1]:
        inside = inside[key]
    if new is ...:
        del inside[way[-1]]
    else:
        inside[way[-1]] = new
    return value


ODD = st.sampled_from([..., None, True, -1, 0, 1e308, "text", "", [], {}, [1], {"a": 1}, 10**30, "STATUSWORD"])


@given(data=st.data())
def test_whatever_is_changed_is_refused_in_a_sentence_or_reported(whole, data):
    path, members = whole
    name = data.draw(st.sampled_from(("meta.json", "events.jsonl", "states.jsonl")))
    documents = [json.loads(line) for line in members[name]]
    way = data.draw(st.sampled_from([way for way in places(documents) if len(way) > 1]))
    lines = [json.dumps(item).encode() for item in damaged(documents, way, data.draw(ODD))]
    with zipfile.ZipFile(path, "w") as archive:
        for each, content in {**members, name: lines}.items():
            archive.writestr(each, b"\n".join(content))
    refusal, facts = "", None
    try:
        facts = facts_of(read_flight(path))
    except ConfigError as error:
        refusal = str(error)
    if facts is None:
        assert refusal.startswith(f"{path}: this is not a flight recording")
    else:
        assert facts.summary
        assert page_of(facts).startswith("<!doctype html>")
        json.dumps(plain(facts), allow_nan=False)


@pytest.mark.rest
def test_a_size_that_lies_is_not_trusted(tmp_path):
    path = rewritten(write(tmp_path), **{"events.jsonl": MIB * 200})
    data = bytearray(path.read_bytes())
    true, false = (200 << 20).to_bytes(4, "little"), (1 << 20).to_bytes(4, "little")
    assert data.count(true) == 2  # its own header, and the directory
    path.write_bytes(data.replace(true, false))
    tracemalloc.start()
    with pytest.raises(ConfigError, match="is not a flight recording"):
        read_flight(path)
    assert tracemalloc.get_traced_memory()[1] < 16 << 20
    tracemalloc.stop()


@pytest.mark.rest
def test_more_files_than_a_recording_has_are_refused(tmp_path):
    path = rewritten(write(tmp_path), **{f"eds/{number}.eds": b"" for number in range(1001)})
    with pytest.raises(ConfigError, match=r"not a flight recording: it contains 1006 files"):
        read_flight(path)
    path = rewritten(write(tmp_path), **{f"eds/{number}.eds": MIB * 15 for number in range(5)})
    with pytest.raises(ConfigError, match=r"the content of eds/ is larger than 64 MiB"):
        read_flight(path)


def test_lines_that_are_not_frames_are_counted(tmp_path):
    lines = ["(1.0) can 080#\n", "nonsense\n", "(1.5) can 1FFFFFFFF#00\n", "(2.5) can 181#0102\n"]
    file = read_flight(save(tmp_path, META, iter(lines), [], []))
    assert [frame.can_id for _, _, frame in file.frames] == [0x80, 0x181]
    assert file.unread_lines == 2


def test_samples_have_what_controllers_reported_unless_an_earlier_version_reported_it_otherwise(tmp_path):
    reported = {"front": {"kind": "range", "time": 1.0, "frame_id": "f", "range": 1.25}}
    (state,) = read_flight(rewritten(write(tmp_path), **{"states.jsonl": sample(1, samples=reported)})).states
    assert state.samples["front"].range == 1.25
    path = rewritten(write(tmp_path), **{"states.jsonl": sample(1, samples={"front": {"kind": "sonar", "time": 1.0}})})
    (state,) = read_flight(path).states
    assert not isinstance(state, StateSample)
    assert state.time == 1
