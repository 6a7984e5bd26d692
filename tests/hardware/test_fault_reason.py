"""Why a drive is in a fault."""

from types import SimpleNamespace

from canopen_control.hardware.fault_reason import FaultReason


def make(*, has=True):
    asked, told = [], []
    node = SimpleNamespace(read=lambda index, subindex, done: asked.append(done))
    axis = SimpleNamespace(node=node, has=lambda _index: has, index=lambda index: index)
    return FaultReason(axis, told.append), asked, told


def test_the_code_is_read_once_and_told_in_words():
    reason, asked, told = make()
    reason.ask()
    reason.ask()
    assert len(asked) == 1
    assert reason.asking
    asked[0](SimpleNamespace(error=None, data=b"\x10\x43"))
    assert not reason.asking
    assert reason.code == 0x4310
    assert told == ["0x603F is 0x4310 (drive temperature too high)"]


def test_a_drive_without_one_is_not_asked_and_a_failed_answer_is_no_code():
    reason, asked, told = make(has=False)
    reason.ask()
    assert asked == []
    reason, asked, told = make()
    reason.ask()
    asked[0](SimpleNamespace(error="timeout", data=b""))
    assert reason.code is None
    assert reason.text == ""
    assert told == []
