# ruff: noqa: E501 - the tables of objects are tables
"""A virtual node on a bench: a clock moved by hand, raw frames in and out, no bus in between."""

from __future__ import annotations

import contextlib
import struct
import threading
from pathlib import Path

from canopen_control.bus.channel import open_port
from canopen_control.cia301.nmt import NmtCommand, nmt_frame
from canopen_control.cia402 import objects as o
from canopen_control.frame import CanFrame
from canopen_control.host.reactor import Reactor
from canopen_control.od.model import DataType, DeviceInfo, Entry, ObjectDictionary
from canopen_control.virtual.control import NodeControl
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeHost

MS = 1_000_000
S = 1_000_000_000
TMCM = Path(__file__).parents[2] / "eds" / "TMCM-1270.eds"
T = DataType
SIZES = {1: 0x2F, 2: 0x2B, 3: 0x27, 4: 0x23}
REACHED, LIMIT, BIT_12 = 1 << 10, 1 << 11, 1 << 12  # bits of a statusword


class Aborted(Exception):
    """An SDO transfer ended with `code`."""

    def __init__(self, code):
        self.code = code
        super().__init__(f"{code:08X}")


class Bench:
    """One node; `now` is its clock, `seen` all frames it sent with their times, `events` what happened."""

    def __init__(self, node, start=S):
        self.node, self.now = node, start
        self.seen, self.events = [], []
        node.tick(start)
        self.collect()

    @property
    def drive(self):
        return self.node.drives[0]

    def collect(self):
        frames = self.node.frames()
        self.seen += [(self.now, frame) for frame in frames]
        self.events += self.node.events()
        return frames

    def put(self, can_id, data=b""):
        """Give the node a frame; return what it sent."""
        self.node.receive(CanFrame(can_id, bytes(data)), self.now)
        return self.collect()

    def to(self, moment):
        """Go on to a time, served at every deadline on the way."""
        while (due := self.node.next_deadline()) is not None and due <= moment:
            self.now = max(due, self.now)
            self.node.tick(self.now)
            self.collect()
        self.now = max(self.now, moment)
        self.node.tick(self.now)
        self.collect()
        return self

    def on(self, seconds):
        return self.to(self.now + round(seconds * S))

    def nmt(self, command):
        return self.put(0, nmt_frame(command, self.node.node_id).data)

    def start(self):
        return self.nmt(NmtCommand.START)

    def sync(self, counter=None):
        return self.put(0x080, b"" if counter is None else bytes((counter,)))

    # -- SDO with raw frames

    def request(self, data):
        n = self.node.node_id
        frames = self.put(0x600 + n, data)
        answers = [frame.data for frame in frames if frame.can_id == 0x580 + n]
        return answers[0] if answers else None

    def read(self, index, sub=0):
        answer = self.request(struct.pack("<BHB4x", 0x40, index, sub))
        if answer is None:
            return None
        if answer[0] == 0x80:
            raise Aborted(int.from_bytes(answer[4:], "little"))
        if answer[0] & 2:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        data, toggle = b"", 0
        while True:
            answer = self.request(bytes((0x60 | toggle,)) + bytes(7))
            data += answer[1 : 8 - (answer[0] >> 1 & 7)]
            if answer[0] & 1:
                return data
            toggle ^= 0x10

    def number(self, index, sub=0, signed=False):
        return int.from_bytes(self.read(index, sub), "little", signed=signed)

    def write_raw(self, index, sub, data):
        answer = self.request(struct.pack("<BHB", SIZES[len(data)], index, sub) + data.ljust(4, b"\0"))
        if answer is not None and answer[0] == 0x80:
            raise Aborted(int.from_bytes(answer[4:], "little"))
        return answer

    def write(self, index, value, sub=0, size=None):
        size = (self.node.od[index, sub].data_type.bits + 7) // 8 if size is None else size
        return self.write_raw(index, sub, (value & (1 << 8 * size) - 1).to_bytes(size, "little"))

    def abort_of(self, index, value, sub=0, size=None):
        """Return the abort code of a write, None when it is taken."""
        try:
            self.write(index, value, sub, size)
        except Aborted as error:
            return error.code
        return None

    # -- the drive

    @property
    def statusword(self):
        self.drive.advance(self.now)
        return self.drive.statusword()

    @property
    def state(self):
        return self.drive.state.name

    @property
    def position(self):
        return self.number(0x6064, signed=True)

    @property
    def velocity(self):
        return self.number(0x606C, signed=True)

    def control(self, word, axis=0):
        """Write the controlword by SDO."""
        return self.write(o.axis_index(0x6040, axis), word)

    def enable(self, mode=None, axis=0):
        if mode is not None:
            self.write(o.axis_index(0x6060, axis), mode)
        if not self.node.operational:
            self.start()
        for word in (0x06, 0x07, 0x0F):
            self.control(word, axis)
            self.on(0)
        return self


def tmcm(node_id=3, **kwargs):
    return make_device(TMCM, node_id, **kwargs)


