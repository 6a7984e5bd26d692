from canopen_control.data_files import data_path
from canopen_control.master.event_log import Event, EventLog
from canopen_control.od.eds import read_eds
from canopen_control.runtime.api_objects import FEW, WINDOW_NS, WriteLog, written_words

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 3).od
MS = 1_000_000


def test_a_write_is_told_with_its_value_and_who_it_was():
    what = written_words(OD, 0x6083, 0, (4000).to_bytes(4, "little"))
    assert WriteLog().words(0, "left", "view", what).startswith("view wrote 4000 to 0x6083:00 ")
    what = written_words(OD, 0x1017, 0, (200).to_bytes(2, "little"))
    assert WriteLog().words(0, "left", "view", what).startswith("view wrote 0x00C8 to 0x1017:00 ")


def test_what_has_no_words_is_told_by_its_length():
    assert written_words(OD, 0x5FF0, 1, b"\1\2") == "2 bytes to 0x5FF0:01"
    assert written_words(OD, 0x6083, 0, b"\1\2").startswith("2 bytes to 0x6083:00")


def test_many_writes_of_one_client_are_summed_up():
    log, events = WriteLog(), EventLog()
    for number in range(300):
        text = log.words(number * MS, "left", "restore", f"1 to 0x{0x2000 + number:04X}:00 x")
        events.add(Event(number * MS, "object_written", "left", text))
    assert len(events.recent) == FEW + 1
    assert events.recent[-1].sentence.startswith("restore wrote more objects (295 times in")


def test_others_and_what_comes_later_are_told_one_by_one():
    log = WriteLog()
    for number in range(FEW + 1):
        log.words(number, "left", "restore", "x")
    assert log.words(FEW, "left", "view", "y") == "view wrote y"
    assert log.words(FEW, "right", "restore", "y") == "restore wrote y"
    assert log.words(FEW, "left", "restore", "y") == "restore wrote more objects"
    assert log.words(FEW + WINDOW_NS + 1, "left", "restore", "y") == "restore wrote y"


def test_what_is_remembered_is_bounded():
    log = WriteLog()
    for number in range(1000):
        log.words(number, "left", f"client {number}", "x")
    assert len(log._counts) <= 64
