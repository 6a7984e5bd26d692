import gzip
import io
import itertools
import os
import shutil
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.error_frames import bus_off_frame, overrun_frame
from canopen_control.bus.recordings import (
    FORMATS,
    RecordedFrame,
    Recording,
    RecordingWriter,
    format_of,
    interface_name,
    line_of,
    parse_line,
    read_trc,
)
from canopen_control.errors import ConfigError
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, CanFrame

DATA = CanFrame(0x300, bytes.fromhex("00000000040000"))
REMOTE_OF_TRC = CanFrame(0x100 | REMOTE_FLAG, bytes(3))


def error(classes, data):
    return CanFrame(ERROR_FLAG | classes, bytes.fromhex(data))


WARNING, OFF = error(0x004, "000C000000000000"), error(0x040, "0000000000000000")
UNHEARD = error(0x288, "0000801900000808")
STUFF = error(0x288, "0000840200000000")

V10 = """;   Start time: 11.09.2002 16:00:20.682
     1)      1841      0300  7  00 00 00 00 04 00 00
     2)      1842      0008  4  ERROR 00 19 08 08
     3)      1843  FFFFFFFF  4  00 00 00 04 -- -- -- --  BUSLIGHT
     4)      1844      0100  3  RTR
"""
V11 = """;$FILEVERSION=1.1
;$STARTTIME=37704.5364870833
     1)      1059.9  Rx         0300  7  00 00 00 00 04 00 00
     5)      1346.8  Warng  FFFFFFFF  4  00 00 00 04  BUSLIGHT
     6)      1349.2  Error      0008  4  00 19 08 08
     7)      1352.7  Rx         0100  3  RTR
"""
V12 = """;$FILEVERSION=1.2
;$STARTTIME=39878.6772258947
     1)      1059.900  1  Rx         0300  7  00 00 00 00 04 00 00
     5)      1346.834  1  Warng  FFFFFFFF  4  00 00 00 10  BUSOFF
     6)      1349.222  1  Error     0008  4  00 19 08 08
     7)      1352.743  1  Rx         0100  3  RTR
"""
V13 = """;$FILEVERSION=1.3
;$STARTTIME=40023.5245451516
     1)      1059.900 1  Rx        0300 -  7    00 00 00 00 04 00 00
     5)      1346.834 1  Warng FFFFFFFF -  4    00 00 00 08  BUSHEAVY
     6)      1349.222 1  Error     0008 -  4    00 19 08 08
     7)      1352.743 1  Rx        0100 -  3    RTR
"""
V20 = """;$FILEVERSION=2.0
;$STARTTIME=42209.4075997106
;$COLUMNS=N,O,T,I,d,l,D
      1      1059.900 DT     0300 Rx 7  00 00 00 00 04 00 00
      5      1334.416 FD     0500 Tx 12 01 02 03 04 05 06 07 08 09 0A 0B 0C
      6      1334.522 ER          Rx    04 00 02 00 00
      7      1334.531 ST          Rx    00 00 00 08
      8      1334.643 EC          Rx    02 03
     10      1336.543 RR     0100 Rx 3
"""
V21 = """;$FILEVERSION=2.1
;$STARTTIME=41766.4648963872
;$COLUMNS=N,O,T,B,I,d,R,L,D
      1      1059.900 DT 1      0300 Rx -  7    00 00 00 00 04 00 00
      6      1334.222 ER 1         - Rx -  5    04 00 02 00 00
      7      1334.224 EV 1  User-defined event for bus 1
      9      1334.231 ST 1         - Rx -  4    00 00 00 10
     11      1334.643 EC 1         - Rx -  2    02 03
     12      1335.156 DT 1  18EFC034 Tx -  8    01 02 03 04 05 06 07 08
     13      1336.543 RR 1      0100 Rx -  3
"""
COUNTERS = error(0x200, "0000000000000302")
LONG = CanFrame(0x18EFC034 | EXTENDED_FLAG, bytes(range(1, 9)))


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        (V10, [DATA, UNHEARD, WARNING, REMOTE_OF_TRC]),
        (V11, [DATA, WARNING, UNHEARD, REMOTE_OF_TRC]),
        (V12, [DATA, OFF, UNHEARD, REMOTE_OF_TRC]),
        (V13, [DATA, WARNING, UNHEARD, REMOTE_OF_TRC]),
        (V20, [DATA, None, STUFF, WARNING, COUNTERS, REMOTE_OF_TRC]),
        (V21, [DATA, STUFF, None, OFF, COUNTERS, LONG, REMOTE_OF_TRC]),
    ],
    ids=["1.0", "1.1", "1.2", "1.3", "2.0", "2.1"],
)
def test_every_row_is_a_frame_or_counted(text, frames):
    assert [item and item[1] for item in read_trc(io.StringIO(text), set())] == frames


