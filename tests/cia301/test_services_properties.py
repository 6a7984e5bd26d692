"""Any frames, at any times, into any core: nothing is raised, memory is bounded, and the core still works after."""

from __future__ import annotations

import ast
from collections import deque
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples
from support.services import MS, frame, frames

from canopen_control import cia301
from canopen_control.cia301.emcy import EmcyConsumer, EmcyProducer
from canopen_control.cia301.guarding import GuardingEventKind, GuardingMaster, GuardingSlave
from canopen_control.cia301.heartbeat import HeartbeatConsumer, HeartbeatEventKind, HeartbeatProducer
from canopen_control.cia301.lss import LssIdentity, LssMaster, LssSlave
from canopen_control.cia301.nmt import NmtCommand, NmtMaster, NmtSlave, NmtState, nmt_frame
from canopen_control.cia301.pdo import PdoParameters, RpdoConsumer, TpdoProducer
from canopen_control.cia301.sync import SyncConsumer, SyncProducer
from canopen_control.frame import CanFrame

IDENTITY = LssIdentity(1, 2, 3, 4)


def nmt_slave() -> NmtSlave:
    slave = NmtSlave(3)
    slave.boot()
    return slave


def nmt_master() -> NmtMaster:
    master = NmtMaster(retry_ns=10 * MS)
    master.command(NmtCommand.START, 0, 0, confirm_by=range(1, 128))
    return master


def producer() -> HeartbeatProducer:
    core = HeartbeatProducer(3, MS)
    core.boot_up(0)
    return core


def consumer() -> HeartbeatConsumer:
    core = HeartbeatConsumer()
    for node_id in range(1, 128):
        core.watch(node_id, 5 * MS)
    return core


def guarding_master() -> GuardingMaster:
    core = GuardingMaster()
    for node_id in range(3, 11):
        core.watch(node_id, MS, 3, 0)
    return core


def guarding_slave() -> GuardingSlave:
    core = GuardingSlave(3, guard_time_ns=MS, life_time_factor=2)
    core.state = NmtState.OPERATIONAL
    return core


def sync_producer() -> SyncProducer:
    core = SyncProducer(overflow=4, period_ns=MS)
    core.start(0)
    return core


def emcy_producer() -> EmcyProducer:
    core = EmcyProducer(3, inhibit_ns=10 * MS)
    for code in range(0x1000, 0x1100):
        core.raise_error(code, 1, 0)
    return core


def tpdo() -> TpdoProducer:
    core = TpdoProducer(PdoParameters(0x183, event_timer_ms=1), lambda: b"\1")
    core.start(0)
    return core


def rpdo() -> RpdoConsumer:
    core = RpdoConsumer(PdoParameters(0x203, event_timer_ms=1), 3)
    core.start()
    return core


def lss_master() -> LssMaster:
    core = LssMaster()
    core.fast_scan()
    for _ in range(10):
        core.store()
    return core


CORES = [
    nmt_slave,
    nmt_master,
    producer,
    consumer,
    guarding_master,
    guarding_slave,
    sync_producer,
    lambda: SyncConsumer(overflow=4, period_ns=MS),
    emcy_producer,
    lambda: EmcyConsumer(3, active_limit=4),
    tpdo,
    rpdo,
    lambda: LssSlave(IDENTITY),
    lss_master,
]


def weight(thing: Any, seen: set[int]) -> int:
    """Count the items in every container that the core holds."""
    if id(thing) in seen or isinstance(thing, int | str | bytes | type | None):
        return 0
    seen.add(id(thing))
    if isinstance(thing, dict):
        return len(thing) + sum(weight(value, seen) for value in thing.values())
    if isinstance(thing, list | tuple | deque):
        return len(thing) + sum(weight(value, seen) for value in thing)
    if not type(thing).__module__.startswith("canopen_control"):
        return 0
    names = [name for cls in type(thing).__mro__ for name in getattr(cls, "__slots__", ())]
    held = [getattr(thing, name) for name in (*names, *getattr(thing, "__dict__", ()))]
    return sum(weight(value, seen) for value in held)


def play(core: Any, many: list[tuple[CanFrame, int]]) -> int:
    now = 0
    for one, gap in many:
        now += gap
        core.receive(one, now)
        core.tick(now)
    return now


@pytest.mark.parametrize("make", CORES)
@settings(max_examples=examples(40))
@given(many=st.lists(st.tuples(frames, st.integers(0, 20 * MS)), max_size=60))
def test_any_frames_at_any_time_raise_nothing_and_deadlines_are_served(make, many):
    core = make()
    now = play(core, many)
    for _ in range(300):
        deadline = core.next_deadline()
        if deadline is None:
            break
        now = max(now, deadline)
        core.tick(now)
        later = core.next_deadline()
        assert later is None or later > now
    assert all(len(sent.data) <= 8 for sent in core.frames())
    core.events()
    assert core.frames() == core.events() == []


