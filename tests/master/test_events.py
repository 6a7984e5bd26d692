from canopen_control.master.events import Event, EventLog


def test_each_event_is_taken_once():
    log = EventLog()
    log.add(Event(1, "ready", "left", "is ready"))
    assert [event.kind for event in log.take()] == ["ready"]
    assert log.take() == []
    assert len(log.recent) == 1


def test_a_flood_keeps_the_newest_and_counts_the_rest():
    log = EventLog(capacity=4)
    for number in range(10):
        log.add(Event(number, "emcy", "left", "x"))
    assert [event.time for event in log.take()] == [6, 7, 8, 9]
    assert log.dropped == 6
    assert [event.time for event in log.recent] == [6, 7, 8, 9]