@pytest.mark.parametrize(
    ("status", "detail"), [("00 00 00 00", "40"), ("00 00 00 02", "01"), ("00 04 00 00", "30"), ("00 04 00 08", "3C")]
)
def test_a_status_becomes_what_a_controller_of_linux_would_report(status, detail):
    text = [*V21.splitlines(keepends=True)[:3], f"      9      1334.231 ST 1         - Rx -  4    {status}\n"]
    [(_, frame)] = read_trc(io.StringIO("".join(text)), set())
    assert frame == error(0x004, f"00{detail}000000000000")


def test_a_row_that_is_cut_is_the_end():
    rows = read_trc(io.StringIO(V21.rstrip()[:-12]), set())
    with pytest.raises(EOFError):
        list(rows)


@given(st.text())
def test_no_text_is_another_error(text):
    before = list(read_trc(io.StringIO(V21), set()))
    assert list(read_trc(io.StringIO(V21 + text + "\n"), set()))[: len(before)] == before


frames = st.one_of(
    st.builds(CanFrame, st.integers(0, 0x7FF), st.binary(max_size=8)),
    st.builds(CanFrame, st.integers(0, 0x1FFFFFFF).map(lambda i: i | EXTENDED_FLAG), st.binary(max_size=8)),
    st.builds(CanFrame, st.integers(0, 0x7FF).map(lambda i: i | REMOTE_FLAG), st.integers(0, 8).map(bytes)),
    st.builds(CanFrame, st.integers(0, 0x3FF).map(lambda i: i | ERROR_FLAG), st.binary(min_size=8, max_size=8)),
)


@given(st.integers(0, 4_000_000_000_000_000), frames)
def test_a_line_reads_back_as_it_was_written(microseconds, frame):
    line = line_of(microseconds * 1000, "can0", frame)
    assert parse_line(line.strip()) == (microseconds * 1000, frame)


@given(st.text(max_size=60))
def test_no_text_is_an_error(text):
    line = parse_line(text)
    assert line is None or isinstance(line[1], CanFrame)


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        ("(1700000000.123456) vcan0 183#3706", CanFrame(0x183, b"\x37\x06")),
        ("(1700000000.123456) vcan0 183#37.06 R", CanFrame(0x183, b"\x37\x06")),
        ("(1700000000.123456) vcan0 703#R", CanFrame(REMOTE_FLAG | 0x703)),
        ("(1700000000.123456) vcan0 00000183#", CanFrame(EXTENDED_FLAG | 0x183)),
    ],
)
def test_lines_of_candump_are_read(line, frame):
    assert parse_line(line) == (1_700_000_000_123_456_000, frame)


