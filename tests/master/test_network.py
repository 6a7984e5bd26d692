"""Frames in, frames out: routing, supervision, and what a flood or garbage may do (nothing)."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canopen_control.data_files import data_path
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, CanFrame, frames_of, pack_records
from canopen_control.master.config import read_bus
from canopen_control.master.network import Network

MS = 1_000_000
ROBBY = read_bus(data_path("config", "robby") / "bus.yml")


def network():
    events = []
    return Network("can", ROBBY, events.append, 20 * MS), events


def sent(net):
    return [str(frame) for frame in frames_of(net.take())]


def feed(net, now, *frames):
    net.receive(pack_records([CanFrame(int(f[:3], 16), bytes.fromhex(f[4:])) for f in frames]), now)


def test_the_master_says_that_it_is_there_and_resets_every_node():
    net, _ = network()
    net.start(0)
    assert sent(net) == ["701#00", "000#8203", "000#8202"]


def test_heartbeats_are_sent_every_100_ms():
    net, _ = network()
    net.start(0)
    net.take()
    beats = []
    for ms in range(0, 1000, 20):
        net.tick(ms * MS)
        beats += [(ms, frame) for frame in sent(net) if frame.startswith("701")]
    assert [ms for ms, _ in beats] == list(range(100, 1000, 100))
    assert {frame for _, frame in beats} == {"701#05"}


def test_the_boot_up_of_a_node_starts_its_identification():
    net, _ = network()
    net.start(0)
    net.take()
    feed(net, 5 * MS, "703#00")
    assert sent(net) == ["603#4000100000000000"]


def test_each_node_boots_on_its_own():
    net, _ = network()
    net.start(0)
    net.take()
    feed(net, 5 * MS, "703#00", "702#00")
    assert sent(net) == ["603#4000100000000000", "602#4000100000000000"]
    feed(net, 6 * MS, "582#430010009201FFFF")
    assert sent(net) == ["602#4018100100000000"]


def test_the_wrong_vendor_fails_that_node_and_is_tried_again_after_a_second():
    net, events = network()
    net.start(0)
    net.take()
    feed(net, 0, "703#00", "583#430010009201FFFF")
    feed(net, 0, "583#4318100199000000")
    for subindex in (2, 3, 4):
        feed(net, 0, f"583#431810{subindex:02X}00000000")
    failed = [event for event in events if event.kind == "boot_failed"]
    assert [event.node for event in failed] == ["left_drive"]
    assert "boot error D" in failed[0].text
    net.take()
    net.tick(1100 * MS)
    assert "000#8203" in sent(net)


def test_a_node_that_stays_away_is_named_once_not_every_second():
    net, events = network()
    net.start(0)
    for ms in range(0, 20_000, 20):
        net.tick(ms * MS)
        net.take()
    assert sorted(event.node for event in events if event.kind == "boot_failed") == ["left_drive", "right_drive"]


def test_an_emcy_is_told_with_its_text_and_kept_as_the_nodes_error():
    net, events = network()
    net.start(0)
    feed(net, 7, "083#1043090201000000")
    assert events[-1].kind == "emcy"
    assert "0x4310" in events[-1].text
    assert "0x4310" in net.nodes["left_drive"].error


def test_rpdos_are_not_sent_before_the_node_is_operational():
    net, _ = network()
    net.start(0)
    net.image.output(3, 0x6040).set(6)
    assert [frame.can_id for frame in frames_of(net.cycle(sync=True))] == [0x80]
    assert net.cycle(sync=False) == b""


frames = st.builds(
    CanFrame,
    st.one_of(
        st.integers(0, 0x7FF),
        st.sampled_from([0x583, 0x703, 0x083, 0x183, 0x283, 0x080, 0x000]),
        st.integers(0, 0x1FFFFFFF).map(lambda value: value | EXTENDED_FLAG),
        st.integers(0, 0x7FF).map(lambda value: value | REMOTE_FLAG),
        st.integers(0, 0x1FF).map(lambda value: value | ERROR_FLAG),
    ),
    st.binary(max_size=8),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(frames, st.integers(0, 400)), max_size=60))
def test_any_frames_whatever_raise_nothing_and_leave_the_master_usable(stream):
    net, _ = network()
    net.start(0)
    now = 0
    for frame, wait in stream:
        now += wait * MS
        net.receive(pack_records([frame]), now)
        net.tick(now)
        net.take()
        net.cycle(sync=True)
    feed(net, now, "703#00")
    net.tick(now + 3000 * MS)
    assert net.next_deadline() is not None
    assert all(len(node.boot_steps) < 10 for node in net.nodes.values())


def test_frames_of_nobody_are_counted():
    net, _ = network()
    feed(net, 0, "7FF#00", "123#0102")
    assert net.unknown == 2


@pytest.mark.parametrize("length", [0, 2, 8])
def test_a_heartbeat_of_the_wrong_length_is_no_heartbeat(length):
    net, _ = network()
    net.start(0)
    feed(net, 5, f"703#{'05' * length}")
    assert net.nodes["left_drive"].nmt_state is None
