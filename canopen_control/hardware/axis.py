"""Process data of one drive axis: its inputs, outputs, scale and limits, independent of the PDO mapping.

The code uses object indices of axis 0, which are converted once for the actual axis. An object that is not in a PDO is
None here, and is transferred by SDO or not at all. Limits are in device units: the drive's own limits (0x607D, 0x607F,
0x6080, 0x60E0, 0x60E1) and the velocity limit of the description. In every mode a target is limited before it is sent.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.drive import DriveMachine
from canopen_control.cia402.drive_goal import DriveGoal
from canopen_control.cia402.modes import TARGET_OBJECTS, mode_of
from canopen_control.cia402.state import State
from canopen_control.cia402.units import INT32_MAX, INT32_MIN, PositionUnwrapper, Scale
from canopen_control.errors import RobotConfigError, SdoAbort, without_node
from canopen_control.hardware.axis_statechart import OVERDUE_TEXTS, AxisPhase
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.master.cycle import Input, Output, ProcessImage, ReceivedPdo
    from canopen_control.master.remote_node import RemoteNode


# Sources of an axis' statusword and mode of operation: a TPDO or SDO, with a limited age.
#
# While the TPDO with the statusword arrives, its value is used. When the TPDO is overdue, the last value remains valid
# for `GRACE_NS` while the statusword is read by SDO, and is unknown afterwards; SDO is also used if the TPDO has never
# arrived. A mode that is not in a PDO is written to 0x6060 when it is requested, and 0x6061 is read until it shows the
# mode. A drive without a statusword gets a quick stop command, because its motion cannot be observed, and after
# `BLIND_STOP_NS` disable voltage, unless the axis holds a load.


GRACE_NS: Final = 300_000_000
POLL_NS: Final = 50_000_000
_REWRITE_NS: Final = 500_000_000
BLIND_STOP_NS: Final = 2_000_000_000  # time for a stop ramp that cannot be observed
QUICK_STOP_WORD: Final = 0x0002  # CiA 402-2, table 24: bit 1 is 1, bit 2 is 0
_FORCED_WORDS: Final = {AxisPhase.FORCED_QUICK_STOP: QUICK_STOP_WORD, AxisPhase.VOLTAGE_DISABLED: 0}


class AxisStatus:
    """Statusword and mode display of an axis, from TPDOs or by SDO; None while unknown.

    `machine` supplies the mode to write by SDO if no RPDO contains 0x6060. `holds_load` means that the axis would drop
    its load without power, so that neither disable voltage nor NMT stop is sent.
    """

    def __init__(self, axis: AxisProcessData, machine: DriveMachine, *, holds_load: bool = False) -> None:
        self.word: int | None = None
        self.display: int | None = None
        self._axis, self._machine = axis, machine
        self.pdo, self.place = axis.statusword.pdo, axis.statusword.position
        """Index of the statusword in the values of `pdo`."""
        self.shown: ReceivedPdo | None = None
        """TPDO with the mode display, at index `shown_place`; None unless 0x6060 is in an RPDO and 0x6061 in a TPDO."""
        self.shown_place = 0
        if axis.display is not None and axis.mode is not None:
            self.shown, self.shown_place = axis.display.pdo, axis.display.position
        self._statusword = axis.statusword
        self._node = axis.node
        self._shown = axis.display
        self._by_sdo = StatuswordBySdo(axis)
        self._mode = ModeBySdo(axis) if None in (axis.mode, axis.display) else None
        self._blind_since: int | None = None
        self._holds_load = holds_load
        if holds_load:
            self._node.holds_load = True

    def update(self, now: int) -> None:
        """Update the statusword and the mode display from the latest TPDOs; read missing values by SDO."""
        pdo, shown = self.pdo, self._shown
        if not self._node.ready:
            self.word = self.display = None
            return
        word: object = None
        if pdo.stamp < 0:
            word = self._unseen(now)
        elif pdo.overdue:
            word = self._by_sdo.word(self._statusword.value, now)
        else:
            word = pdo.values[self.place]
        self.word = word  # type: ignore[assignment]  # mapped as an integer
        display: object = None
        if shown is not None and (showing := shown.pdo).stamp >= 0:
            display = showing.values[shown.position]
        if self._mode is not None and word is not None:
            self._mode.step(self._machine.mode_request.sent, now)
            display = self._mode.display if shown is None else display
        self.display = display  # type: ignore[assignment]  # mapped as an integer

    def _unseen(self, now: int) -> int | None:
        """Return the statusword, read by SDO, of a drive that has sent no TPDO since its boot.

        Without SYNCs the first TPDO has no due time, so that the statusword is read by SDO only if the end of a stop
        must be confirmed.
        """
        if self.pdo.overdue or self._machine.goal is not DriveGoal.ENABLED:
            return self._by_sdo.word(None, now)
        return None

    def blind_word(self, now: int) -> int:
        """Return the controlword for a drive without a statusword: quick stop, later disable voltage."""
        if self._blind_since is None:
            if self.pdo.stamp < 0:
                return 0  # no statusword since the boot: not started yet
            self._blind_since = now
        # CiA 402-2, table 22: disable voltage leads out of every powered state
        stopping = self._holds_load or now - self._blind_since < BLIND_STOP_NS
        return QUICK_STOP_WORD if stopping else 0

    def force_stop(self, phase: AxisPhase, now: int) -> str:
        """Write the controlword of an overdue stop by SDO, or send NMT stop as the last resort; return what is done.

        A drive under local control (statusword bit 9 is 0) need not obey, so it gets no NMT stop, and neither does a
        node while another of its axes is enabled. A drive may have switched its RPDOs off (bit 31 of 0x1400:01) while
        it shows OPERATION_ENABLED, and then receives no controlword and no target (ros2_canopen of Nature Robots, RPDO
        watchdog of 2026).
        """
        word = _FORCED_WORDS.get(phase)
        if word is not None:
            self.send(word)
        elif phase is AxisPhase.STOP_FAILED and self._machine.remote and not self._node.holds_load:
            if self._node.moves_axes:
                other = "NMT stop would stop the enabled axes of the node too, and is left to you"
                return f"{OVERDUE_TEXTS[phase]}; {other}: canopen-control nmt stop {self._node.name}"
            # CiA 402-2, 0x6007: the drive reacts to NMT STOPPED as to the loss of its master
            self._node.stop_as_last_resort(now)
            known = self._axis.has(objects.ABORT_CONNECTION_OPTION)
            reaction = "the drive reacts as its 0x6007 says" if known else "no object of the drive defines its reaction"
            return f"{OVERDUE_TEXTS[phase]}; NMT stop was sent, to which {reaction}"
        return OVERDUE_TEXTS[phase]

    def send(self, word: int) -> None:
        """Write a controlword by SDO, in addition to the RPDO, of which it is unknown whether it arrives.

        A drive that receives no SYNC applies no synchronous RPDO (CiA 301, 7.2.2.2), and sends no synchronous TPDO.
        """
        if self._node.ready:
            self._node.write(self._axis.index(objects.CONTROLWORD), 0, word.to_bytes(2, "little"))

    @property
    def mode_refusal(self) -> str:
        """Why the mode could not be written by SDO, or ""."""
        return "" if self._mode is None else self._mode.refusal

    @property
    def invisible(self) -> bool:
        """Whether the statusword is unobservable: no TPDO arrives, and the node aborts SDO uploads."""
        return self.word is None and self._by_sdo.refused

    def restart(self) -> None:
        """Stop the SDO uploads of the statusword, and forget when it went missing.

        Called when the node has become operational, and when its feedback has returned or become stale.
        """
        self._by_sdo.end()
        self._blind_since = None

    def node_lost(self, now: int) -> None:
        """Clear the SDO state after a node loss; the mode is written again after the next boot."""
        self._by_sdo.end()
        self._blind_since = now
        if self._mode is not None:
            self._mode.forget()


class StatuswordBySdo:
    """Statusword read by SDO while the TPDO with the statusword is missing."""

    def __init__(self, axis: AxisProcessData) -> None:
        self.refused = False
        """Whether the node has answered with an SDO abort, so that another request would also fail."""
        self._axis = axis
        self._value: int | None = None
        self._stamp = 0
        self._asking = False
        self._next = 0
        self._since: int | None = None

    def end(self) -> None:
        """Stop the SDO uploads because the TPDO has returned or the node was lost."""
        self._since = self._value = None
        self.refused = False

    def word(self, last: int | None, now: int) -> int | None:
        """Return the statusword, or None if unknown; `last`, from the TPDO, stays valid for `GRACE_NS`."""
        if self._since is None:
            self._since, self._next = now, now
        if not self._asking and now >= self._next:
            self._asking, self._next = True, now + POLL_NS
            self._axis.node.read(self._axis.index(objects.STATUSWORD), 0, lambda request: self._answered(request, now))
        if self._value is not None and now - self._stamp <= GRACE_NS:
            return self._value
        return last if now - self._since <= GRACE_NS else None

    def _answered(self, request: SdoRequest, requested_at: int) -> None:
        self._asking = False
        self.refused = self._since is not None and isinstance(request.error, SdoAbort)
        if request.error is None and self._since is not None:
            self._value, self._stamp = int.from_bytes(request.data[:2], "little"), requested_at


class ModeBySdo:
    """Access by SDO to 0x6060 and 0x6061, at least one of which is in no PDO."""

    def __init__(self, axis: AxisProcessData) -> None:
        self._axis = axis
        self.display: int | None = None
        self.refusal = ""
        """Why the last write of the mode failed, or "" if it did not."""
        self._written: int | None = None
        self._writing = self._asking = False
        self._next = self._next_write = 0

    def forget(self) -> None:
        """Discard the known mode after a node loss, so that the mode is written again."""
        self.display = self._written = None
        self.refusal = ""

    def step(self, mode: int | None, now: int) -> None:
        """Write a new mode to 0x6060 and read 0x6061 until the mode is shown; skip objects that are in PDOs."""
        node, axis = self._axis.node, self._axis
        if axis.mode is None:
            self._write(mode, now)
        # CiA 402-2, 0x6061: a requested mode is active when it is shown here
        mode_shown = mode is None or self.display == mode
        if axis.display is not None or mode_shown or self._asking or now < self._next:
            return
        self._asking, self._next = True, now + POLL_NS
        node.read(axis.index(objects.MODES_OF_OPERATION_DISPLAY), 0, self._answered)

    def _write(self, mode: int | None, now: int) -> None:
        """Write the mode unless the drive has accepted it since it was requested; repeat a failed write."""
        if mode is None:
            self._written = None  # the next request is written, even if it is for the same mode
        elif mode != self._written and not self._writing and now >= self._next_write:
            self._writing, self._next_write = True, now + _REWRITE_NS
            index, data = self._axis.index(objects.MODES_OF_OPERATION), mode.to_bytes(1, "little", signed=True)
            self._axis.node.write(index, 0, data, lambda request: self._accepted(request, mode))

    def _accepted(self, request: SdoRequest, mode: int) -> None:
        # CiA 402-2, 0x6060: a drive may refuse a mode in its present state (abort code 0x08000022)
        self._writing = False
        node = self._axis.node
        if request.error is None:
            self._written, self.refusal = mode, ""
        else:
            why = without_node(str(request.error), node.node_id, node.name)
            self.refusal = f"writing it failed: {why}"

    def _answered(self, request: SdoRequest) -> None:
        self._asking = False
        if request.error is None:
            self.display = int.from_bytes(request.data[:1], "little", signed=True)


class InterpolationBuffer:
    """Buffer of the set-points of mode IP (0x60C4): open only while the axis follows commands, else closed.

    Closing it also clears it: set-points that remained in it after a stop would move the axis at the next enable.
    `used` is False for a drive whose buffer neither bus.yml nor the drive opens; it is not written then. `refusal` is
    the reason why the last write failed, or "".
    """

    def __init__(self, axis: AxisProcessData) -> None:
        self.used = self.is_open = False
        self.refusal = ""
        self._axis = axis
        self._writing = False
        self._next_write = 0

    def booted(self, value: int | None) -> None:
        """Set the state after a boot; `value` is the drive's 0x60C4:06, None if it cannot be read."""
        axis, place = self._axis, (self._axis.index(objects.INTERPOLATION_BUFFER), _BUFFER_CLEAR)
        planned = [write.data for write in axis.node.plan.writes if (write.index, write.subindex) == place]
        self.used = self.is_open = value == 1 or planned[-1:] == [_OPEN]
        self._writing, self.refusal = False, ""

    def set(self, is_open: bool, now: int) -> bool:
        """Open or close the buffer if necessary; return whether that is done. A failed write is repeated."""
        if not self.used or (is_open is self.is_open and not self._writing):
            return True
        if self._writing or now < self._next_write:
            return False
        self._writing, self._next_write = True, now + _REWRITE_NS
        # CiA 402-2, 0x60C4:06 (buffer clear): 0 clears the buffer and ends the access to it, 1 permits the access
        index, data = self._axis.index(objects.INTERPOLATION_BUFFER), _OPEN if is_open else _CLOSED
        self._axis.node.write(index, _BUFFER_CLEAR, data, lambda request: self._written(request, is_open))
        return False

    def _written(self, request: SdoRequest, is_open: bool) -> None:
        self._writing = False
        if request.error is None:
            self.is_open, self.refusal, self._next_write = is_open, "", 0
        else:
            node = self._axis.node
            self.refusal = without_node(str(request.error), node.node_id, node.name)

    @property
    def failure(self) -> str:
        """Text about a failed write, or ""."""
        place = f"0x{self._axis.index(objects.INTERPOLATION_BUFFER):04X}:{_BUFFER_CLEAR:02X}"
        return self.refusal and (
            f"its buffer of set-points ({place}) could not be cleared or opened ({self.refusal}), so that it might use "
            f"old set-points; write 0 to this object under `sdo:` in bus.yml to run without the buffer"
        )


