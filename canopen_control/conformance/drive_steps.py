"""Steps of drive checks: reading, power state machine, modes, option codes, bounded motions (CiA 402-2).

Every motion is bounded. The speed is given by `--speed`, or is one per cent of 0x607F; the distance is given by
`--distance`, or is half a revolution by 0x6092 or 0x608F. A motion that goes further than `_BEYOND` times the
distance fails its check, which disables the drive. At the end of a check the shaft returns to its start position.
"""

from __future__ import annotations

from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NmtState
from canopen_control.cia301.pdo import parse_mapping_entry
from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import TARGET_REACHED, State, decode_statusword
from canopen_control.conformance.check import expect
from canopen_control.conformance.checked_node import CheckFailed, NotApplicable
from canopen_control.conformance.pdo_checks import CountedSync, pdo_records, present_values, reconfigured
from canopen_control.errors import BusError, RemoteProtocolError, SdoAbort
from canopen_control.od.indices import HEARTBEAT_CONSUMER, RPDO

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.conformance.checked_node import CheckedNode
    from canopen_control.conformance.pdo_checks import PdoRecord
    from canopen_control.host.timer import Timer


DRIVES = 402  # low word of 0x1000
STEP_S = 0.005  # interval of repeated uploads
LIMIT_S = 10.0  # longest time of a transition, or of a change of mode
_STANDING = (OperationMode.PV, OperationMode.PP, OperationMode.CSV, OperationMode.CSP)
SOD, RTSO, ON, OE = State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED
QSA, FAULT = State.QUICK_STOP_ACTIVE, State.FAULT
_UP, _UP_WORDS = (SOD, RTSO, ON, OE), (0x06, 0x07, 0x0F)  # transitions 2, 3 and 4 (CiA 402-2, 6.3)


def is_drive(node: CheckedNode) -> None:
    """Raise NotApplicable unless the device is a drive."""
    if int.from_bytes(node.read(0x1000)[:2], "little") != DRIVES:
        raise NotApplicable("the low word of 0x1000 is not 402: no drive")


def signed(node: CheckedNode, index: int, subindex: int = 0) -> int:
    """Read a signed number; raise NotApplicable if the device does not have the object."""
    return int.from_bytes(node.optional(index, subindex), "little", signed=True)


def statusword(node: CheckedNode) -> int:
    """Read 0x6041."""
    return int.from_bytes(node.read(o.STATUSWORD), "little")


def expect_bits(node: CheckedNode, mask: int, value: int, expected: str) -> None:
    """Check that the statusword has `value` in the bits of `mask`; `expected` is the text for the report."""
    word = statusword(node)
    expect(word & mask == value, f"statusword 0x{word:04X}", expected)


def control(node: CheckedNode, word: int) -> None:
    """Write 0x6040."""
    node.put(o.CONTROLWORD, 0, word, 2)


def reset_fault(node: CheckedNode) -> None:
    """Command a fault reset, which needs a rising edge of bit 7 (CiA 402-2, transition 15)."""
    control(node, 0x00)
    control(node, 0x80)


def reaches(node: CheckedNode, state: State, seconds: float = LIMIT_S) -> float:
    """Wait until the drive reaches a state; return the time in s, or raise CheckFailed after `seconds`."""
    begin = node.reactor.now()
    while True:
        word = statusword(node)
        elapsed = (node.reactor.now() - begin) / 1e9
        if decode_statusword(word) is state:
            return elapsed
        if elapsed >= seconds:
            shown = decode_statusword(word)
            name = "no state" if shown is None else shown.name
            raise CheckFailed(f"statusword 0x{word:04X} ({name}) after {seconds:g} s", state.name)
        node.listen(STEP_S if elapsed < 1.0 else 10 * STEP_S)


def stays(node: CheckedNode, state: State, seconds: float) -> None:
    """Check that the drive stays in a state for `seconds`."""
    for _ in range(10):
        word = statusword(node)
        shown = decode_statusword(word)
        expect(shown is state, "no state" if shown is None else shown.name, f"{state.name} for {seconds:g} s")
        node.listen(seconds / 10)


