"""Masters that are broken in one way each: tables of check, master, and faults that its device goes through."""

import struct

from support.scripted_master import BEAT, NODE, RPDO, SYNC, ScriptedMaster

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.cia402.state import State

START = bytes((NmtCommand.START, NODE))
INVALID = 0x80000000


def broken(method="", /, *acts, base=ScriptedMaster, **attributes):
    """Return a master that does `acts` in place of a method, and the method itself where `...` is among them."""

    def does(master, *words):
        for act in acts:
            if act is ...:
                getattr(super(kind, master), method)(*words)
            else:
                act(master)

    kind = type(method or next(iter(attributes)), (base,), {method: does} if method else attributes)
    return kind


def asks(command, index, subindex, value):
    """Return an act: one SDO request, whatever the answer."""
    return lambda master: master.ask(struct.pack("<BHBI", command, index, subindex, value))


def writes(index, subindex, value, size):
    return lambda master: master.write(index, subindex, value, size)


def puts(can_id, data=b""):
    return lambda master: master.put(can_id, data)


def says(*frames):
    """Return a master that sends raw frames before NMT start."""
    return broken("start", *(puts(can_id, bytes.fromhex(data)) for can_id, data in frames), ...)


def requests(*frames):
    return says(*((0x600 + NODE, data) for data in frames))


# -- mutants of the configuration


class StartsAnyway(ScriptedMaster):
    def write(self, index, subindex, value, size):
        return self.ask(struct.pack("<BHBI", {1: 0x2F, 2: 0x2B, 4: 0x23}[size], index, subindex, value))


RESET = puts(0, bytes((NmtCommand.RESET_COMMUNICATION, NODE)))
MAPS = (asks(0x23, 0x1600, 1, 0x60400010), asks(0x23, 0x1600, 2, 0))
MAPS_WRONG_COUNT = (
    writes(0x1400, 1, INVALID | RPDO, 4),
    writes(0x1600, 0, 0, 1),
    writes(0x1600, 1, 0x60400010, 4),
    writes(0x1600, 2, 0x60FF0020, 4),
    writes(0x1600, 0, 1, 1),
    writes(0x1600, 0, 0, 1),
    writes(0x1600, 1, 0x60400010, 4),
    asks(0x2F, 0x1600, 0, 2),
)
CONFIGURATION = [
    ("MC01", broken("reset", RESET, lambda master: master.ask(struct.pack("<BHB4x", 0x40, 0x1000, 0), 0.05), ...), ()),
    ("MC02", broken("identify"), ()),
    ("MC03", broken("identify"), ()),
    ("MC04", broken("supervise", ScriptedMaster.start, ...), ()),
    ("MC05", broken("supervise"), ()),
    ("MC06", broken("supervise", writes(0x1017, 0, 100, 2)), ()),
    ("MC07", broken("map_rpdo", writes(0x1400, 1, RPDO, 4), asks(0x2F, 0x1600, 0, 0), *MAPS, ...), ()),
    ("MC08", broken("map_rpdo", writes(0x1400, 1, INVALID | RPDO, 4), MAPS[0], ...), ()),
    ("MC09", broken("map_rpdo", ..., *MAPS_WRONG_COUNT), ()),
    ("MC10", broken("map_rpdo", asks(0x23, 0x1400, 1, 0x206), ...), ()),
    ("MC11", broken("start", asks(0x2B, 0x1800, 3, 50), ...), ()),
    ("MC12", broken("start", ..., ScriptedMaster.map_rpdo), ()),
    ("MC13", broken("supervise", asks(0x23, 0x1014, 0, 0x601), ...), ()),
    ("MC14", StartsAnyway, [("reset", 4)]),
    ("MC15", broken("supervise", asks(0x23, 0x1016, 2, NODE << 16 | 500), ...), ()),
]


# -- mutants of NMT and SDO


class StartsUnbooted(ScriptedMaster):
    def reset(self):
        self.put(0, bytes((NmtCommand.RESET_NODE, NODE)))
        self.put(0, START)
        self.booted = False
        while not self.booted:
            self.wait(0.01)


class ForgetsAnswers(ScriptedMaster):
    """It sends the next request when none has come, without an abort."""

    def transfer(self, request):
        answer = None
        while answer is None:
            answer = self.ask(request)
        return answer


class Hangs(ScriptedMaster):
    """It waits for an answer for ever."""

    def ask(self, request, seconds=0.5):
        return super().ask(request, 12.0)


class Hurries(ScriptedMaster):
    """It asks a silent device again and again."""

    def lost(self):
        super().lost()
        for _ in range(40):
            self.ask(struct.pack("<BHB4x", 0x40, 0x1000, 0), 0.03)