def ready_tmcm(ramp=16000, mode=3):
    """A TMCM-1270 with ramps, enabled."""
    bench = Bench(tmcm())
    for index in (0x6083, 0x6084, 0x6085):
        bench.write(index, ramp)
    bench.write(0x6081, 2000)
    return bench.enable(mode)


def entry(index, sub, data_type, default=None, access="rw", mapped=False, **kwargs):
    return Entry(index, sub, f"{index:04X}:{sub}", data_type, access, mapped, default, **kwargs)


def pdo_entries(number, rpdo, mapping, cob_id, kind=255, slots=8):
    comm, record = (0x1400, 0x1600) if rpdo else (0x1800, 0x1A00)
    comm, record = comm + number, record + number
    entries = [
        entry(comm, 0, T.UNSIGNED8, 6, "ro"),
        entry(comm, 1, T.UNSIGNED32, cob_id),
        entry(comm, 2, T.UNSIGNED8, kind),
    ]
    entries += [entry(comm, 3, T.UNSIGNED16, 0), entry(comm, 5, T.UNSIGNED16, 0), entry(comm, 6, T.UNSIGNED8, 0)]
    entries += [entry(record, 0, T.UNSIGNED8, len(mapping))]
    return entries + [
        entry(record, sub, T.UNSIGNED32, mapping[sub - 1] if sub <= len(mapping) else 0) for sub in range(1, slots + 1)
    ]


SERVO = (
    (0x6007, T.INTEGER16, 1), (0x603F, T.UNSIGNED16, 0), (0x6040, T.UNSIGNED16, 0), (0x6041, T.UNSIGNED16, None),
    (0x6042, T.INTEGER16, 0), (0x6043, T.INTEGER16, None), (0x6044, T.INTEGER16, None), (0x605A, T.INTEGER16, 2),
    (0x605B, T.INTEGER16, 0), (0x605C, T.INTEGER16, 1), (0x605D, T.INTEGER16, 1), (0x605E, T.INTEGER16, 2),
    (0x6060, T.INTEGER8, 0), (0x6061, T.INTEGER8, None), (0x6062, T.INTEGER32, None), (0x6063, T.INTEGER32, None),
    (0x6064, T.INTEGER32, None), (0x6065, T.UNSIGNED32, 0), (0x6066, T.UNSIGNED16, 0), (0x6067, T.UNSIGNED32, 0),
    (0x6068, T.UNSIGNED16, 0), (0x6069, T.INTEGER32, None), (0x606B, T.INTEGER32, None), (0x606C, T.INTEGER32, None),
    (0x606D, T.UNSIGNED16, 0), (0x606F, T.UNSIGNED16, 0), (0x6071, T.INTEGER16, 0), (0x6072, T.UNSIGNED16, 1000),
    (0x6074, T.INTEGER16, None), (0x6077, T.INTEGER16, None), (0x6078, T.INTEGER16, None), (0x607A, T.INTEGER32, 0),
    (0x607C, T.INTEGER32, 0), (0x607F, T.UNSIGNED32, 0), (0x6081, T.UNSIGNED32, 1000), (0x6083, T.UNSIGNED32, 10000),
    (0x6084, T.UNSIGNED32, 5000), (0x6085, T.UNSIGNED32, 20000), (0x6087, T.UNSIGNED32, 1000), (0x6098, T.INTEGER8, 0),
    (0x609A, T.UNSIGNED32, 10000), (0x60B0, T.INTEGER32, 0), (0x60B1, T.INTEGER32, 0), (0x60B2, T.INTEGER16, 0),
    (0x60F2, T.UNSIGNED16, 0), (0x60F4, T.INTEGER32, None), (0x60FC, T.INTEGER32, None), (0x60FD, T.UNSIGNED32, None),
    (0x60FF, T.INTEGER32, 0), (0x6502, T.UNSIGNED32, 0x3EF),
)  # fmt: skip
SHOWN = {0x6041, 0x6043, 0x6044, 0x6061, 0x6062, 0x6063, 0x6064, 0x6069, 0x606B, 0x606C, 0x6074, 0x6077, 0x6078, 0x60F4, 0x60FC, 0x60FD, 0x6502}  # fmt: skip
SERVO_SUBS = (
    (0x6046, 1, T.UNSIGNED32, 0), (0x6046, 2, T.UNSIGNED32, 0), (0x6048, 1, T.UNSIGNED32, 600), (0x6048, 2, T.UNSIGNED16, 2),
    (0x6049, 1, T.UNSIGNED32, 600), (0x6049, 2, T.UNSIGNED16, 1), (0x607D, 1, T.INTEGER32, 0), (0x607D, 2, T.INTEGER32, 0),
    (0x608F, 1, T.UNSIGNED32, 6000), (0x608F, 2, T.UNSIGNED32, 1), (0x6099, 1, T.UNSIGNED32, 5000),
    (0x6099, 2, T.UNSIGNED32, 500), (0x60C1, 1, T.INTEGER32, 0), (0x60C2, 1, T.UNSIGNED8, 10), (0x60C2, 2, T.INTEGER8, -3),
)  # fmt: skip
COMMUNICATION = (
    (0x1000, 0, T.UNSIGNED32, 0x20192, "ro"), (0x1001, 0, T.UNSIGNED8, None, "ro"), (0x1003, 0, T.UNSIGNED8, 0, "rw"),
    (0x1003, 1, T.UNSIGNED32, None, "ro"), (0x1003, 2, T.UNSIGNED32, None, "ro"), (0x1005, 0, T.UNSIGNED32, 0x80, "rw"),
    (0x1008, 0, T.VISIBLE_STRING, "a servo drive", "const"), (0x100C, 0, T.UNSIGNED16, 0, "rw"),
    (0x100D, 0, T.UNSIGNED8, 0, "rw"), (0x1010, 0, T.UNSIGNED8, 3, "ro"), (0x1010, 1, T.UNSIGNED32, None, "rw"),
    (0x1010, 2, T.UNSIGNED32, None, "rw"), (0x1010, 3, T.UNSIGNED32, None, "rw"), (0x1011, 0, T.UNSIGNED8, 1, "ro"),
    (0x1011, 1, T.UNSIGNED32, None, "rw"), (0x1015, 0, T.UNSIGNED16, 0, "rw"), (0x1016, 0, T.UNSIGNED8, 2, "ro"),
    (0x1016, 1, T.UNSIGNED32, 0, "rw"), (0x1016, 2, T.UNSIGNED32, 0, "rw"), (0x1017, 0, T.UNSIGNED16, 0, "rw"),
    (0x1018, 0, T.UNSIGNED8, 4, "ro"), (0x1018, 1, T.UNSIGNED32, 0x99, "ro"), (0x1018, 2, T.UNSIGNED32, 0x1234, "ro"),
    (0x1018, 3, T.UNSIGNED32, 0x10002, "ro"), (0x1018, 4, T.UNSIGNED32, None, "ro"), (0x1019, 0, T.UNSIGNED8, 0, "rw"),
    (0x1029, 1, T.UNSIGNED8, 1, "rw"),
)  # fmt: skip