def go(node: CheckedNode, goal: State) -> None:
    """Bring the drive to the state `goal`, with one controlword per transition."""
    for _ in range(8):
        state = decode_statusword(statusword(node))
        if state is goal:
            return
        if state in (FAULT, State.FAULT_REACTION_ACTIVE):
            reaches(node, FAULT)
            reset_fault(node)
            reaches(node, SOD)
            continue
        control(node, _word_to(state, goal))
        _wait_until_left(node, state)
    reaches(node, goal, 0.1)


def _word_to(state: State | None, goal: State) -> int:
    """Return the controlword of the next transition from `state` towards `goal`, one of `_UP`."""
    if state not in _UP or goal is _UP[0]:
        return 0x00
    place, target = _UP.index(state), _UP.index(goal)
    return _UP_WORDS[place] if place < target else _UP_WORDS[target - 1]


def _wait_until_left(node: CheckedNode, state: State | None) -> None:
    for _ in range(round(LIMIT_S / 0.02)):
        if decode_statusword(statusword(node)) is not state:
            return
        node.listen(0.02 if state is not OE else STEP_S)


def set_mode(node: CheckedNode, mode: int) -> None:
    """Select a mode, and wait up to `LIMIT_S` until 0x6061 shows it; raise NotApplicable if 0x6502 does not list it."""
    if not node.number(o.SUPPORTED_DRIVE_MODES) >> (mode - 1) & 1:
        raise NotApplicable(f"0x6502 does not list mode {mode}")
    node.put(o.MODES_OF_OPERATION, 0, mode, 1)
    for _ in range(round(LIMIT_S / 0.02)):
        if signed(node, o.MODES_OF_OPERATION_DISPLAY) == mode:
            return
        node.listen(0.02)


def select_standstill_mode(node: CheckedNode) -> None:
    """Select a mode in which an enabled drive does not move; raise NotApplicable if the drive has none."""
    modes = node.number(o.SUPPORTED_DRIVE_MODES)
    mode = next((mode for mode in _STANDING if modes >> (mode - 1) & 1), None)
    if mode is None:
        raise NotApplicable("0x6502 lists neither PV, PP, CSV nor CSP")
    if mode in (OperationMode.PV, OperationMode.CSV):
        node.put(o.TARGET_VELOCITY, 0, 0, 4)
    else:
        node.write(o.TARGET_POSITION, 0, node.read(o.POSITION_ACTUAL))
    node.put(o.MODES_OF_OPERATION, 0, mode, 1)


@contextmanager
def drive_at(node: CheckedNode, goal: State, mode: int | None = None) -> Iterator[None]:
    """Context with the drive in the state `goal`; on exit the drive is switched off and its mode restored."""
    is_drive(node)
    with node.operational():
        before = node.read(o.MODES_OF_OPERATION)
        try:
            if mode is None:
                select_standstill_mode(node)
            else:
                set_mode(node, mode)
            go(node, goal)
            yield
        finally:
            with suppress(RemoteProtocolError):
                control(node, 0)
                for _ in range(100):
                    if decode_statusword(statusword(node)) in (SOD, FAULT):
                        break
                    node.listen(0.05)
                if decode_statusword(statusword(node)) is FAULT:
                    control(node, 0x80)
                    node.listen(0.05)
                    control(node, 0)
                node.write(o.MODES_OF_OPERATION, 0, before)


@contextmanager
def option(node: CheckedNode, index: int, value: int) -> Iterator[None]:
    """Context with an option code set to `value`; raise NotApplicable if the drive refuses the value."""
    with node.kept(index):
        try:
            node.put(index, 0, value, 2)
        except SdoAbort as error:
            raise NotApplicable(f"0x{index:04X} refuses {value}: 0x{error.code:08X}") from None
        yield


_BEYOND = 4
_SHARE = 100  # the default speed is 0x607F divided by this
RAMP_S = 0.1  # time from standstill to the speed of a motion
PERIOD_MS = 20  # period of SYNC and set-points in the cyclic modes
_MS_INDEX = 0xFD  # 0x60C2:02 = -3: milliseconds
NEW_SET_POINT, IMMEDIATELY, RELATIVE = 0x10, 0x20, 0x40  # bits of the controlword in PP; the first starts homing, too
ENABLE = 0x0F