_BUFFER_CLEAR: Final = 6
_OPEN: Final = b"\x01"
_CLOSED: Final = b"\x00"
TORQUE_MAX: Final = (1 << 15) - 1
HELD: Final = 1.01  # a speed above the limit by less than this factor is due to rounding and not reported
REST: Final = 0.002  # rad (m): a position that is farther outside the limits is not due to noise at the limit
_POSITIONS: Final = (objects.TARGET_POSITION, objects.INTERPOLATION_DATA)
_WIDTHS: Final = (
    ((objects.CONTROLWORD, 0), 16),
    ((objects.STATUSWORD, 0), 16),
    ((objects.POSITION_ACTUAL, 0), 32),
    ((objects.TARGET_POSITION, 0), 32),
    ((objects.INTERPOLATION_DATA, 1), 32),
)
_TARGETS: Final = (
    (objects.TARGET_POSITION, 0),
    (objects.TARGET_VELOCITY, 0),
    (objects.TARGET_TORQUE, 0),
    (objects.VL_TARGET_VELOCITY, 0),
    (objects.INTERPOLATION_DATA, 1),
)


class AxisObjectLimits:
    """Limits of one axis in device units.

    `blocked` is the direction, 1 or -1, in which an active limit (statusword bit 11) forbids motion, 0 for none.
    `described` is the velocity limit of the description, or a lower limit for this run, in rad/s (m/s), infinite
    without a limit; `words` is its name in messages. The smaller of `described` and the drive's `velocity` applies:
    `most` in velocity units, `pace` in position counts per s. `held` is True if a target was reduced since the last
    check. `ramp_unbounded` means that the drive's own ramp of PP may exceed `described`.
    """

    __slots__ = (
        "blocked",
        "deceleration",
        "described",
        "held",
        "high",
        "low",
        "most",
        "pace",
        "ramp_unbounded",
        "torque_negative",
        "torque_positive",
        "velocity",
        "words",
    )

    def __init__(self) -> None:
        self.low, self.high = INT32_MIN, INT32_MAX
        self.velocity = self.most = self.pace = float(INT32_MAX)
        self.described = math.inf
        self.words = "the velocity limit of the description"
        self.held = self.ramp_unbounded = False
        self.torque_positive = self.torque_negative = TORQUE_MAX
        self.deceleration = math.inf
        self.blocked = 0

    def take_velocity(self, velocity: float, scale: Scale) -> None:
        """Set the drive's maximum velocity in device units, and compute the effective limits `most` and `pace`."""
        self.velocity = velocity
        self.most = min(velocity, self.described * abs(scale.vel_to_dev))
        self.pace = self.most * abs(scale.pos_to_dev / scale.vel_to_dev)

    def lower(self, speed: float, words: str) -> None:
        """Reduce `described` to `speed` in rad/s or m/s; takes effect at the next `take_velocity`."""
        if speed < self.described:
            self.described, self.words = speed, words

    def of_velocity(self, raw: int) -> int:
        """Limit a velocity target to the velocity limit; return 0 in a blocked direction."""
        return self.within(raw, self.most)

    def within(self, raw: int, most: float) -> int:
        """Limit a velocity to `most`, in the same units; return 0 in a blocked direction."""
        # CiA 402-2, 0x6041 bit 11 (internal limit active): no motion further into the limit
        if raw * self.blocked > 0:
            return 0
        if -most <= raw <= most:
            return raw
        self.held = self.held or abs(raw) > most * HELD
        return int(most) if raw > 0 else -int(most)

    def of_torque(self, raw: int) -> int:
        """Limit a torque target to 0x60E0 and 0x60E1; return 0 in a blocked direction."""
        if raw * self.blocked > 0:
            return 0
        return max(-self.torque_negative, min(self.torque_positive, raw))

    def of_position(self, raw: int) -> int:
        """Clamp a position target to the software position limits (0x607D)."""
        return max(self.low, min(self.high, raw))

    def excludes(self, raw: int, scale: Scale) -> bool:
        """Whether a position is outside the software position limits by more than `REST`."""
        return abs(raw - self.of_position(raw)) > REST * abs(scale.pos_to_dev)


