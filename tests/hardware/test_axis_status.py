"""A statusword is as good as it is young."""

from types import SimpleNamespace

import pytest

from canopen_control.cia402.drive import Goal
from canopen_control.errors import SdoAbort, SdoTimeout
from canopen_control.hardware.axis import (
    BLIND_STOP_NS,
    GRACE_NS,
    POLL_NS,
    AxisStatus,
    ModeBySdo,
    StatuswordBySdo,
)

pytestmark = pytest.mark.sources  # stand-ins for an axis or a joint

MS = 1_000_000


class Node:
    """Takes SDO requests and lets the test answer them."""

    ready = True

    def __init__(self):
        self.reads, self.writes = [], []

    def read(self, index, subindex, done):
        self.reads.append((index, subindex, done))

    def write(self, index, subindex, data, done=None):
        self.writes.append((index, data))

    def answer(self, data, error=None):
        self.reads.pop(0)[2](SimpleNamespace(error=error, data=data))


def make_axis(*, mode=True, display=True):
    pdo = SimpleNamespace(stamp=0, overdue=False, values=(0x27, 9))

    def entry(position):
        return SimpleNamespace(pdo=pdo, position=position, value=pdo.values[position])

    return SimpleNamespace(
        node=Node(),
        index=lambda index: index,
        statusword=entry(0),
        display=entry(1) if display else None,
        mode=object() if mode else None,
        pdo=pdo,
    )


def test_while_the_tpdo_comes_it_is_the_tpdos():
    axis = make_axis()
    status = AxisStatus(axis, SimpleNamespace(mode=9))
    status.update(0)
    assert (status.word, status.display) == (0x27, 9)
    assert axis.node.reads == []


def test_a_wanted_mode_that_no_pdo_carries_goes_by_sdo():
    axis = make_axis(mode=False)
    status = AxisStatus(axis, SimpleNamespace(mode=8))
    status.update(0)
    assert axis.node.writes == [(0x6060, b"\x08")]
    assert status.display == 9, "the one that the TPDO shows"


def test_before_the_first_frame_and_without_the_node_nothing_is_known():
    axis = make_axis()
    status = AxisStatus(axis, SimpleNamespace(mode=9, goal=Goal.ENABLED))
    axis.pdo.stamp = -1
    status.update(0)
    assert (status.word, status.display) == (None, None)
    assert axis.node.reads == []
    assert status.blind_word(0) == 0
    axis.pdo.stamp, axis.node.ready = 5, False
    status.update(0)
    assert status.word is None


@pytest.mark.parametrize(
    ("goal", "overdue"), [(Goal.DISABLED, False), (Goal.QUICK_STOPPED, False), (Goal.ENABLED, True)]
)
def test_one_that_never_came_is_asked_for_by_sdo_where_an_end_waits_for_it(goal, overdue):
    axis = make_axis()
    axis.pdo.stamp, axis.pdo.overdue = -1, overdue
    status = AxisStatus(axis, SimpleNamespace(mode=9, goal=goal))
    status.update(0)
    assert status.word is None
    axis.node.answer(b"\x50\x02")
    status.update(MS)
    assert status.word == 0x0250


def test_one_that_the_node_refuses_to_tell_is_invisible_until_its_tpdo_comes():
    axis = make_axis()
    axis.pdo.stamp = -1
    status = AxisStatus(axis, SimpleNamespace(mode=9, goal=Goal.DISABLED))
    status.update(0)
    axis.node.answer(b"", error=SdoTimeout(5, 0x6041, 0, 0.5))
    status.update(POLL_NS)
    assert not status.invisible
    axis.node.answer(b"", error=SdoAbort(5, 0x6041, 0, 0x060A0023, ""))
    status.update(2 * POLL_NS)
    assert status.invisible
    axis.pdo.stamp = 1
    status.update(3 * POLL_NS)
    assert not status.invisible


def test_when_it_stays_away_the_last_one_holds_for_a_while_then_the_sdos_then_none():
    axis = make_axis()
    source = StatuswordBySdo(axis)
    assert source.word(0x27, 0) == 0x27
    assert [read[0] for read in axis.node.reads] == [0x6041]
    axis.node.answer(b"\x33\x02")
    assert source.word(0x27, 10 * MS) == 0x0233
    assert source.word(0x27, POLL_NS) == 0x0233
    assert len(axis.node.reads) == 1, "asked again"
    axis.node.answer(b"", error="timeout")
    assert source.word(0x27, GRACE_NS + 2 * MS) is None
    source.end()
    assert source.word(0x27, GRACE_NS + 3 * MS) == 0x27


def test_a_drive_that_nobody_sees_is_told_to_quick_stop_and_then_to_take_its_power_away():
    axis = make_axis()
    status = AxisStatus(axis, SimpleNamespace(mode=9))
    axis.pdo.overdue = True
    assert status.blind_word(0) == 0x02
    assert status.blind_word(BLIND_STOP_NS - 1) == 0x02
    assert status.blind_word(BLIND_STOP_NS) == 0
    status.came()
    status.went(5 * BLIND_STOP_NS)
    assert status.blind_word(5 * BLIND_STOP_NS) == 0x02


def test_the_power_of_a_load_that_would_fall_is_not_taken_by_a_master_that_sees_nothing():
    axis = make_axis()
    status = AxisStatus(axis, SimpleNamespace(mode=9), holds_load=True)
    axis.pdo.overdue = True
    assert status.blind_word(0) == status.blind_word(100 * BLIND_STOP_NS) == 0x02


def test_a_mode_without_pdos_is_written_once_and_asked_for_until_it_shows():
    axis = make_axis(mode=False, display=False)
    mode = ModeBySdo(axis)
    mode.step(None, 0)
    assert axis.node.writes == axis.node.reads == []
    mode.step(-1, 0)
    mode.step(-1, MS)
    assert axis.node.writes == [(0x6060, b"\xff")]
    axis.node.answer(b"\x00")
    mode.step(-1, 2 * MS)
    assert axis.node.reads == [], "not at once again"
    mode.step(-1, POLL_NS)
    axis.node.answer(b"\xff")
    assert mode.display == -1
    mode.step(-1, 9 * POLL_NS)
    assert axis.node.reads == []
    mode.forget()
    assert mode.display is None
