"""The recorder's memory: what is in it, and that it never grows beyond its bounds."""

from hypothesis import given
from hypothesis import strategies as st

from canopen_control.trace.flight_file import FrameRing, LineRing

S = 1_000_000_000


def record(number):
    return number.to_bytes(16, "little")


def test_each_frame_comes_out_with_its_own_time():
    ring = FrameRing(60 * S, 1 << 20)
    ring.add(0, record(1) + record(2), [5, 7])
    ring.add(0, record(3), [S + 7])
    assert list(ring.frames(0)) == [(5, 0, record(1)), (7, 0, record(2)), (S + 7, 0, record(3))]
    assert [frame.time for frame in ring.frames(6)] == [7, S + 7]


def test_frames_of_several_buses_come_out_in_the_order_of_time():
    ring = FrameRing(60 * S, 1 << 20)
    ring.add(0, record(1) + record(4), [1, 4])
    ring.add(1, record(2) + record(3) + record(5), [2, 3, 5])
    assert [(frame.time, frame.bus) for frame in ring.frames(0)] == [(1, 0), (2, 1), (3, 1), (4, 0), (5, 1)]
    assert [frame.record for frame in ring.frames(0)] == [record(number) for number in range(1, 6)]


def test_frames_older_than_the_window_are_forgotten_by_the_second():
    ring = FrameRing(60 * S, 1 << 20)
    for second in range(100):
        ring.add(0, record(second), [second * S])
    times = [frame.time // S for frame in ring.frames(0)]
    assert times == list(range(39, 100))


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
        times = [now + pause + each for each in range(count)]
        now = times[-1]
        numbers = [len(added) + each for each in range(count)]
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


def test_without_a_window_only_bytes_count():
    lines = LineRing(None, 10)
    for number in range(5):
        lines.add(b"abcd", number * 1000 * S)
    assert list(lines.lines()) == [b"abcd", b"abcd"]


def test_a_line_longer_than_the_limit_is_not_kept():
    lines = LineRing(None, 10)
    lines.add(b"z" * 11, 0)
    assert list(lines.lines()) == []
    assert lines.size == 0