class AxisProcessData:
    """Process data of axis `number` of a node; raises RobotConfigError if controlword or statusword is not in a PDO."""

    def __init__(self, joint: str, node: RemoteNode, image: ProcessImage, number: int) -> None:
        self.joint, self.node, self.number = joint, node, number
        self._image = image
        self.scale = configured_scale(node, number)
        self.unwrap = PositionUnwrapper(span=_planned_span(node, self.index(objects.POSITION_RANGE_LIMIT)))
        self.limits = AxisObjectLimits()
        self.rpm_to_dev = 60.0 / math.tau  # mode VL: 0x6042 is in revolutions of the motor per minute
        self.turn = abs(self.scale.pos_to_dev) * math.tau  # counts per revolution of the motor, else the joint
        self.label = node.label if len(node.plan.axes) <= 1 else f"{node.label}, {joint}"
        """Name of the node for messages, followed by the joint if the node has several axes."""
        self.out_of_range = math.nan  # the last target if it did not fit its object, else nan
        self.statusword = self._need_input(objects.STATUSWORD)
        self.controlword = self._need_output(objects.CONTROLWORD)
        self.display = self.input(objects.MODES_OF_OPERATION_DISPLAY)
        self.mode = self.output(objects.MODES_OF_OPERATION)
        self.position = self.input(objects.POSITION_ACTUAL)
        self.velocity = self.input(objects.VELOCITY_ACTUAL)
        self.effort = self.input(objects.TORQUE_ACTUAL)
        self.error_code = self.input(objects.ERROR_CODE)
        self.digital_inputs = self.input(objects.DIGITAL_INPUTS)
        self.digital_outputs = self.output(objects.DIGITAL_OUTPUTS, 1)
        self.velocity_offset = self.output(objects.VELOCITY_OFFSET)
        self.torque_offset = self.output(objects.TORQUE_OFFSET)

        self.own_modes = {
            mode: interface for mode, interface in self._modes_of_file() if node.config.motion.own_target(interface)
        }
        """Modes whose target object is set in bus.yml, and the command interface of each mode."""
        targets = {mode: node.config.motion.own_target(name) or (0, 0) for mode, name in self.own_modes.items()}
        self.target_objects = {**TARGET_OBJECTS, **targets}
        """Index and subindex of each mode's target on axis 0."""
        positions = {self.target_objects[mode] for mode, name in self.own_modes.items() if name == POSITION}
        outputs = dict.fromkeys((*_TARGETS, *targets.values()))
        self._require_widths()
        self._targets = [
            (index in _POSITIONS or (index, sub) in positions, out)
            for index, sub in outputs
            if (out := self.output(index, sub)) is not None
        ]
        offsets = self.velocity_offset, self.torque_offset
        for moving in (self.controlword, self.mode, *offsets, *(out for _, out in self._targets)):
            if moving is not None:
                moving.drive()

        feedback = (self.statusword, self.position, self.velocity)
        self._feedback = tuple({source.pdo: None for source in feedback if source is not None})

    @property
    def is_stale(self) -> bool:
        """Whether a TPDO with statusword, position or velocity is overdue."""
        return any(pdo.overdue for pdo in self._feedback)

    def hold(self, raw: int) -> None:
        """Set all position targets to the raw position, and all velocity and torque targets to 0."""
        for is_position, output in self._targets:
            output.set(raw if is_position else 0)

    def hold_others(self, used: Output) -> None:
        """Set all targets except `used` to the current position, or to 0 for velocity and torque."""
        raw = self.raw_position
        for is_position, output in self._targets:
            if output is not used:
                output.set(raw if is_position else 0)

    def _require_widths(self) -> None:
        """Raise RobotConfigError for a mapped object with fewer bits than in CiA 402."""
        positions = [self.target_objects[mode] for mode, name in self.own_modes.items() if name == POSITION]
        # CiA 402-2: 0x6040 and 0x6041 are UNSIGNED16, 0x6064, 0x607A and 0x60C1:01 are INTEGER32
        wide = dict.fromkeys((*_WIDTHS, *((address, 32) for address in positions)))
        for (index, subindex), least in wide:
            entry = self.node.od.get(self.index(index), subindex)
            mapped = self.input(index, subindex) is not None or self.output(index, subindex) is not None
            bits = None if entry is None else entry.data_type.bits
            if entry is not None and mapped and bits is not None and bits < least:
                raise RobotConfigError(
                    f"joint {self.joint}: 0x{entry.index:04X}:{subindex:02X} {entry.name} has {bits} bits in "
                    f"{self.node.plan.source}, but CiA 402 requires {least}; correct the EDS, or remove the object "
                    "from the mapping"
                )

    def _modes_of_file(self) -> list[tuple[int, str]]:
        """Return the modes of operation in bus.yml, each with its command interface."""
        keys = self.node.config.motion
        modes = ((keys.position_mode, POSITION), (keys.velocity_mode, VELOCITY), (keys.effort_mode, EFFORT))
        return [(mode_of(mode), interface) for mode, interface in modes if mode is not None]

    @property
    def raw_position(self) -> int:
        """Latest value of 0x6064 in counts, or 0 if no TPDO contains it.

        The last position of a lost node is kept, because a stop is still sent to it with a target at standstill; before
        the first TPDO the position is that of the boot.
        """
        position = self.position
        if position is None:
            return 0
        return position.pdo.values[position.position]  # type: ignore[return-value]  # same as `Input.value`, but faster

    def index(self, index: int) -> int:
        return objects.axis_index(index, self.number)

    def input(self, index: int, subindex: int = 0) -> Input | None:
        """Return the TPDO input of a profile object, or None if no TPDO contains the object."""
        return self._image.input(self.node.node_id, self.index(index), subindex)

    def output(self, index: int, subindex: int = 0) -> Output | None:
        """Return the RPDO output of a profile object, or None if no RPDO contains the object."""
        return self._image.output(self.node.node_id, self.index(index), subindex)

    def has(self, index: int, subindex: int = 0) -> bool:
        """Whether the EDS of the node has a profile object for this axis."""
        return (self.index(index), subindex) in self.node.od

    def _need_input(self, index: int) -> Input:
        if (signal := self.input(index)) is None:
            raise self._unmapped(index, "TPDO")
        return signal

    def _need_output(self, index: int) -> Output:
        if (output := self.output(index)) is None:
            raise self._unmapped(index, "RPDO")
        return output

    def _unmapped(self, index: int, kind: str) -> RobotConfigError:
        name = objects.object_name(self.index(index))
        if self.number and self.node.plan.motors is None and (self.index(index), 0) not in self.node.od:
            # CiA 402-2, 5.1: the objects of an axis are 0x800 above those of the axis before
            last = len(self.node.plan.axes) - 1
            return RobotConfigError(
                f"joint {self.joint}: {self.node.label} has no axis {self.number}, since 0x{self.index(index):04X} "
                f"{name} is not in its EDS; the device has {f'the axes 0 to {last}' if last > 0 else 'only axis 0'}"
            )
        return RobotConfigError(
            f"joint {self.joint}: no {kind} of {self.node.label} carries "
            f"0x{self.index(index):04X} {name}; map it in bus.yml"
        )