def flood(core: Any) -> int:
    """Serve 30,000 frames of every service, node and length, never drain, and return the core's weight."""
    identifiers = [*range(0x80, 0x100), *range(0x700, 0x780), 0x000, 0x100, 0x203, 0x7E4, 0x7E5]
    identifiers += [0x4000_0183, 0x4000_0703]
    for number in range(30_000):
        data = (number * 0x9E3779B97F4A7C15 & (1 << 64) - 1).to_bytes(8, "little")[: number % 9]
        core.receive(CanFrame(identifiers[number % len(identifiers)], data), number * MS)
        core.tick(number * MS)
    return weight(core, set())


@pytest.mark.parametrize("make", CORES)
def test_memory_is_bounded_if_nothing_is_drained(make):
    assert flood(make()) < 12_000


@pytest.mark.rest
@pytest.mark.sources
def test_the_scaling_test_detects_a_core_that_grows():
    class Growing(SyncConsumer):
        """Keeps every frame, as no core may."""

        __module__ = SyncConsumer.__module__

        def receive(self, frame, now):
            self.__dict__.setdefault("kept", []).append(frame)

    assert flood(Growing()) > 12_000


frames_and_gaps = st.lists(st.tuples(frames, st.integers(0, 5 * MS)), max_size=60)


@given(frames_and_gaps)
def test_an_nmt_slave_still_obeys(many):
    slave = nmt_slave()
    now = play(slave, many)
    slave.receive(nmt_frame(NmtCommand.RESET_NODE, 3), now)
    slave.boot()
    slave.receive(nmt_frame(NmtCommand.START), now)
    assert slave.state is NmtState.OPERATIONAL


@given(frames_and_gaps)
def test_a_heartbeat_consumer_still_detects_when_a_node_appears_or_disappears(many):
    core = consumer()
    now = play(core, many)
    core.receive(frame("70A#00"), now)
    core.events()
    core.receive(frame("70A#05"), now)
    core.tick(now + 5 * MS)
    kinds = [event.kind for event in core.events() if event.node_id == 10]
    assert kinds == [HeartbeatEventKind.STARTED, HeartbeatEventKind.MISSED]


@given(frames_and_gaps)
def test_a_guarding_master_still_detects_when_a_node_appears_or_disappears(many):
    core = guarding_master()
    now = play(core, many)
    core.receive(frame("70A#00"), now)
    core.receive(frame("70A#05"), now)
    core.tick(now + 3 * MS)
    assert core.events()[-1].kind is GuardingEventKind.MISSED or core.state_of(10) is NmtState.OPERATIONAL


@given(frames_and_gaps)
def test_an_lss_slave_is_still_found(many):
    slave = LssSlave(IDENTITY)
    now = play(slave, many)
    slave.pending_node_id = 255  # the frames may have configured it
    for text in (
        "0400",
        "51000000008000",
        "5101000000000001",
        "5102000000000102",
        "5103000000000203",
        "5104000000000300",
    ):
        slave.receive(frame(f"7E5#{text:0<16}"), now)
    assert len(slave.frames()) >= 5
    assert slave.mode == 1


@given(frames_and_gaps)
def test_pdos_still_work(many):
    sending, receiving = tpdo(), rpdo()
    now = max(play(sending, many), play(receiving, many))
    sending.frames(), receiving.events()
    sending.changed(now)
    assert sending.frames() == [CanFrame(0x183, b"\1")]
    receiving.receive(frame("203#0F0003"), now)
    assert receiving.events()[-1].data == bytes.fromhex("0F0003")


@given(frames_and_gaps)
def test_an_emcy_consumer_still_receives(many):
    core = EmcyConsumer(3)
    now = play(core, many)
    core.receive(frame("083#0000000000000000"), now)
    core.receive(frame("083#118621"), now)
    assert core.active == (0x8611,)


@given(st.lists(st.integers(0, 3 * MS), max_size=40))
def test_event_driven_pdos_keep_their_distance_whatever_changes_when(gaps):
    sent: list[int] = []
    core = TpdoProducer(PdoParameters(0x183, inhibit_time_100us=15, event_timer_ms=4), lambda: b"")
    now = 0
    core.start(now)
    sent += [now] * len(core.frames())
    for gap in gaps:
        target = now + gap
        while (deadline := core.next_deadline()) is not None and deadline <= target:
            now = max(now, deadline)
            core.tick(now)
            sent += [now] * len(core.frames())
        now = target
        core.changed(now)
        sent += [now] * len(core.frames())
    assert all(1_500_000 <= later - earlier <= 4 * MS for earlier, later in pairwise(sent))


def test_the_cores_are_pure():
    forbidden = {
        "socket",
        "threading",
        "time",
        "logging",
        "random",
        "os",
        "asyncio",
        "subprocess",
        "select",
        "can",
        "canopen",
    }
    for path in Path(cia301.__file__).parent.glob("*.py"):
        imported = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {name.name.split(".")[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom):
                imported.add((node.module or "").split(".")[0])
        assert not imported & forbidden, path.name
