"""Routing, supervision, and the (absent) effect of floods and invalid frames."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples
from support.robots import LEFT, RIGHT, Bench, copy_robby

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia301.pdo import MappedObject
from canopen_control.data_files import data_path
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, CanFrame, frames_of, pack_records
from canopen_control.master.config import read_bus
from canopen_control.master.network import Network
from canopen_control.master.plan_builder import PlannedPdo
from canopen_control.od.model import DataType

MS = 1_000_000
ROBBY = read_bus(data_path("config", "robby") / "bus.yml")


def network():
    events = []
    return Network("can", ROBBY, events.append, 20 * MS), events


@pytest.fixture
def net():
    """Return a network that has just started."""
    net, _ = network()
    net.start(0)
    return net


def sent(net):
    return [str(frame) for frame in frames_of(net.take())]


def feed(net, now, *frames):
    net.receive(pack_records([CanFrame(int(f[:3], 16), bytes.fromhex(f[4:])) for f in frames]), now)


def test_the_master_reports_that_it_is_there_and_resets_every_node(net):
    assert sent(net) == ["701#00", "000#8203", "000#8202"]


def test_heartbeats_are_sent_every_100_ms(net):
    net.take()
    beats = []
    for ms in range(0, 1000, 20):
        net.tick(ms * MS)
        beats += [(ms, frame) for frame in sent(net) if frame.startswith("701")]
    assert [ms for ms, _ in beats] == list(range(100, 1000, 100))
    assert {frame for _, frame in beats} == {"701#05"}


def test_the_boot_up_of_a_node_starts_its_identification(net):
    net.take()
    feed(net, 5 * MS, "703#00")
    assert sent(net) == ["603#4000100000000000"]


def test_each_node_boots_on_its_own(net):
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
    feed(net, 0, "583#4B41600040020000")  # the statusword of a drive without power
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


def test_an_emcy_is_reported_with_its_text_and_kept_as_the_nodes_error():
    net, events = network()
    net.start(0)
    feed(net, 7, "083#1043090201000000")
    assert events[-1].kind == "emcy"
    assert "0x4310" in events[-1].text
    assert "0x4310" in net.nodes["left_drive"].error


@pytest.mark.parametrize("length", range(9))
def test_an_emcy_of_three_bytes_counts_and_one_of_fewer_is_dropped_counted_and_reported(length):
    net, events = network()
    net.start(0)
    node = net.nodes["left_drive"]
    reported = len(events)
    feed(net, 1, "083#" + "1043090201000000"[: 2 * length])
    assert [event.kind for event in events[reported:]] == ["emcy" if length >= 3 else "emcy_short"]
    assert node.log.errors.active == (0x4310,) * (length >= 3)
    assert node.log.errors.malformed == (length < 3)


def test_rpdos_are_not_sent_before_the_node_is_operational(net):
    net.image.output(3, 0x6040).set(6)
    assert [frame.can_id for frame in frames_of(net.cycle(sync=True))] == [0x80]
    assert net.cycle(sync=False) == b""


def test_an_external_sync_is_received_and_not_sent_and_missing_answers_are_counted(net):
    frames_received = []
    net.hear_sync(frames_received.append)
    assert 0x80 in net.identifiers
    feed(net, 7, "080#")
    feed(net, 9, "080#05")
    assert frames_received == [7 * MS, 9 * MS] or frames_received == [7, 9]
    assert net.unknown == 0
    received = net.nodes["left_drive"].received[1]
    received.expected = True
    before = received.silent
    for _ in range(2):
        assert net.cycle(sync=True) == b""
        net.synced(9 * MS)
    assert received.silent > before


@pytest.mark.parametrize(("between", "reported"), [(20, 0), (19, 0), (10, 1)])
def test_a_sync_alongside_the_kernels_is_another_masters(between, reported):
    net, events = network()
    net.start(0)
    net.hear_sync(lambda _now: None)
    for ms in range(0, 4000, between):
        feed(net, ms * MS, "080#")
        net.tick(ms * MS)
    texts = [event.text for event in events if event.kind == "other_master"]
    assert len(texts) == reported
    assert all("SYNC 0x080 in addition to the kernel's" in text for text in texts)


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


@settings(max_examples=examples(60))
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
        net.synced(now)
    feed(net, now, "703#00")
    net.tick(now + 3000 * MS)
    assert net.next_deadline() is not None
    assert all(len(node.boot_steps) < 10 for node in net.nodes.values())


def test_a_read_that_equals_the_last_one_stamps_and_counts_its_tpdos():
    net, _ = network()
    pdos = list(net.image.inputs.values())
    frames = [CanFrame(pdo.cob_id, bytes([1] * pdo.length)) for pdo in pdos]
    for now in range(1, 5):
        net.receive(pack_records(frames), now)
        assert [(pdo.stamp, pdo.count) for pdo in pdos] == [(now, now)] * len(pdos)
    values = pdos[0].values
    net.receive(pack_records([CanFrame(pdos[0].cob_id, bytes([2] * pdos[0].length)), *frames[1:]]), 5)
    assert pdos[0].values != values
    net.receive(pack_records(frames), 6)
    assert pdos[0].values == values


def test_a_read_that_equals_the_last_one_passes_every_other_frame_on():
    net, _ = network()
    pdo = next(iter(net.image.inputs.values()))
    frames = pack_records([CanFrame(pdo.cob_id, bytes(pdo.length)), CanFrame(0x7F0, b"")])
    for now in range(1, 5):
        net.receive(frames, now)
    assert net.unknown == pdo.count == 4


def test_frames_without_a_receiver_are_counted():
    net, _ = network()
    feed(net, 0, "7FF#00", "123#0102")
    assert net.unknown == 2


@pytest.mark.parametrize("length", [0, 2, 8])
def test_a_heartbeat_of_the_wrong_length_is_not_a_heartbeat(net, length):
    feed(net, 5, f"703#{'05' * length}")
    assert net.nodes["left_drive"].nmt_state is None


@pytest.mark.parametrize(("data_type", "signed"), [(DataType.UNSIGNED64, False), (DataType.INTEGER64, True)])
def test_a_tpdo_with_one_object_of_64_bits_is_decoded_from_its_first_byte_on(net, data_type, signed):
    node = net.nodes["left_drive"]
    [pdo, *_] = node.received
    objects = [MappedObject(0x2000, 0, 64, data_type)]
    pdo.use(PlannedPdo(1, pdo.cob_id, 1, tuple(objects)), objects)
    for value in (0x0123456789ABCDEF, 1, 1 << 56, -2 if signed else (1 << 64) - 1):
        feed(net, 5, f"{pdo.cob_id:03X}#{value.to_bytes(8, 'little', signed=signed).hex()}")
        assert pdo.values == (value,)


OTHER_ORDER = """
    1: {enabled: false}
    2: {transmission: 1, mapping: [{index: 0x6061}, {index: 0x6041}]}
    3: {transmission: 1, mapping: [{index: 0x6064}, {index: 0x6041}]}
    4: {enabled: false}
  rpdo:
    1: {enabled: false}
    2: {mapping: [{index: 0x6060}, {index: 0x6040}]}
    3: {enabled: false}
    4: {mapping: [{index: 0x60FF}, {index: 0x6040}]}