_SWITCHING: Final = {
    2: State.SWITCH_ON_DISABLED,
    3: State.READY_TO_SWITCH_ON,
    4: State.SWITCHED_ON,
    5: State.OPERATION_ENABLED,
}
"""States by their numbers in ros_canopen's `switching_state`."""


def configured_machine(node: RemoteNode) -> DriveMachine:
    """Return the drive's state machine with the timeouts and options of bus.yml."""
    motion = node.config.motion
    return DriveMachine(
        node.name,
        transition_timeout_ns=motion.transition_timeout_ms * 1_000_000,
        transition_timeouts={number: ms * 1_000_000 for number, ms in motion.transition_timeouts_ms.items()},
        mode_timeout_ns=motion.mode_timeout_ms * 1_000_000,
        fault_reset_timeout_ns=motion.fault_reset_timeout_ms * 1_000_000,
        ignore_remote=motion.ignore_remote,
        switching_state=_SWITCHING[motion.switching_state],
    )


def configured_scale(node: RemoteNode, axis: int) -> Scale:
    """Return the scale of an axis with the units of bus.yml."""
    return Scale(**node.config.units.of_axis(axis))


def _planned_span(node: RemoteNode, index: int) -> int:
    """Return the span of 0x607B in bus.yml or the EDS, which counts until the drive's own 0x607B is read."""
    written = {write.subindex: write.data for write in node.plan.writes if write.index == index}
    ends: list[int] = []
    for subindex in (1, 2):
        entry, data = node.od.get(index, subindex), written.get(subindex)
        value = int.from_bytes(data, "little", signed=True) if data is not None else entry and entry.value
        if not isinstance(value, int):
            return _WHOLE
        ends.append(value)
    return position_span(*ends)


def position_span(low: int, high: int) -> int:
    """Return the number of counts after which a drive's position wraps in the range 0x607B; 2**32 without a range.

    CiA 402-2, 0x607B: a position beyond one end of the range continues at the other end, as on a rotary table. Targets
    stay relative to the position, and the drive wraps them.
    """
    span = high - low + 1
    return span if 1 < span < _WHOLE - _EDGES else _WHOLE


_WHOLE: Final = 1 << 32
_EDGES: Final = 16
"""Drives leave out some values at the ends of the whole range, such as -2**31."""