@pytest.mark.parametrize(
    ("line", "time_ns", "frame"),
    [
        ("(1700000000.000000) can0 181#0102030405060708_9", 1_700_000_000 * 10**9, CanFrame(0x181, bytes(range(1, 9)))),
        ("(1700000000.000000) can0 181#0102030405060708_F", 1_700_000_000 * 10**9, CanFrame(0x181, bytes(range(1, 9)))),
        ("(1700000000.000000) can0 703#R8_D", 1_700_000_000 * 10**9, CanFrame(0x703 | REMOTE_FLAG, bytes(8))),
        ("(-5.250000) can0 181#01", -5_250_000_000, CanFrame(0x181, b"\1")),
        ("(-0.500000) can0 181#01", -500_000_000, CanFrame(0x181, b"\1")),
    ],
)
def test_a_raw_dlc_and_a_time_before_1970_are_read(line, time_ns, frame):
    assert parse_line(line) == (time_ns, frame)


def test_a_channel_becomes_a_name_that_other_programs_take():
    assert [interface_name(name) for name in ("can0", "local:robby", "", "pcan:PCAN_USBBUS1@500000")] == [
        "can0",
        "local_robby",
        "can0",
        "pcan_PCAN_USBBU",
    ]


@pytest.mark.process
def test_can_utils_reads_our_lines(tmp_path):
    if shutil.which("log2asc") is None:
        pytest.skip("can-utils is not installed")
    log = tmp_path / "x.log"
    log.write_text(line_of(10**18, "can0", CanFrame(0x183, b"\x37\x06")) + line_of(10**18, "can0", CanFrame(0x80)))
    out = subprocess.run(["log2asc", "-I", log, "can0"], capture_output=True, text=True, check=True).stdout
    assert "183" in out
    assert "37 06" in out


START = 1_763_706_802_005_123_000  # five milliseconds after a second: a date with one digit would be misread
PLAIN = [
    CanFrame(0x000, b"\x01\x03"),
    CanFrame(0x080),
    CanFrame(0x183, b"\x37\x06\x03"),
    CanFrame(0x603, bytes(range(8))),
    CanFrame(EXTENDED_FLAG | 0x12345678, b"\xff"),
    CanFrame(EXTENDED_FLAG | 0x183, b"\xff"),
]
REMOTE = CanFrame(REMOTE_FLAG | 0x703, bytes(1))
ALL = tuple(FORMATS)


def stream(frames):
    return [RecordedFrame(START + number * 1_234_000, frame) for number, frame in enumerate(frames)]


def write(path, frames):
    with RecordingWriter(path, "local:robby") as writer:
        for item in stream(frames):
            writer.write(*item)
    return writer