def servo_od(node_id=5, axes=1, without=(), **changed):
    """Return the dictionary of a servo drive with every mode; `changed` gives defaults, as x6084=0."""
    od = ObjectDictionary(node_id=node_id, device=DeviceInfo(product_name="servo"), dummy_usage=frozenset((5, 6, 7)))
    for index, sub, data_type, default, access in COMMUNICATION:
        od.add(entry(index, sub, data_type, default, access))
    od.add(Entry(0x1014, 0, "COB-ID EMCY", T.UNSIGNED32, "rw", False, 0x80 + node_id, relative=True))
    for axis in range(axes):
        _add_axis(od, node_id, axis, without, changed)
    return od


def _add_axis(od, node_id, axis, without, changed):
    shift = 0x800 * axis
    for index, data_type, default in SERVO:
        if index not in without:
            access = "ro" if index in SHOWN else "rw"
            od.add(entry(index + shift, 0, data_type, changed.get(f"x{index:04X}", default), access, True))
    for index, sub, data_type, default in SERVO_SUBS:
        if index not in without:
            od.add(entry(index + shift, sub, data_type, default, "rw", index == 0x60C1))
    word, target, speed = 0x60400010 + (shift << 16), 0x607A0020 + (shift << 16), 0x60FF0020 + (shift << 16)
    status, position, actual = 0x60410010 + (shift << 16), 0x60640020 + (shift << 16), 0x606C0020 + (shift << 16)
    first = 64 * axis
    for number, rpdo, mapping, cob_id in (
        (first, True, [word, 0x60600008 + (shift << 16)], 0x200),
        (first + 1, True, [target, speed], 0x300),
        (first, False, [status, 0x60610008 + (shift << 16)], 0x180),
        (first + 1, False, [position, actual], 0x280),
    ):
        for item in pdo_entries(number, rpdo, mapping, cob_id + node_id + 0x20 * axis, 1 if not rpdo else 255):
            od.add(item)


def servo(node_id=5, axes=1, without=(), plant=None, faults=(), **changed):
    return make_device(servo_od(node_id, axes, without, **changed), node_id, faults, plant=plant)


def enabled(mode, **kwargs):
    """A servo drive, enabled in a mode."""
    return Bench(servo(**kwargs)).enable(mode)


GENERIC = Path(__file__).parents[2] / "eds" / "generic_cia402.eds"


def generic(node_id=5, **kwargs):
    """The bundled drive with every object of the profile."""
    return make_device(GENERIC, node_id, **kwargs)


@contextlib.contextmanager
def served(channel, device, *world):
    """Let a device run in a thread, with its control socket, and what hangs on it."""
    ready, reactor = threading.Event(), Reactor()

    def serve():
        with reactor, contextlib.closing(open_port(channel)) as port:
            host = NodeHost(reactor, port, [device])
            control = NodeControl(host, device, *world)
            reactor.call_soon(ready.set)
            reactor.run()
            control.close()
            host.close()

    thread = threading.Thread(target=serve)
    thread.start()
    assert ready.wait(60)
    yield
    reactor.call_threadsafe(reactor.stop)
    thread.join(60)