class TakesAnyAnswer(ScriptedMaster):
    def transfer(self, request):
        answer = self.ask(request)
        if answer is None:
            self.put(0x600 + NODE, b"\x80" + request[1:4] + bytes.fromhex("00000405"))
        return answer


UPLOAD_NAME, SEGMENTS = "4008100000000000", ("6000000000000000", "6000000000000000")
REQUESTS = [
    ("MT02", requests("40001000"), ()),
    ("MT03", requests(UPLOAD_NAME, *SEGMENTS), ()),
    ("MT12", requests("6000000000000000"), ()),
    ("MT04", requests("2317100064000000"), ()),
    ("MT05", ForgetsAnswers, [("reset", 1)]),
    ("MT06", requests("4000100001000000"), ()),
    ("MT06", requests("2B17100064000100"), ()),
    ("MT07", requests("4004100000000000", "6000000000000000"), ()),
    ("MT08", Hangs, [("reset", 1)]),
    ("MT09", Hurries, [("silent", 0)]),
    ("MT10", TakesAnyAnswer, [("reset", 3)]),
    ("MT11", requests("E000100000000000"), ()),
    ("MT13", requests("2300100001000000"), ()),
]


class Overlaps(ScriptedMaster):
    """It sends two requests at once, while the device is slow."""

    def mend(self, stage):
        for subindex in (1, 2):
            self.put(0x600 + NODE, struct.pack("<BHB4x", 0x40, 0x1018, subindex))


# -- mutants of error control, SYNC and PDOs


class Guards(ScriptedMaster):
    """It guards the device instead of heartbeats; `gap_s` is the time between two remote frames."""

    gap_s = 0.1
    producer = guard_at = 0

    def supervise(self):
        for index, value, size in ((0x100C, 100, 2), (0x100D, 3, 1), (0x1017, self.producer, 2)):
            self.write(index, 0, value, size)

    def cycle(self):
        if self.started and self.now >= self.guard_at:
            self.guard_at = self.now + round(self.gap_s * 1e9)
            self.ask_remote(0x700 + NODE)
            self.last_heard = self.now
        super().cycle()


class NoSync(ScriptedMaster):
    def sync(self):
        pass

    def map_rpdo(self):
        super().map_rpdo()
        self.write(0x1400, 1, 0x80000000 | RPDO, 4)
        self.write(0x1400, 2, 1, 1)
        self.write(0x1400, 1, RPDO, 4)


class Synchronous(NoSync):
    def sync(self):
        self.put(SYNC)

    def rpdo(self):
        super().rpdo()
        super().rpdo()


class Counts(ScriptedMaster):
    step = 1

    def __init__(self):
        super().__init__()
        self.count = 0

    def supervise(self):
        super().supervise()
        self.write(0x1019, 0, 10, 1)

    def sync(self):
        if self.started:
            self.count = (self.count + self.step - 1) % 10 + 1
            self.put(SYNC, bytes((self.count,)))


class Csp(ScriptedMaster):
    mode, interpolation = 8, 20

    def supervise(self):
        super().supervise()
        self.write(0x60C2, 1, self.interpolation, 1)


class Jitters(ScriptedMaster):
    turn = 0

    def sync(self):
        self.turn += 1
        self.sync_ns = (10, 30)[self.turn % 2] * 1_000_000
        super().sync()


class AsksProtected(ScriptedMaster):
    def supervise(self):
        super().supervise()
        for value in (0xC0000185, 0x40000185):
            self.write(0x1800, 1, value, 4)

    def enable(self):
        super().enable()
        self.ask_remote(0x185)


CYCLIC = [
    ("MG01", broken(base=Guards, producer=100), ()),
    ("MG02", broken(base=Guards, gap_s=0.4), ()),
    ("MG03", broken(base=Guards, gap_s=0.4), ()),
    ("MH01", broken("beat"), ()),
    ("MH02", broken(beat_ns=600_000_000), ()),
    ("MH03", broken(beat_ns=400_000_000), ()),
    ("MH04", says((BEAT, "03")), ()),
    ("MH05", says((0x700 + NODE, "05")), ()),
    ("MY01", NoSync, ()),
    ("MY02", broken("sync", puts(SYNC, b"\1")), ()),
    ("MY03", broken(base=Counts, step=2), ()),
    ("MY04", broken("supervise", ..., writes(0x1006, 0, 10_000, 4)), ()),
    ("MY05", broken(base=Csp, interpolation=10), ()),
    ("MY06", Jitters, ()),
    ("MP01", broken("start", lambda master: master.wait(0.1), lambda master: master.command(0), ...), ()),
    ("MP02", broken("command", ..., puts(RPDO, b"\0\0\0")), ()),
    ("MP03", Synchronous, ()),
    ("MP04", AsksProtected, ()),
    ("MP05", broken("supervise", ..., writes(0x1400, 5, 10, 2)), ()),
]


