"""Frames into load, states and last words."""

import pytest

from canopen_control.frame import EXTENDED_FLAG, CanFrame
from canopen_control.trace.network_description import NetworkDescription
from canopen_control.trace.report_build import networks_of, read_frames

NS = 1_000_000_000


def test_the_load_is_bits_by_the_bit_rate():
    frames = [(NS + n * NS // 1000, "can", CanFrame(0x181, bytes(8))) for n in range(1000)]
    bus = read_frames(frames, {"can": NetworkDescription(bitrate=500_000)}, 1.0, None).buses()["can"]
    assert bus.frames == 1000
    assert bus.services == {"pdo": 1000}
    assert bus.load.time == [0.25, 0.75]
    assert bus.load.value == pytest.approx([(47 + 64) * 1000 / 500_000] * 2, rel=0.01)


def test_a_half_second_that_is_cut_is_not_less_load():
    frames = [(n * NS // 1000, "can", CanFrame(0x181, bytes(8))) for n in range(760)]
    load = read_frames(frames, {}, 0.0, None).buses()["can"].load.value
    assert load == pytest.approx([load[0], load[0]], rel=0.01)
    assert len(read_frames(frames[:510], {}, 0.0, None).buses()["can"].load.value) == 1


def test_a_quiet_half_second_is_no_load():
    frames = [(0, "can", CanFrame(0x80)), (2 * NS, "can", CanFrame(0x80))]
    assert read_frames(frames, {}, 0.0, None).buses()["can"].load.value[1:4] == [0.0, 0.0, 0.0]


def test_heartbeats_tell_nmt_states_and_silence():
    beats = [(0, 5), (NS, 5), (2 * NS, 0x7F)]
    frames = [(time, "can", CanFrame(0x703, bytes([state]))) for time, state in beats]
    nodes = read_frames([*frames, (9 * NS, "can", CanFrame(0x80))], {}, 0.0, None).nodes()
    assert [(span.state, span.end) for span in nodes["node 3"].nmt] == [
        ("OPERATIONAL", 2.0),
        ("PRE_OPERATIONAL", 2.0),
        (None, 9.0),
    ]


def test_frames_before_and_after_the_fault_and_the_last_of_each_node(lost_drive):
    begin = lost_drive.frames[0][0] / NS
    facts = read_frames(lost_drive.frames, networks_of(lost_drive), begin, 2.5)
    times = [frame.time for frame in facts.around]
    assert times == sorted(times)
    assert sum(time <= 2.5 for time in times) == 40
    assert sum(time > 2.5 for time in times) == 15
    last = facts.last_words
    assert last[0].node == "left_drive"
    assert last[0].time == pytest.approx(2.0, abs=0.15)
    assert "Statusword" in " ".join(frame.text for frame in facts.around)


def test_a_29_bit_identifier_is_not_taken_for_one_of_11_bits():
    frames = [(n, "can", CanFrame(can_id, b"")) for n, can_id in enumerate((0x183, 0x183 | EXTENDED_FLAG))]
    around = read_frames(frames, {}, 0.0, None).around
    assert [(frame.id, frame.node) for frame in around] == [("183", "node 3"), ("00000183", "")]


def test_statuswords_that_repeat_make_no_new_span():
    frames = [(n, "can", CanFrame(0x183, b"\x37\x06\x03")) for n in range(100)]
    assert read_frames(frames, {}, 0.0, None).nodes() == {}  # nobody said that it carries a statusword