class CheckMotion(NamedTuple):
    """Motion of one check, in user units; `distance` is negative if only that direction is free."""

    start: int
    distance: int
    speed: int
    ramp: int

    @property
    def velocity(self) -> int:
        """Speed with the sign of the distance."""
        return self.speed if self.distance > 0 else -self.speed


def _present(node: CheckedNode, index: int, subindex: int = 0) -> int:
    """Read an optional number; 0 if the device does not have the object."""
    try:
        return node.number(index, subindex)
    except NotApplicable:
        return 0


def _half_turn(node: CheckedNode) -> int:
    feed, turns = _present(node, o.FEED_CONSTANT, 1), _present(node, o.FEED_CONSTANT, 2) or 1
    if not feed:
        feed = _present(node, o.POSITION_ENCODER_RESOLUTION, 1)
        turns = _present(node, o.POSITION_ENCODER_RESOLUTION, 2) or 1
    return feed // turns // 2


def motion_of(node: CheckedNode) -> CheckMotion:
    """Return the motion of a check; raise NotApplicable if speed or distance are unknown, or 0x607D leaves no room."""
    most = _present(node, o.MAX_PROFILE_VELOCITY)
    speed = node.bounds.speed or most // _SHARE
    speed = min(speed, most) if most else speed
    distance = node.bounds.distance or _half_turn(node)
    if not speed or not distance:
        raise NotApplicable("the objects give no bounds of a motion; give --speed and --distance")
    start = signed(node, o.POSITION_ACTUAL)
    try:
        low, high = (signed(node, o.SOFTWARE_POSITION_LIMIT, subindex) for subindex in (1, 2))
    except NotApplicable:
        low = high = 0
    if low < high and start + 2 * distance > high:
        if start - 2 * distance < low:
            raise NotApplicable("0x607D leaves no room; give a smaller --distance")
        distance = -distance
    return CheckMotion(start, distance, speed, max(round(speed / RAMP_S), 1))


_WATCHERS = (124, 123)  # node-IDs of this program as the producer of a heartbeat; not that of `other_node_id`
_BEAT_NS, _BEATS_MS = 100_000_000, 1000
_UNSUPERVISED = "the drive does not monitor this program (0x1016), so it continues to move if this program is killed"


@contextmanager
def supervised(node: CheckedNode) -> Iterator[None]:
    """Context in which the drive monitors a heartbeat of this program, so that it stops if the program is killed.

    A value of 0 in 0x6007 (no reaction) is changed to 1 (fault reaction). The previous values are restored at the end.
    """
    watcher = next(node_id for node_id in _WATCHERS if node_id != node.node_id)
    timers: list[Timer] = []

    def beat() -> None:
        timers[:] = [node.reactor.call_later(_BEAT_NS, beat)]
        with suppress(BusError):  # a lost bus ends the check
            node.send(ERROR_CONTROL_COB_ID + watcher, bytes([NmtState.OPERATIONAL]))

    with ExitStack() as stack:
        try:
            if not _present(node, o.ABORT_CONNECTION_OPTION):
                with suppress(NotApplicable):
                    stack.enter_context(option(node, o.ABORT_CONNECTION_OPTION, 1))
            stack.enter_context(node.kept(HEARTBEAT_CONSUMER, 1))
            node.put(HEARTBEAT_CONSUMER, 1, watcher << 16 | _BEATS_MS, 4)
        except (NotApplicable, SdoAbort):
            node.notes.append(_UNSUPERVISED)
        else:
            beat()
        try:
            yield
        finally:
            stack.close()  # before the last heartbeat
            for timer in timers:
                timer.cancel()


@contextmanager
def moving(
    node: CheckedNode, mode: int, state: State = OE, *, deceleration_share: float = 1.0
) -> Iterator[CheckMotion]:
    """Context with the drive in `mode` and ramps of `RAMP_S`; on exit the drive returns to its start position.

    `deceleration_share` is the ratio of 0x6084 to 0x6083.
    """
    is_drive(node)
    motion = motion_of(node)
    values = (
        (o.PROFILE_VELOCITY, motion.speed),
        (o.PROFILE_ACCELERATION, motion.ramp),
        (o.PROFILE_DECELERATION, round(motion.ramp * deceleration_share)),
        (o.QUICK_STOP_DECELERATION, motion.ramp),
        (o.TARGET_VELOCITY, 0),
        (o.TARGET_POSITION, motion.start & 0xFFFFFFFF),
    )
    with ExitStack() as stack:
        stack.enter_context(supervised(node))
        for index, value in values:
            with suppress(NotApplicable):
                stack.enter_context(node.kept(index))
                node.put(index, 0, value, 4)
        with drive_at(node, state, mode):
            try:
                yield motion
            finally:
                with suppress(RemoteProtocolError):
                    _return(node, motion)