# -- mutants of commands and reactions


class EnablesAtOnce(ScriptedMaster):
    def supervise_drive(self):
        self.word = 0x0F if self.wants else 0


class ChainsEnable(ScriptedMaster):
    def fault_reset(self):
        self.supervise_drive = lambda: None
        for word in (0x00, 0x80, 0x06, 0x07, 0x0F):
            self.word = word
            self.wait(0.06)


class HoldsBit7(ScriptedMaster):
    def fault_reset(self):
        self.command(0x80)
        self.word, self.failed = 0x80, lambda: None
        self.supervise_drive = lambda: None
        self.wait(1.5)


class TargetBeforeEnable(ScriptedMaster):
    def supervise_drive(self):
        super().supervise_drive()
        self.target = 500


class SetPointsAtOnce(ScriptedMaster):
    """Profile position with set-points that do not wait."""

    mode = 1

    def work(self):
        super().work()
        self.supervise_drive = lambda: None
        self.write(0x6081, 0, 1000, 4)
        self.write(0x6083, 0, 1000, 4)
        for position in (100_000, 200_000, 300_000, 400_000):
            self.write(0x607A, 0, position, 4)
            self.word = 0x0F
            self.wait(0.02)
            self.word = 0x1F
            self.wait(0.02)
            self.command(0x1F)
            self.command(0x0F)
            self.command(0x1F)


class GoesOn(ScriptedMaster):
    """Its controlword and its set-points stay as they are, whatever happens."""

    turn = 0

    def failed(self):
        self.target += 1

    def supervise_drive(self):
        if self.word == 0x0F:
            self.target += 1
        else:
            super().supervise_drive()


class EnablesAgain(ScriptedMaster):
    """It resets whatever is a fault, and enables whatever is disabled."""

    def supervise_drive(self):
        super().supervise_drive()
        if self.wants and self.device.drives[0].state is State.FAULT:
            self.word = 0x80 - self.word if self.word in (0, 0x80) else 0

    def failed(self):
        self.word = 0

    def mend(self, stage):
        super().mend(stage)
        self.wants = True


class IgnoresState(ScriptedMaster):
    def lost(self):
        self.last_heard = self.now

    def mend(self, stage):
        pass


class OneThread(ScriptedMaster):
    """It handles an EMCY for 20 ms, and does nothing else."""

    quiet_until = 0

    def hear(self, frame):
        super().hear(frame)
        if frame.can_id == 0x80 + NODE:
            self.quiet_until = self.now + 20_000_000

    def cycle(self):
        if self.now >= self.quiet_until:
            super().cycle()


class StartsUnconfigured(ScriptedMaster):
    def mend(self, stage):
        if not self.started:
            self.start()


COMMANDS = [
    ("MW01", EnablesAtOnce, ()),
    ("MW05", TargetBeforeEnable, ()),
    ("MW06", broken("enable", writes(0x607A, 0, 5_000_000, 4), ..., base=Csp), ()),
    ("MW07", broken("start", asks(0x2F, 0x6060, 0, 25), ...), ()),
    ("MW08", broken(mode=0), ()),
    ("MW09", broken(command=lambda master, word, target=0: ScriptedMaster.command(master, word | 0x400, target)), ()),
    ("MW10", SetPointsAtOnce, ()),
    ("MF01", GoesOn, [("fault", 0)]),
    ("MF02", GoesOn, [("fault", 0)]),
    ("MF03", EnablesAgain, [("power", 0)]),
    ("MF04", IgnoresState, [("leaves", 0)]),
    ("MF05", EnablesAgain, [("leaves", 0)]),
    ("MF06", OneThread, [("flood", 0)]),
    ("MF07", StartsUnconfigured, [("reset", 0)]),
    ("MF08", IgnoresState, [("reset", 0)]),
    ("MF09", EnablesAgain, [("reset", 0)]),
    ("MF10", IgnoresState, [("heartbeat", 0)]),
    ("MF11", EnablesAgain, [("heartbeat", 0)]),
    ("MF12", IgnoresState, [("silent", 0)]),
]

NETWORK_MANAGEMENT = [
    ("MN01", says((0, "01")), ()),
    ("MN01", says((0, "0705")), ()),
    ("MN02", StartsUnbooted, ()),
    ("MN03", says(*[(0, "8005")] * 12), ()),
]


def ids(rows):
    """Return names for the tests of a table."""
    return [f"{row[0]}-{row[1].__name__}" for row in rows]


def failures(kind, faults=()):
    """Return what a master fails that boots, enables and goes through faults, by the ids of the checks."""
    return worked(kind, faults).verdicts()[0]


def worked(kind, faults=()):
    """Return a master that has booted and enabled the device, and has gone through faults."""
    master = kind()
    master.work()
    for fault in faults:
        master.fault(*fault)
    return master
