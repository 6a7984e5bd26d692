"""The listener: right bytes pass; a wrong byte, a dropped, doubled or late frame is named."""

import struct

import pytest
from canopen_control_bench.listener import cycles_of, judge

from canopen_control.frame import CanFrame

NODES = (2, 3)


def cycle(number, nodes=NODES):
    answers = [
        frame
        for node in nodes
        for frame in (
            CanFrame(0x180 + node, b"\x37\x16\x03"),
            CanFrame(0x280 + node, struct.pack("<ii", number, 100)),
        )
    ]
    commands = [
        frame
        for position, node in enumerate(nodes)
        for frame in (
            CanFrame(0x200 + node, b"\x0f\x00\x03"),
            CanFrame(0x300 + node, struct.pack("<ii", 0, number + position)),
        )
    ]
    return [*answers, *commands]


def verdict(cycles):
    return judge(cycles, NODES, lambda number, position: (number + position,))


def good(count=60):
    return [cycle(number) for number in range(count)]


def test_frames_are_cut_at_syncs_and_only_pdos_count():
    beat, sync = CanFrame(0x702, b"\x05"), CanFrame(0x080)
    frames = [CanFrame(0x202, b"..."), sync, *cycle(0), beat, sync, *cycle(1), sync, CanFrame(0x182, b"...")]
    assert cycles_of(frames) == [cycle(0), cycle(1)]


def test_right_bytes_pass():
    found = verdict(good())
    assert (found.cycles, found.count, found.late) == (60, 0, 0)


@pytest.mark.parametrize(
    ("place", "data", "said"),
    [
        (0, b"\x18\x06\x03", "not enabled"),
        (0, b"\x37\x16\x01", "not enabled"),
        (1, b"\x00" * 7, "7 bytes"),
        (4, b"\x0f\x00\x01", "0f0001"),
        (5, struct.pack("<ii", 0, 8), "velocity 8"),
        (7, struct.pack("<ii", 7, -8), "velocity -8"),
    ],
)
def test_a_wrong_byte_is_named(place, data, said):
    cycles = good()
    cycles[7][place] = CanFrame(cycles[7][place].can_id, data)
    found = verdict(cycles)
    assert found.count == 1
    assert "cycle 7" in found.wrong[0]
    assert said in found.wrong[0]


@pytest.mark.parametrize("place", range(8))
def test_a_dropped_frame_is_named(place):
    cycles = good()
    gone = cycles[7].pop(place)
    found = verdict(cycles)
    assert any("cycle 7" in text and hex(gone.can_id) in text for text in found.wrong), found


def test_a_doubled_frame_and_a_stranger_are_named():
    doubled, stranger = good(), good()
    doubled[7].append(doubled[7][4])
    stranger[7].append(CanFrame(0x185, b"\x37\x16\x03"))
    assert "too many: 0x202" in verdict(doubled).wrong[0]
    assert "too many: 0x185" in verdict(stranger).wrong[0]


def test_answers_that_come_in_the_next_cycle_are_late_and_not_wrong():
    cycles = good()
    cycles[7], cycles[8] = cycles[7][4:], cycles[7][:4] + cycles[8]
    found = verdict(cycles)
    assert (found.count, found.late) == (0, 1)


def test_drives_without_a_processor_are_told_apart_from_wrong_bytes():
    starved, mute = good(), good()
    for cycle_ in starved[7:]:
        del cycle_[:4]
    for cycle_ in mute[7:]:
        del cycle_[-1:]
    assert verdict(starved).count == verdict(starved).starved > 0
    assert verdict(mute).count > 0 == verdict(mute).starved


def test_only_the_first_mistakes_are_kept():
    found = verdict([[]] * 100)
    assert found.count > len(found.wrong) > 0