"""


def test_a_node_that_keeps_a_mapping_of_its_own_order_is_driven_in_that_order(tmp_path):
    config = copy_robby(tmp_path)
    path = config / "bus.yml"
    head, tpdo, tail = path.read_text().partition("  tpdo:\n")
    path.write_text(f"{head}{tpdo}{OTHER_ORDER}nodes:{tail.partition('nodes:')[2]}")
    robby = Bench("adopt", config=config, drives=())
    try:
        robby.power_on(LEFT, ["mapping_fixed"])
        robby.power_on(RIGHT)
        robby.start()
        robby.hold(10.0, 10.0, ms=600)
        assert robby.speed(LEFT) == -robby.speed(RIGHT) != 0
        assert robby.joint(LEFT).states["position"].value == pytest.approx(
            robby.joint(RIGHT).states["position"].value, abs=0.3
        )
        assert robby.joint(LEFT).states["position"].value > 2.0
        warned = robby.texts("boot_warning")
        assert len(warned) == 4
        assert all("node 3 (left_drive)" in text and "is used with the node's own mapping" in text for text in warned)
        left, right = (robby.robot.nodes[name] for name in ("left_drive", "right_drive"))
        assert [mapped.index for mapped in left.sent[0].codec.objects] == [0x6040, 0x6060]
        assert [mapped.index for mapped in right.sent[0].codec.objects] == [0x6060, 0x6040]
    finally:
        robby.close()


def test_a_guarded_node_is_guarded_before_it_is_started(tmp_path):
    text = data_path("config", "robby").joinpath("bus.yml").read_text()
    assert "heartbeat_producer: 100         # ms\n" in text
    path = tmp_path / "bus.yml"
    path.write_text(text.replace("heartbeat_producer: 100         # ms\n", "guard_time: 100\n  life_time_factor: 3\n"))
    config, events = read_bus(path), []
    net = Network("can", config, events.append, 20 * MS)
    net.start(0)
    answers = Answers(net, 3)
    for ms in range(0, 3000, 20):
        answers.serve(ms * MS)
    requested = [frame for frame in answers.log if frame.can_id == 0x703 | REMOTE_FLAG]
    started = next(number for number, frame in enumerate(answers.log) if frame.data == b"\x01\x03")
    assert requested
    assert answers.log.index(requested[0]) < started
    assert net.nodes["left_drive"].ready
    answers.deaf = True
    for ms in range(3000, 4000, 20):
        answers.serve(ms * MS)
    assert [event.kind for event in events if event.node == "left_drive"][-1] == "guarding_lost"
    assert "no answer to node guarding for 0.3 s" in net.nodes["left_drive"].error


def test_a_guarded_node_that_is_taken_out_shows_its_state_and_is_asked_on():
    events = []
    net = Network(
        "can", copy_guarded(data_path("config", "robby").joinpath("bus.yml").read_text()), events.append, 20 * MS
    )
    net.start(0)
    answers, node = Answers(net, 3), net.nodes["left_drive"]
    for ms in range(0, 1000, 20):
        answers.serve(ms * MS)
    node.command(NmtCommand.ENTER_PRE_OPERATIONAL, 1000 * MS)
    before = len(answers.log)
    for ms in range(1000, 2000, 20):
        answers.serve(ms * MS)
    requested = [frame for frame in answers.log[before:] if frame.can_id == 0x703 | REMOTE_FLAG]
    assert len(requested) == pytest.approx(10, abs=1)  # else the node takes its master for lost: EMCY 0x8130
    assert node.nmt_state is NmtState.PRE_OPERATIONAL
    answers.deaf = True
    for ms in range(2000, 4000, 20):
        answers.serve(ms * MS)
    kinds = [event.kind for event in events if event.node == "left_drive"]
    assert kinds[-1] == "guarding_lost"
    assert "it was taken out" in events[-1].text
    assert node.is_taken_out
    assert not any(frame.data == b"\x82\x03" for frame in answers.log[before:])  # it is not booted
    answers.deaf = False
    node.command(NmtCommand.START, 4000 * MS)
    for ms in range(4000, 5000, 20):
        answers.serve(ms * MS)
    assert node.ready


def test_a_tpdo_that_comes_with_its_default_identifier_is_named_with_it():
    text = data_path("config", "robby").joinpath("bus.yml").read_text()
    with_ids = text.replace("    node_id: 3\n", "    node_id: 3\n    tpdo:\n      1: {enabled: true, cob_id: 0x2C3}\n")
    events = []
    net = Network("can", read_text(with_ids), events.append, 20 * MS)
    node = net.nodes["left_drive"]
    pdo = node.received[0]
    assert pdo.cob_id == 0x2C3
    pdo.expected = True
    feed(net, 0, "183#0000")
    pdo.overdue, pdo.silent = True, 10
    node.on_pdo(pdo, 200 * MS)
    assert events[-1].kind == "pdo_missing"
    assert "frames with its default 0x183 are received instead" in events[-1].text
    assert "`cob_id: auto`" in events[-1].text
    pdo.stamp = 0
    node.on_pdo(pdo, 400 * MS)
    assert events[-1].kind == "pdo_stale"
    assert "its default 0x183" in events[-1].text
    assert 0x182 in net.identifiers, "the right drive has its default"


def read_text(text):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bus.yml"
        path.write_text(text)
        return read_bus(path)


def copy_guarded(text):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bus.yml"
        path.write_text(
            text.replace("heartbeat_producer: 100         # ms\n", "guard_time: 100\n  life_time_factor: 3\n")
        )
        return read_bus(path)


class Answers:
    """A node that takes every object, and answers guarding."""

    def __init__(self, net, node_id):
        self.net, self.node_id, self.log, self.held = net, node_id, [], {}
        self.toggle, self.state, self.deaf = 0, 0x7F, False

    def serve(self, now):
        """Answer all that the master sends, until it sends nothing more."""
        self.net.tick(now)
        while frames := list(frames_of(self.net.take())):
            for frame in frames:
                self.log.append(frame)
                for answer in self.answer(frame) if not self.deaf else ():
                    self.net.receive(pack_records([answer]), now)

    def answer(self, frame):
        if frame.can_id == 0x700 + self.node_id | REMOTE_FLAG:
            byte = self.state | self.toggle
            self.toggle ^= 0x80
            return [CanFrame(0x700 + self.node_id, bytes((byte,)))]
        if frame.can_id == 0 and frame.data[1] == self.node_id:
            self.state = 0x05 if frame.data[0] == 1 else 0x7F
            self.toggle = 0
            return [CanFrame(0x700 + self.node_id, b"\0")] if frame.data[0] == 0x82 else []
        if frame.can_id == 0x600 + self.node_id:
            return [CanFrame(0x580 + self.node_id, self.sdo(frame.data))]
        return []

    def sdo(self, data):
        mux, kind = data[1:4], data[0]
        if kind & 0xE0 == 0x20:
            self.held[mux] = data[4 : 8 - (kind >> 2 & 3)]
            return b"\x60" + mux + bytes(4)
        value = self.held.get(mux) or _IDENTITY.get(mux, bytes(4))
        return bytes((0x43 | 4 - len(value) << 2,)) + mux + value.ljust(4, b"\0")


_IDENTITY = {
    b"\x00\x10\0": (0xFFFF0192).to_bytes(4, "little"),
    b"\x18\x10\x01": (0x286).to_bytes(4, "little"),
    b"\x18\x10\x02": (0x4F6).to_bytes(4, "little"),
    b"\x18\x10\x03": (0x3001A).to_bytes(4, "little"),
}


def test_a_heartbeat_period_that_is_written_by_sdo_is_expected_from_then_on():
    path = data_path("config", "robby") / "bus.yml"
    config, events = read_bus(path), []
    net = Network("can", config, events.append, 20 * MS)
    net.start(0)
    answers = Answers(net, 3)
    beat = pack_records([CanFrame(0x703, b"\x05")])
    now = 0
    while not net.nodes["left_drive"].ready and now < 5000 * MS:
        now += 20 * MS
        answers.serve(now)
        if answers.state == 0x05 or now % (100 * MS) == 0:
            net.receive(pack_records([CanFrame(0x703, bytes((answers.state,)))]), now)
    node = net.nodes["left_drive"]
    assert node.ready, node.error
    node.write(0x1017, 0, (40).to_bytes(2, "little"))
    net.changed()
    answers.serve(now)
    for _ in range(100):
        now += 40 * MS
        answers.serve(now)
        net.receive(beat, now, now)
    texts = [event.text for event in events if event.node == "left_drive"]
    assert any("0x1017 was set to 40 ms by SDO" in text for text in texts)
    assert not any("two devices" in text or "heartbeats" in text for text in texts), texts
    for _ in range(20):
        now += 20 * MS
        answers.serve(now)
    assert not node.ready  # lost after five of the new period
