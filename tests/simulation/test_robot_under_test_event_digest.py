import pytest

from canopen_control.frame import CanFrame, pack_records
from canopen_control.master.event_log import Event
from canopen_control.simulation.robot_under_test import EventDigest

RECORD = pack_records([CanFrame(0x181, b"\x01")])


def digest(*, at=5, label="a", record=RECORD, text="it runs", event_at=6):
    event_digest = EventDigest()
    event_digest.frame(at, label, record)
    event_digest.event(Event(event_at, "running", "left", text))
    return event_digest.hex


def test_the_same_frames_and_events_have_the_same_digest():
    assert digest() == digest()
    assert len(digest()) == 64


@pytest.mark.parametrize(
    "other",
    [{"at": 4}, {"label": "b"}, {"record": pack_records([CanFrame(0x181, b"\x02")])}, {"text": "no"}, {"event_at": 7}],
)
def test_whatever_differs_shows(other):
    assert digest(**other) != digest()


def test_where_the_files_are_is_not_a_part_of_it():
    def noted(folder):
        event_digest = EventDigest([folder])
        event_digest.event(Event(6, "note", "", f"{folder}/bus.yml: package: has no meaning here"))
        return event_digest.hex

    assert noted("/a/robby") == noted("/b/c/robby")
    assert noted("/a/robby") != EventDigest(["/a/robby"]).hex


def test_many_frames_are_all_counted():
    created, less = EventDigest(), EventDigest()
    for at in range(10_000):
        created.frame(at, "a", RECORD)
        if at:
            less.frame(at, "a", RECORD)
    assert created.hex != less.hex
    assert created.events == 0
