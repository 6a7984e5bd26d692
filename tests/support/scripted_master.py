"""A scripted master at a judged virtual device, in virtual time and without a bus: right as it is, to be broken."""

import contextlib
import struct

from support.virtualbench import GENERIC

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia402.state import State
from canopen_control.conformance.master_drive import schedule
from canopen_control.conformance.master_run import MasterJudge
from canopen_control.frame import CanFrame, remote_frame
from canopen_control.virtual.device import make_device

NODE, MS, S = 5, 1_000_000, 1_000_000_000
RPDO, SYNC, BEAT = 0x205, 0x80, 0x701
SIZED = {1: 0x2F, 2: 0x2B, 4: 0x23}
UP = {State.SWITCH_ON_DISABLED: 0x06, State.READY_TO_SWITCH_ON: 0x07, State.SWITCHED_ON: 0x0F}
MAPPING = (0x60400010, 0x60FF0020)


class NoAnswerError(Exception):
    """A transfer was refused, or not answered, three times."""


class ScriptedMaster:
    """Boots, configures, starts and enables the device, supervises it, and stops when it fails; a step is a method."""

    mode = 3
    beat_ns = 100 * MS
    sync_ns = 20 * MS

    def __init__(self):
        self.device = make_device(GENERIC, NODE)
        self.now = S
        self.judge = MasterJudge(self.device, self.now)
        self.word, self.target, self.started, self.wants = 0, 0, False, False
        self.last_heard = self.now
        self.answer = None
        self.beat_at = self.sync_at = self.now

    # -- the bus

    def collect(self):
        for frame in self.judge.frames(self.now):
            self.hear(frame)

    def hear(self, frame):
        if frame.can_id == 0x580 + NODE:
            self.answer = frame.data
        elif frame.can_id == 0x700 + NODE:
            self.last_heard = self.now
            if frame.data == b"\0":
                self.booted = True
            elif self.started and frame.data[0] != NmtState.OPERATIONAL:
                self.lost()

    def put(self, can_id, data=b""):
        self.judge.receive(CanFrame(can_id, bytes(data)), self.now)
        self.collect()

    def ask_remote(self, can_id):
        self.judge.receive(remote_frame(can_id, 1), self.now)
        self.collect()

    def wait(self, seconds):
        end = self.now + round(seconds * S)
        while self.now < end:
            self.now += 5 * MS
            self.judge.tick(self.now)
            self.collect()
            self.cycle()

    # -- SDO

    def ask(self, request, seconds=0.5):
        self.answer = None
        self.put(0x600 + NODE, request)
        end = self.now + round(seconds * S)
        while self.answer is None and self.now < end:
            self.wait(0.005)
        return self.answer

    def transfer(self, request):
        for _ in range(3):
            answer = self.ask(request)
            end = self.now + S
            while answer is not None and answer[1:4] != request[1:4] and self.now < end:
                self.answer = None
                self.wait(0.005)
                answer = self.answer
            if answer is not None and answer[0] != 0x80:
                return answer
            if answer is None:
                self.put(0x600 + NODE, b"\x80" + request[1:4] + bytes.fromhex("00000405"))
            self.wait(0.5)
        raise NoAnswerError

    def read(self, index, subindex=0):
        return self.transfer(struct.pack("<BHB4x", 0x40, index, subindex))

    def write(self, index, subindex, value, size):
        return self.transfer(struct.pack("<BHBI", SIZED[size], index, subindex, value))

    # -- boot

    def boot(self):
        self.started = False
        self.reset()
        self.identify()
        self.supervise()
        self.map_rpdo()
        self.write(0x6060, 0, self.mode, 1)
        self.start()

    def reset(self):
        self.booted = False
        self.put(0, bytes((NmtCommand.RESET_COMMUNICATION, NODE)))
        while not self.booted:
            self.wait(0.01)

    def identify(self):
        self.read(0x1000)
        self.read(0x1018, 1)

    def supervise(self):
        self.write(0x1016, 1, 1 << 16 | 500, 4)
        self.write(0x1017, 0, 100, 2)

    def map_rpdo(self):
        self.write(0x1400, 1, 0x80000000 | RPDO, 4)
        self.write(0x1600, 0, 0, 1)
        for number, entry in enumerate(MAPPING, 1):
            self.write(0x1600, number, entry, 4)
        self.write(0x1600, 0, len(MAPPING), 1)
        self.write(0x1400, 2, 255, 1)
        self.write(0x1400, 1, RPDO, 4)

    def start(self):
        self.put(0, bytes((NmtCommand.START, NODE)))
        self.started = True

    # -- operation

    def cycle(self):
        if self.now >= self.beat_at:
            self.beat_at = self.now + self.beat_ns
            self.beat()
        if self.now >= self.sync_at:
            self.sync_at = self.now + self.sync_ns
            if self.started:
                self.supervise_drive()
                self.rpdo()
            self.sync()
        if self.started and self.now - self.last_heard > S // 2:
            self.lost()

    def beat(self):
        self.put(BEAT, b"\x05")

    def sync(self):
        self.put(SYNC)

    def rpdo(self):
        self.command(self.word, self.target)

    def supervise_drive(self):
        state = self.device.drives[0].state
        if not self.wants:
            self.word, self.target = 0, 0
        elif state is State.OPERATION_ENABLED:
            self.target = 1000
        elif self.word == 0x0F and self.device.drives[0].state is not State.SWITCHED_ON:
            self.failed()
        else:
            self.word, self.target = UP.get(state, 0), 0

    def failed(self):
        """The drive has left OPERATION ENABLED."""
        self.wants, self.word, self.target = False, 0, 0

    def lost(self):
        """The device is not OPERATIONAL, or silent."""
        self.wants = self.started = False
        self.put(0, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, NODE)))
        self.last_heard = self.now

    def enable(self):
        self.wants = True
        self.wait(0.5)

    def fault_reset(self):
        for word in (0, 0x80, 0):
            self.command(word)
        self.wait(0.6)

    def command(self, word, target=0):
        self.put(RPDO, struct.pack("<Hi", word, target))

    # -- complete run

    def work(self):
        """Boot the device and enable it."""
        self.wait(0.3)
        self.boot()
        self.enable()
        self.wait(2.5)

    def fault(self, kind, number=0):
        """Go through a stage of the schedule, and boot again."""
        stage = [stage for stage in schedule() if stage.kind == kind][number]
        self.judge.begin(stage, self.now)
        while self.now < stage.begun + stage.total:
            if self.now >= stage.fault_end:
                self.judge.clear_faults(stage, self.now)
            if self.now >= stage.fault_end or stage.kind == "reset":
                self.mend(stage)
            self.wait(0.1)
        self.judge.clear_faults(stage, self.now)
        self.judge.end(self.now)

    def mend(self, stage):
        """Boot a lost device again."""
        if not self.started and stage.kind in ("leaves", "reset", "heartbeat", "silent"):
            with contextlib.suppress(NoAnswerError):
                self.boot()

    def verdicts(self):
        """Return what came, by the ids of the checks that have failed, and the ids of those that have passed."""
        results = self.judge.report(self.now).results
        failed = {result.id: result.observed for result in results if result.verdict == "failed"}
        return failed, {result.id for result in results if result.verdict == "passed"}
