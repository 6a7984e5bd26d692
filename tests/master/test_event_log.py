import pytest

from canopen_control.master.event_log import FEW, FIRST_WINDOW_NS, WIDEST_WINDOW_NS, Event, EventLog, Level

S = 1_000_000_000


def warning(time, text="error frame: 3 of 5", kind="bus_error", node="", **more):
    return Event(time, kind, node, text, Level.WARNING, **more)


def run(log, events, until):
    """Add events, and let time pass in steps of 100 ms; return what was reported, with its time."""
    reported, events = [], sorted(events, key=lambda event: event.time)
    for now in range(0, until, S // 10):
        while events and events[0].time <= now:
            reported += [(now, item) for item in log.add(events.pop(0))]
        if now >= log.due:
            reported += [(now, item) for item in log.tick(now)]
    return reported


def test_each_event_is_taken_once():
    log = EventLog()
    assert [event.kind for event in log.add(Event(1, "ready", "left", "is ready"))] == ["ready"]
    assert [event.kind for event in log.take()] == ["ready"]
    assert log.take() == []
    assert len(log.recent) == 1


def test_an_unread_queue_keeps_the_newest_and_counts_the_rest():
    log = EventLog(capacity=4)
    for number in range(10):
        log.add(Event(number, "emcy", f"node{number}", "x"))
    assert [event.time for event in log.take()] == [6, 7, 8, 9]
    assert log.dropped == 6
    assert [event.time for event in log.recent] == [6, 7, 8, 9]


@pytest.mark.rest
def test_fifty_thousand_error_frames_are_a_handful_of_lines_and_one_entry_with_its_count():
    log = EventLog()
    flood = [warning(number * 200_000, f"error frame: {number} of 5") for number in range(50_000)]  # ten seconds
    reported = run(log, flood, 60 * S)
    assert len(reported) <= 5
    assert reported[0][1].sentence == "error frame: 0 of 5"
    assert reported[-1][1].sentence == "error frame: 49999 of 5 (50000 times in 10.0 s)"
    (entry,) = log.recent
    assert (entry.count, entry.since, entry.time) == (50_000, 0, 49_999 * 200_000)
    assert len(log.take()) == len(reported)


def test_one_that_continues_for_hours_is_reported_once_a_minute():
    log = EventLog()
    reported = run(log, [warning(number * S) for number in range(3600)], 3600 * S)
    assert 3600 / 64 <= len(reported) <= 3600 / 64 + 10
    assert WIDEST_WINDOW_NS >= reported[-1][0] - reported[-2][0] >= WIDEST_WINDOW_NS - S


def test_what_comes_again_after_a_while_is_reported_at_once():
    log = EventLog()
    reported = run(log, [warning(0), warning(S), warning(30 * S)], 60 * S)
    assert [(now, event.count) for now, event in reported] == [(0, 1), (FIRST_WINDOW_NS, 2), (30 * S, 1)]
    assert reported[1][1].sentence == "error frame: 3 of 5 (2 times in 1.0 s)"


def test_other_nodes_kinds_codes_and_node_ids_are_others():
    log = EventLog()
    each = [
        warning(0),
        warning(0, kind="bus_other"),
        warning(0, node="left"),
        warning(0, "node 5: 0x8130"),
        warning(0, "node 5: 0x8140"),
        warning(0, "node 6: 0x8140"),
    ]
    assert sum(len(log.add(event)) for event in each) == len(each)
    assert log.add(warning(1, "node 6: 0x8140")) == []
    assert len(log.add(warning(1, "EMCY 0xFF80, data 5e 07 00"))) == 1
    assert log.add(warning(1, "EMCY 0xFF80, data 12 ff 00")) == []


def test_deliberate_acts_and_good_news_are_reported_each_unless_they_flood():
    log = EventLog()
    for kind, level in (("stop", Level.WARNING), ("activated", Level.INFO)):
        acts = [Event(number, kind, "", "done", level) for number in range(1000)]
        assert sum(len(log.add(event)) for event in acts) == FEW
    assert [event.count for event in log.tick(FIRST_WINDOW_NS)] == [1000, 1000]


def test_what_counts_more_than_one_by_itself_is_summed():
    log = EventLog()
    reported = run(log, [warning(0, "cycle missed", count=3), warning(S, "cycle missed", count=4)], 10 * S)
    assert [event.sentence for _, event in reported] == ["cycle missed (3 times)", "cycle missed (7 times in 1.0 s)"]


def test_the_end_reports_what_is_counted_and_not_reported():
    log = EventLog()
    log.add(warning(0))
    log.add(warning(1))
    log.add(warning(1, "another"))
    assert [event.count for event in log.flush()] == [2]
    assert log.flush() == []
    assert len(log.take()) == 3


@pytest.mark.rest
def test_a_storm_of_different_ones_is_bounded():
    log = EventLog()
    for number in range(10_000):
        log.add(warning(number, node=f"n{number}"))
        log.add(warning(number, node=f"n{number}"))
    assert len(log._open) <= 256
    assert len(log.recent) == 256
    assert len(log.waiting) == 256