def _return(node: CheckedNode, motion: CheckMotion) -> None:
    """Stop the shaft, and return to the start position if the drive supports PP."""
    if node.has(o.TARGET_VELOCITY):
        node.put(o.TARGET_VELOCITY, 0, 0, 4)
    control(node, ENABLE)
    node.listen(2 * RAMP_S)
    if not node.number(o.SUPPORTED_DRIVE_MODES) & 1:
        return
    node.put(o.MODES_OF_OPERATION, 0, OperationMode.PP, 1)
    node.put(o.TARGET_POSITION, 0, motion.start & 0xFFFFFFFF, 4)
    node.listen(0.05)
    control(node, ENABLE | NEW_SET_POINT | IMMEDIATELY)
    node.listen(0.05)
    control(node, ENABLE)
    for _ in range(100):
        if statusword(node) & TARGET_REACHED:
            break
        node.listen(0.05)


# -- observation


class DriveSample(NamedTuple):
    """State of the drive at the time `seconds` of the reactor."""

    seconds: float
    position: int
    velocity: int
    word: int


def sample(node: CheckedNode, motion: CheckMotion) -> DriveSample:
    """Read the state of the drive; raise CheckFailed if the shaft has moved too far."""
    seconds = node.reactor.now() / 1e9
    position = signed(node, o.POSITION_ACTUAL)
    moved = abs(position - motion.start)
    if moved > _BEYOND * abs(motion.distance):
        raise CheckFailed(f"the shaft moved by {moved}", f"at most {_BEYOND * abs(motion.distance)}")
    return DriveSample(seconds, position, signed(node, o.VELOCITY_ACTUAL), statusword(node))


def until(
    node: CheckedNode, motion: CheckMotion, holds: Callable[[DriveSample], bool], seconds: float, expected: str
) -> list[DriveSample]:
    """Return the samples up to the first one for which `holds` is true; raise CheckFailed after `seconds`."""
    samples = [sample(node, motion)]
    while not holds(samples[-1]):
        last = samples[-1]
        if last.seconds - samples[0].seconds > seconds:
            observed = f"position {last.position}, velocity {last.velocity}, statusword 0x{last.word:04X}"
            raise CheckFailed(f"{observed} after {seconds:g} s", expected)
        node.listen(STEP_S)
        samples.append(sample(node, motion))
    return samples


def watch(node: CheckedNode, motion: CheckMotion, seconds: float) -> list[DriveSample]:
    """Return the samples of the next `seconds`."""
    samples = [sample(node, motion)]
    while samples[-1].seconds - samples[0].seconds < seconds:
        node.listen(STEP_S)
        samples.append(sample(node, motion))
    return samples