@pytest.mark.parametrize("suffix", ALL)
def test_what_is_written_reads_back_the_same_frame_for_frame(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    writer = write(path, PLAIN)
    assert (writer.written, writer.left_out) == (len(PLAIN), 0)
    recording = Recording(path)
    back = list(recording)
    assert [item.frame for item in back] == PLAIN
    assert list(recording) == back  # a second reading
    assert (recording.skipped, recording.problem) == (0, "")


@pytest.mark.parametrize("suffix", ALL)
def test_times_are_kept_to_a_few_microseconds_and_the_date_to_a_millisecond(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    write(path, PLAIN)
    times = [item.time_ns for item in Recording(path)]
    assert abs(times[0] - START) <= 1_000_000
    assert all(abs((after - before) - 1_234_000) <= 2000 for before, after in itertools.pairwise(times))


@pytest.mark.parametrize(
    ("suffix", "remote", "error"),
    [(".log", True, True), (".asc", True, False), (".blf", True, True), (".trc", False, False)],
)
def test_what_a_format_cannot_hold_is_left_out_and_counted(tmp_path, suffix, remote, error):
    path = tmp_path / f"x{suffix}"
    frames = [PLAIN[0], REMOTE, bus_off_frame(), overrun_frame(7)]
    writer = write(path, frames)
    kept = [PLAIN[0], *([REMOTE] if remote else []), *(frames[2:] if error else [])]
    assert [item.frame for item in Recording(path)] == kept
    assert (writer.written, writer.left_out) == (len(kept), len(frames) - len(kept))


def test_both_dates_of_an_asc_file_are_the_time_of_its_first_frame(tmp_path):
    path = tmp_path / "x.asc"
    write(path, PLAIN)
    lines = path.read_text().splitlines()
    (block,) = (line for line in lines if line.startswith("Begin Triggerblock "))
    assert lines[0].split(maxsplit=1) == ["date", block.removeprefix("Begin Triggerblock ")]
    assert lines[1:3] == ["base hex  timestamps absolute", "internal events logged"]


ASC_EVENTS = (  # the time since the event before, in ms; other events than frames count too
    (0, "Start of measurement"),
    (10, "1  80              Rx   d 0"),
    (1, "1  181             Rx   d 2 37 02"),
    (9, "1  Statistic: D 2 R 0 XD 0 XR 0 E 0 O 0 B 0.02%"),
    (5, "1  80              Rx   d 0"),
)


def test_an_asc_file_with_relative_times_reads_like_one_with_absolute_times(tmp_path):
    block = "Begin Triggerblock Tue Nov 14 10:13:20.000 2023\n"
    since_start = [sum(ms for ms, _ in ASC_EVENTS[: number + 1]) for number in range(len(ASC_EVENTS))]
    frames = []
    for kind, times in (("absolute", since_start), ("relative", [ms for ms, _ in ASC_EVENTS])):
        events = [f"   {ms / 1000:.6f} {text}\n" for ms, (_, text) in zip(times, ASC_EVENTS, strict=True)]
        body = block + "".join(events) + "End TriggerBlock\n"
        path = tmp_path / f"{kind}.asc"
        path.write_text(
            f"date Tue Nov 14 10:13:20.000 2023\nbase hex  timestamps {kind}\nno internal events logged\n{body}{body}"
        )
        frames.append(list(Recording(path)))
    absolute, relative = frames
    assert relative == absolute
    assert [(item.time_ns - absolute[0].time_ns) // 1_000_000 for item in absolute[:3]] == [0, 1, 15]


LOG = "(1700000000.000000) can0 183#3702\n(1700000000.000100) can1 183#1800\n"
ASC = (
    "date Tue Nov 14 10:13:20.000 2023\nbase hex  timestamps absolute\nno internal events logged\n"
    "   0.000000 1  183             Rx   d 2 37 02\n   0.000100 2  183             Rx   d 2 18 00\n"
)


TRC = (
    ";$FILEVERSION=2.1\n;$STARTTIME=45244.425\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"
    "1 0.000 DT 1 0183 Rx - 2 37 02\n2 0.100 DT 2 0183 Rx - 2 18 00\n"
)


@pytest.mark.parametrize(
    ("name", "text", "buses", "advice"),
    [
        ("run.log", LOG, ["can0", "can1"], ": grep ' can0 ' {path} > can0.log"),
        ("my run.log", LOG, ["can0", "can1"], ": grep ' can0 ' '{path}' > can0.log"),
        ("run.asc", ASC, ["1", "2"], ""),
        ("run.trc", TRC, ["1", "2"], ""),
    ],
)
def test_frames_of_several_buses_are_reported_after_reading(tmp_path, name, text, buses, advice):
    path = tmp_path / name
    path.write_text(text)
    recording = Recording(path)
    assert recording.mixture == ""
    assert len(list(recording)) == 2
    sentence = f"{path} contains the frames of 2 buses ({', '.join(buses)}); keep those of one"
    assert recording.mixture == sentence + advice.format(path=path)


@pytest.mark.parametrize("suffix", ALL)
def test_a_recording_of_one_bus_is_no_mixture(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    write(path, PLAIN)
    recording = Recording(path)
    assert list(recording)
    assert recording.mixture == ""


@pytest.mark.parametrize("suffix", ALL)
def test_a_recording_without_frames_is_one_too(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    write(path, [])
    recording = Recording(path)
    assert list(recording) == []
    assert recording.problem == f"{path}: contains no frames"


@pytest.mark.rest
@pytest.mark.parametrize("suffix", ALL)
def test_a_recording_that_was_cut_is_read_up_to_the_cut(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    write(path, PLAIN * 2000)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 2 // 3 + 1])
    recording = Recording(path)
    frames = [item.frame for item in recording]
    assert frames[: len(PLAIN)] == (PLAIN if frames else [])
    assert len(frames) < len(PLAIN) * 2000


@pytest.mark.rest
@pytest.mark.parametrize("kept", [0.3, 0.6, 0.9])
def test_a_blf_that_was_cut_reports_that_it_ends_in_the_middle(tmp_path, kept):
    path = tmp_path / "x.blf"
    write(path, PLAIN * 4000)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * kept)])
    recording = Recording(path)
    frames = len(list(recording))
    assert recording.problem.endswith("the file ends in the middle of a frame")
    assert f"after {frames} frames" in recording.problem
    assert frames > 0 or kept == 0.3


@pytest.mark.parametrize(("suffix", "size"), [(".blf", 50), (".blf", 150), (".trc", 300)])
def test_a_recording_that_was_cut_in_its_head_is_not_a_riddle_either(tmp_path, suffix, size):
    path = tmp_path / f"x{suffix}"
    write(path, PLAIN)
    path.write_bytes(path.read_bytes()[:size])
    recording = Recording(path)
    assert list(recording) == []
    assert recording.problem.split(": ")[-1] in ("the file ends in the middle of a frame", "contains no frames")
    assert "unpack" not in recording.problem


@pytest.mark.parametrize("suffix", ALL)
def test_what_is_not_a_recording_reports_this_and_never_raises(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    path.write_bytes(bytes(range(256)) * 8)
    recording = Recording(path)
    assert list(recording) == []
    assert str(path) in recording.problem


def test_can_fd_frames_of_others_are_skipped_and_counted(tmp_path):
    path = tmp_path / "x.log"
    path.write_text("(1.0) can0 123##01122\n(1.0) can0 123#11\n")
    recording = Recording(path)
    assert len(list(recording)) == 1
    assert recording.skipped == 1


@pytest.mark.parametrize("suffix", [".log", ".asc", ".trc"])
def test_a_packed_recording_is_read_as_an_unpacked_one(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    write(path, PLAIN)
    packed = tmp_path / f"x{suffix.upper()}.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    recording = Recording(packed)
    assert list(recording) == list(Recording(path))
    assert (recording.skipped, recording.problem) == (0, "")


def test_a_log_is_written_packed_where_its_name_reports_this(tmp_path):
    path = tmp_path / "x.log.gz"
    with RecordingWriter(path, "can0") as writer:
        for item in stream(PLAIN * 100):
            writer.write(*item)
        writer.flush()
        assert len(list(Recording(path))) > 500, "what a crash leaves"
    assert [item.frame for item in Recording(path)] == PLAIN * 100


def test_a_packed_recording_that_was_cut_reports_this(tmp_path):
    path = tmp_path / "x.log.gz"
    with RecordingWriter(path, "can0") as writer:
        for number in range(20_000):
            writer.write(START + number * 12_345_678, CanFrame(0x181, number.to_bytes(4, "little")))
    path.write_bytes(path.read_bytes()[:-30_000])
    recording = Recording(path)
    assert 1000 < len(list(recording)) < 20_000
    assert "reading stopped after" in recording.problem
    (tmp_path / "y.log.gz").write_bytes(b"no gzip")
    assert list(recording := Recording(tmp_path / "y.log.gz")) == []
    assert "cannot be read" in recording.problem


@pytest.mark.parametrize(
    ("name", "reason"),
    [("x.blf.gz", "compressed already"), ("x.asc.gz", "written compressed"), ("x.gz", "unknown recording format")],
)
def test_what_is_not_written_packed_is_reported(tmp_path, name, reason):
    with pytest.raises(ConfigError, match=reason):
        RecordingWriter(tmp_path / name)


@pytest.mark.parametrize("suffix", ALL)
def test_times_that_are_a_microsecond_apart_stay_apart(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    with RecordingWriter(path, "can0") as writer:
        for number in range(500):
            writer.write(START + 437 + number * 1000 + number * number, CanFrame(0x80))
    times = [item.time_ns for item in Recording(path)]
    assert all(later > earlier for earlier, later in itertools.pairwise(times))


def test_the_name_specifies_the_format(tmp_path):
    assert format_of("/a/B.LOG") == ".log"
    with pytest.raises(ConfigError, match=r"\.log, \.asc, \.blf, \.trc"):
        format_of("x.db")
    with pytest.raises(ConfigError, match="does not exist"):
        Recording("/nowhere/x.log")
    (folder := tmp_path / "x.log").mkdir()
    with pytest.raises(ConfigError, match=r"x\.log is a folder; name a recording in it"):
        Recording(folder)
    os.mkfifo(tmp_path / "x.asc")
    with pytest.raises(ConfigError, match="is not a regular file"):
        Recording(tmp_path / "x.asc")
    with pytest.raises(ConfigError, match="cannot be written"):
        RecordingWriter("/nowhere/x.blf")


def test_frames_are_in_the_file_after_a_flush(tmp_path):
    path = tmp_path / "x.log"
    writer = RecordingWriter(path)
    writer.write(START, PLAIN[0])
    writer.flush()
    assert path.read_text().endswith("can0 000#0103\n")
    writer.close()
    writer.close()


@pytest.mark.process
@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc"])
def test_a_full_disk_is_reported_with_the_file_and_what_is_in_it(tmp_path, suffix):
    """In a process of its own, whose files may have no more than 100 kB: the kernel refuses as a full disk does."""
    path = tmp_path / f"run{suffix}"
    script = f"""
import resource, signal
from canopen_control.bus.recordings import RecordingWriter
from canopen_control.errors import DiskFull
from canopen_control.frame import CanFrame
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
writer = RecordingWriter({str(path)!r}, "can0")
try:
    with writer:
        for number in range(30_000):
            writer.write(1_700_000_000_000_000_000 + number * 1_000_037, CanFrame(number % 0x7FF, number.to_bytes(8)))
except DiskFull as error:
    print(writer.written)
    print(error)
"""
    done = subprocess.run(
        [sys.executable, "-P", "-W", "error", "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    count, sentence = done.stdout.splitlines()
    assert sentence == f"{path}: File too large; it contains {count} frames"
    assert int(count) == len(list(Recording(path))) > 100


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Return a good recording of each format as bytes."""
    folder = tmp_path_factory.mktemp("good")
    for suffix in FORMATS:
        with RecordingWriter(folder / f"x{suffix}", "can0") as writer:
            for number in range(40):
                frame = CanFrame(0x180 + number % 8, number.to_bytes(2, "little"))
                writer.write(1_700_000_000_000_000_000 + number * 1_000_000, frame)
    return {suffix: (folder / f"x{suffix}").read_bytes() for suffix in FORMATS}


ODD = (b"", b"\xff\xff\xff\xff", b"\0\0\0\0", b"-1", b"9" * 5000, b"nan", b"1e999", b"LOBJ", b"\n", b"(", b"#")


@given(data=st.data())
def test_whatever_is_changed_in_a_recording_it_is_read_or_reported(recordings, tmp_path_factory, data):
    suffix = data.draw(st.sampled_from(sorted(recordings)))
    content = bytearray(recordings[suffix])
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content)))
        content[at : at + data.draw(st.sampled_from((0, 1, 4, 60)))] = data.draw(st.sampled_from(ODD))
    path = tmp_path_factory.mktemp("odd") / f"x{suffix}"
    path.write_bytes(content)
    recording = Recording(path)
    count = len(list(recording))
    assert count <= 200
    assert count or recording.problem or recording.skipped


@pytest.mark.parametrize("suffix", sorted(FORMATS))
def test_a_new_recording_is_its_users_alone(tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    with RecordingWriter(path, "can0"):
        pass
    assert path.stat().st_mode & 0o777 == 0o600
