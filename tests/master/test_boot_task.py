"""The runner of a boot: nothing waits, everything times out, the time of each step is known."""

from dataclasses import replace

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.frame import CanFrame
from canopen_control.master.boot import BootTask
from canopen_control.master.plan import Identity, NodePlan
from canopen_control.master.plan_builder import PlannedWrite

MS = 1_000_000
PLAN = NodePlan(
    name="io",
    node_id=3,
    source="io.eds",
    identity=Identity(),
    writes=(PlannedWrite(0x1017, 0, b"\x64\x00", "producer"),),
    rpdos=(),
    tpdos=(),
    axes=(),
    heartbeat_timeout_ns=300 * MS,
)


class Harness:
    def __init__(self, *, reset=True):
        self.sdo, self.commands, self.held = SdoClient(3, timeout_ns=100 * MS), [], {}
        self.task = BootTask(PLAN, self.sdo, self.commands.append, reset=reset, now=0)

    def serve(self, now):
        """Answer what the client asks, as a node that takes everything and holds it."""
        while frames := self.sdo.frames():
            for frame in frames:
                mux, kind = frame.data[1:4], frame.data[0]
                if kind & 0xE0 == 0x20:
                    self.held[mux] = frame.data[4 : 8 - (kind >> 2 & 3)]
                    answer = bytes((0x60,)) + mux + bytes(4)
                else:
                    data = self.held.get(mux, bytes(4))
                    answer = bytes((0x43 | 4 - len(data) << 2,)) + mux + data.ljust(4, b"\0")
                self.sdo.receive(CanFrame(0x583, answer), now)
            self.pump(now)

    def pump(self, now):
        for request in self.sdo.events():
            self.task.transfer_ended(request, now)


def test_a_good_boot_goes_through_its_steps_and_knows_their_times():
    harness = Harness()
    task = harness.task
    assert task.awaits_boot_up
    assert harness.commands == [NmtCommand.RESET_COMMUNICATION]
    task.boot_up(20 * MS)
    harness.serve(25 * MS)
    assert task.step == "heartbeat"
    task.heartbeat(NmtState.PRE_OPERATIONAL, 60 * MS)
    assert harness.commands[-1] is NmtCommand.START
    task.heartbeat(NmtState.PRE_OPERATIONAL, 70 * MS)
    assert not task.done
    task.heartbeat(NmtState.OPERATIONAL, 80 * MS)
    assert task.result is not None
    assert [(step.name, round(step.seconds * 1000)) for step in task.steps] == [
        ("reset", 20),
        ("identify", 5),
        ("configure", 0),
        ("heartbeat", 35),
        ("start", 20),
    ]


def test_a_boot_up_that_never_comes_is_waited_for_a_second():
    harness = Harness()
    assert harness.task.next_deadline() == 1000 * MS
    harness.task.tick(999 * MS)
    assert harness.task.step == "reset"
    harness.task.tick(1000 * MS)
    assert harness.task.step == "identify"


def test_a_server_that_is_silent_ends_the_boot_with_its_step():
    harness = Harness(reset=False)
    harness.sdo.frames()
    for ms in range(0, 5000, 50):
        harness.sdo.tick(ms * MS)
        harness.sdo.frames()
        harness.pump(ms * MS)
    assert harness.task.error is not None
    assert harness.task.steps[-1].name == "identify"
    assert "boot error B" in harness.task.steps[-1].error


def test_a_cancelled_boot_hears_nothing_any_more():
    harness = Harness(reset=False)
    harness.task.cancel()
    harness.serve(10 * MS)
    harness.task.heartbeat(NmtState.OPERATIONAL, 20 * MS)
    harness.task.tick(10_000 * MS)
    assert harness.task.result is None
    assert harness.task.error is None


def test_a_tpdo_confirms_operational_as_a_heartbeat_does():
    harness = Harness(reset=False)
    task, received = harness.task, [0]
    task._count_tpdos = lambda: received[0]
    harness.serve(5 * MS)
    received[0] = 7  # of an earlier run
    task.heartbeat(NmtState.PRE_OPERATIONAL, 60 * MS)
    assert task.step == "start"
    assert task.next_deadline() == 0, "every tick looks for a TPDO"
    task.tick(80 * MS)
    assert not task.done
    received[0] += 1
    task.tick(100 * MS)
    assert task.result is not None


def test_start_is_repeated_when_nothing_shows_it_and_then_given_up():
    harness = Harness(reset=False)
    task = harness.task
    harness.serve(5 * MS)
    task.heartbeat(NmtState.PRE_OPERATIONAL, 60 * MS)
    for ms in range(60, 4000, 20):
        task.tick(ms * MS)
    assert harness.commands == [NmtCommand.START] * 3
    assert "boot error T" in str(task.error)


def test_the_boots_own_sdo_timeout_is_used_for_its_requests_only():
    sdo = SdoClient(3, timeout_ns=100 * MS)
    BootTask(replace(PLAN, sdo_timeout_ns=2000 * MS), sdo, lambda _command: None, reset=False, now=0)
    assert sdo.next_deadline() == 2000 * MS
    other = SdoClient(3, timeout_ns=100 * MS)
    BootTask(PLAN, other, lambda _command: None, reset=False, now=0)
    assert other.next_deadline() == 100 * MS


def test_a_node_to_be_kept_alive_is_asked_for_its_state_by_its_heartbeat():
    sdo, commands = SdoClient(3, timeout_ns=100 * MS), []
    harness = Harness(reset=False)
    harness.sdo, harness.commands, harness.held = sdo, commands, {}
    harness.task = BootTask(replace(PLAN, keep_alive=True), sdo, commands.append, reset=True, now=0)
    harness.serve(5 * MS)
    assert harness.task.step == "keep alive"
    harness.task.heartbeat(NmtState.OPERATIONAL, 50 * MS)
    assert harness.task.step == "compare"
    harness.serve(60 * MS)
    harness.task.heartbeat(NmtState.OPERATIONAL, 100 * MS)
    assert harness.task.result is not None
    assert commands == []
    assert harness.held == {b"\x17\x10\x00": b"d\x00"}, "its supervision, which it lacked, and nothing else"