def window(node: CheckedNode, motion: CheckMotion) -> int:
    """Return the position window 0x6067, but at least a hundredth of the motion's distance."""
    value = _present(node, o.POSITION_WINDOW)
    return max(0 if value == 0xFFFFFFFF else value, abs(motion.distance) // 100, 2)


# -- modes


def turn(node: CheckedNode, motion: CheckMotion, velocity: int) -> list[DriveSample]:
    """Command a velocity in PV and return the samples until the shaft has reached it."""
    node.put(o.TARGET_VELOCITY, 0, velocity & 0xFFFFFFFF, 4)
    return until(node, motion, lambda one: fast(one, velocity), 5 * RAMP_S, f"velocity {velocity}")


def fast(one: DriveSample, velocity: int, share: float = 0.9) -> bool:
    """Whether the shaft has reached at least `share` of a velocity, in its direction."""
    return one.velocity * velocity > 0 and abs(one.velocity) >= share * abs(velocity)


def still(one: DriveSample, velocity: int) -> bool:
    """Whether the shaft is slower than a tenth of a velocity."""
    return abs(one.velocity) <= 0.1 * abs(velocity)


def set_point(node: CheckedNode, target: int, bits: int = 0) -> None:
    """Command a PP set-point by bit 4, then reset bit 4; raise CheckFailed unless bit 12 acknowledges the set-point."""
    control(node, ENABLE | bits)
    node.put(o.TARGET_POSITION, 0, target & 0xFFFFFFFF, 4)
    control(node, ENABLE | NEW_SET_POINT | bits)
    for _ in range(20):
        if statusword(node) & 0x1000:
            break
        node.listen(STEP_S)
    else:
        raise CheckFailed(f"statusword 0x{statusword(node):04X}", "bit 12 = 1: the set-point is acknowledged")
    control(node, ENABLE | bits)


class Stream:
    """Sender of set-points of one object in an RPDO, one per SYNC; `next_sync` is the time of the next SYNC in ns."""

    def __init__(self, node: CheckedNode, record: PdoRecord, index: int) -> None:
        self._node, self._record = node, record
        self._sync = CountedSync(node)
        self._image, shift = int.from_bytes(present_values(node, record), "little"), 0
        self._places: dict[int, tuple[int, int]] = {}
        for entry in record.entries:
            mapped, _, bits = parse_mapping_entry(entry)
            self._places[mapped] = shift, bits
            shift += bits
        self._index = index
        self.next_sync = node.reactor.now()
        self.value = 0
        self.fill(o.CONTROLWORD, ENABLE)

    def fill(self, index: int, value: int) -> None:
        """Set the value of an object in later frames, if the RPDO maps the object."""
        if index in self._places:
            shift, bits = self._places[index]
            mask = (1 << bits) - 1
            self._image = self._image & ~(mask << shift) | (value & mask) << shift

    def send(self, value: int) -> None:
        self.value = value
        self.fill(self._index, value)
        self._node.send(self._record.can_id, self._image.to_bytes(self._record.length, "little"))

    def sync(self, late_ms: float = 0.0) -> None:
        """Send the next SYNC at its time, or `late_ms` later."""
        self.next_sync += PERIOD_MS * 1_000_000
        wait = self.next_sync + round(late_ms * 1e6) - self._node.reactor.now()
        if wait > 0:
            self._node.listen(wait / 1e9)
        self._sync.send()

    def cycles(self, count: int, step: int) -> None:
        """Send `count` set-points, each `step` after the previous one and followed by a SYNC."""
        for _ in range(count):
            self.send(self.value + step)
            self.sync()


@contextmanager
def streaming(node: CheckedNode, mode: int, index: int) -> Iterator[tuple[CheckMotion, Stream]]:
    """Context with the drive enabled in a cyclic mode; the `Stream` sends set-points of the object `index`."""
    is_drive(node)
    records = (
        record
        for record in pdo_records(node, RPDO)
        if index in {parse_mapping_entry(entry)[0] for entry in record.entries}
    )
    record = next(records, None)
    if record is None:
        raise NotApplicable(f"no RPDO maps 0x{index:04X}")
    with ExitStack() as stack:
        with suppress(NotApplicable):
            stack.enter_context(node.kept(o.INTERPOLATION_TIME_PERIOD, 1))
            stack.enter_context(node.kept(o.INTERPOLATION_TIME_PERIOD, 2))
            node.put(o.INTERPOLATION_TIME_PERIOD, 2, _MS_INDEX, 1)
            node.put(o.INTERPOLATION_TIME_PERIOD, 1, PERIOD_MS, 1)
        stack.enter_context(reconfigured(node, record, {2: 1}))
        motion = stack.enter_context(moving(node, mode))
        stream = Stream(node, record, index)
        stream.fill(o.MODES_OF_OPERATION, mode)
        stream.value = motion.start if index == o.TARGET_POSITION else 0
        stream.cycles(5, 0)
        yield motion, stream


def step_of(motion: CheckMotion) -> int:
    """Return the set-point step per cycle that moves half of the motion's distance in a second."""
    return int(motion.distance * PERIOD_MS / 2000) or 1
