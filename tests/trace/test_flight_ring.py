"""The recorder's memory: what is in it, and that it never grows beyond its bounds."""

from hypothesis import given
from hypothesis import strategies as st

from canopen_control.trace.flight_ring import FrameRing, LineRing

S = 1_000_000_000


def record(number):
    return number.to_bytes(16, "little")


def test_what_came_in_one_reading_comes_out_as_it_went_in():
    ring = FrameRing(60 * S, 1 << 20)
    ring.add(0, record(1) + record(2), 5)
    ring.add(1, record(3), S + 5)
    assert list(ring.batches(0)) == [(5, 0, record(1) + record(2)), (S + 5, 1, record(3))]
    assert [batch.time for batch in ring.batches(6)] == [S + 5]


def test_frames_older_than_the_window_are_forgotten_by_the_second():
    ring = FrameRing(60 * S, 1 << 20)
    for second in range(100):
        ring.add(0, record(second), second * S)
    times = [batch.time // S for batch in ring.batches(0)]
    assert times == list(range(39, 100))


def test_a_bus_at_full_speed_shortens_the_window_instead_of_filling_the_memory():
    ring = FrameRing(60 * S, 100_000)
    for number in range(50_000):
        ring.add(0, record(number), number * 1000)
    assert ring.size < 2 * 100_000
    kept = list(ring.batches(0))
    assert kept[-1].records == record(49_999)
    assert len(kept) > 100_000 / (16 + 24) / 2


@given(st.lists(st.tuples(st.integers(0, 3 * S), st.integers(0, 2), st.integers(1, 50))))
def test_the_newest_frames_are_there_in_order_and_the_memory_is_bounded(additions):
    ring, now, added = FrameRing(10 * S, 4000), 0, []
    for pause, bus, count in additions:
        now += pause
        records = record(len(added)) * count
        ring.add(bus, records, now)
        added.append((now, bus, records))
        kept = list(ring.batches(0))
        assert kept == added[len(added) - len(kept) :]
        assert len(kept) >= 1
        assert ring.size <= 4000 + 4000 // 8 + 50 * 16 + 2 * 24 + 1000
        assert ring.size == sum(len(batch.records) + 24 for batch in kept)


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
