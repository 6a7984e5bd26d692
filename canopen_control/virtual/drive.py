"""The drive's side of CiA 402-2: the power state machine of one axis.

The law of this file: a command is what the table of `cia402.state` makes of the controlword in the present state, and
it is evaluated at every write, after all other values of the same PDO. What a transition does is a row of
`_PERFORM`; how a stop is made is what the option code says. The motor has power in OPERATION_ENABLED,
QUICK_STOP_ACTIVE and FAULT_REACTION_ACTIVE only, and set-points are taken only in OPERATION_ENABLED while the node is
OPERATIONAL.

Positions inside are the plant's; the user's are smaller by `zero`, which homing moves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.emcy_codes import ErrorRegister
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import mode_name, supported_modes
from canopen_control.cia402.options import ABORT_CONNECTION, DEFAULTS, OPTION_CODES, Option, Reaction
from canopen_control.cia402.state import (
    HALT_BIT,
    INTERNAL_LIMIT,
    POWERED_STATES,
    REMOTE,
    TARGET_REACHED,
    VOLTAGE_ENABLED,
    WARNING,
    Command,
    State,
    Transition,
    command_of,
    transition_of,
)
from canopen_control.virtual.handler import Idle, ModeHandler
from canopen_control.virtual.limits import AxisLimits
from canopen_control.virtual.motion import INFINITE, ramp_to
from canopen_control.virtual.mover import Mover
from canopen_control.virtual.personality import GENERIC, Personality
from canopen_control.virtual.plant import IdealPlant, Plant
from canopen_control.virtual.profiles import HANDLERS
from canopen_control.virtual.readings import SOURCES

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.od.model import DataType, Entry, Value
    from canopen_control.virtual.node import VirtualNode

__all__ = ["DriveFaulted", "DriveStateChanged", "ModeChanged", "VirtualDrive"]

_MS = 1_000_000
_OPTIONS = (o.QUICK_STOP_OPTION, o.SHUTDOWN_OPTION, o.DISABLE_OPERATION_OPTION, o.HALT_OPTION, o.FAULT_REACTION_OPTION)


@dataclass(frozen=True, slots=True)
class DriveStateChanged:
    """The power state machine moved."""

    axis: int
    previous: State
    state: State


@dataclass(frozen=True, slots=True)
class DriveFaulted:
    """A fault occurred; `code` is its EMCY code."""

    axis: int
    code: int


@dataclass(frozen=True, slots=True)
class ModeChanged:
    """0x6061 shows another mode."""

    axis: int
    mode: int


class VirtualDrive:
    """One axis of `node`; attaches itself to the node's objects.

    Whoever injects faults uses `voltage` (the power stage has supply), `remote` (bit 9), `warning` (bit 7), `causes`
    (faults that cannot be reset yet) and what stands beside them in `__init__`. `inputs` are further bits of 0x60FD.
    """

    def __init__(
        self, node: VirtualNode, axis: int = 0, plant: Plant | None = None, personality: Personality = GENERIC
    ) -> None:
        self.node, self.axis, self.personality = node, axis, personality
        self.mover = Mover(IdealPlant() if plant is None else plant, self)
        self.limits = AxisLimits(self)
        self.state = State.NOT_READY_TO_SWITCH_ON
        self.mode: int = 0
        self.controlword = self.inputs = 0
        self.zero = 0.0
        self.voltage = self.remote = True
        self.causes: set[int] = set()
        self.warning = self.reset_deaf = self.mode_frozen = self.inverted = self.homing_fails = False
        self.extra_delay_ns = self.mode_delay_ns = 0  # of every transition, of 0x6060
        self.status_override: int | None = None
        self.status_set = self.status_clear = 0
        self.fault_on_enable = 0  # the code of a fault
        self.handlers: dict[int, ModeHandler] = {mode: make() for mode, make in HANDLERS.items()}
        self.handler: ModeHandler = Idle()
        self._offset = o.axis_index(o.CONTROLWORD, axis) - o.CONTROLWORD
        self._mode_address = (o.MODES_OF_OPERATION + self._offset, 0)
        self._stop_target: State | None = None  # a ramp ends in this state
        self._halted = False
        self._values = node.store.values
        self._attach()

    # -- objects

    def number(self, index: int, subindex: int = 0, default: int = 0) -> int:
        """Return the value of an object of this axis, written for axis 0; `default` where it is absent."""
        value = self._values.get((index + self._offset, subindex), default)
        return value if isinstance(value, int) else default

    def has(self, index: int, subindex: int = 0) -> bool:
        """Whether this axis has an object, written for axis 0."""
        return (index + self._offset, subindex) in self._values

    def ramp(self, index: int) -> float:
        """Return an acceleration object; the personality says what an absent one, or 0, means."""
        return float(self.number(index)) or self.personality.unset_ramp

    @property
    def now(self) -> int:
        """The time the axis was brought to."""
        return self.mover.now or 0

    @property
    def live(self) -> bool:
        """Whether set-points move the motor: enabled, OPERATIONAL, not halted and not on a way out."""
        return (
            self.state is State.OPERATION_ENABLED
            and self._stop_target is None
            and not self._halted
            and self.node.operational
        )

    @property
    def halted(self) -> bool:
        """Whether the halt bit holds the motor."""
        return self._halted

    @property
    def limited(self) -> bool:
        """Bit 11: a limit stopped the motion."""
        return self.limits.active

    @property
    def following_error(self) -> float:
        """0x60F4 in counts."""
        return self.limits.following_error

    @property
    def counts_per_rpm(self) -> float:
        """Counts per second at one revolution per minute."""
        counts = self.number(o.POSITION_ENCODER_RESOLUTION, 1) or self.personality.counts_per_revolution
        return counts / max(1, self.number(o.POSITION_ENCODER_RESOLUTION, 2, 1)) / 60.0

    @property
    def interpolation_s(self) -> float:
        """0x60C2 in seconds: the time between two set-points of a cyclic mode."""
        exponent = max(-9, min(1, self.number(o.INTERPOLATION_TIME_PERIOD, 2, -3)))
        return float(self.number(o.INTERPOLATION_TIME_PERIOD, 1, 1) * 10.0**exponent)

    def statusword(self) -> int:
        """Return 0x6041 at the time the drive was advanced to."""
        if self.status_override is not None:
            return self.status_override
        return (self._status() | self.status_set) & ~self.status_clear

    def _status(self) -> int:
        word = self.state.value | self.personality.status_bits(self)
        word |= (VOLTAGE_ENABLED if self.voltage else 0) | (REMOTE if self.remote else 0)
        word |= (WARNING if self.warning else 0) | (INTERNAL_LIMIT if self.limits.active else 0)
        standing = TARGET_REACHED if self.mover.standing else 0
        if self.state is not State.OPERATION_ENABLED:
            return word | standing
        bits = self.handler.bits(self)
        return word | (bits & ~TARGET_REACHED | standing if self._halted else bits)

    def describe(self) -> dict[str, object]:
        """Return the state for people and tests: plain values, JSON-able."""
        plant = self.mover.plant
        return {
            "axis": self.axis,
            "state": self.state.name,
            "statusword": self.statusword(),
            "controlword": self.controlword,
            "mode": mode_name(self.mode),
            "position": SOURCES[o.POSITION_ACTUAL](self),
            "velocity": SOURCES[o.VELOCITY_ACTUAL](self),
            "plant": {"position": plant.position, "velocity": plant.velocity, "torque": plant.torque},
        }

    def _attach(self) -> None:
        store, shift = self.node.store, self._offset
        shown = {(index, 0): source for index, source in SOURCES.items()} | dict(self.personality.display)
        for (index, subindex), source in shown.items():
            entry = store.od.get(index + shift, subindex)
            if entry is not None and (entry.data_type.is_integer or entry.data_type.is_real):
                store.on_read(entry.index, subindex, self._reader(source, entry.data_type))
        store.guard([o.MODES_OF_OPERATION + shift], self._check_mode)
        store.guard([index + shift for index in _OPTIONS], self._check_option)
        controlword = o.CONTROLWORD + shift
        store.on_write([controlword], lambda _entry, _value: self.refresh(self.node.now, controlword=True))
        mine = {entry.index for entry in store.od if 0x6000 <= entry.index - shift < 0x6800} - {controlword}
        store.on_write(mine, lambda _entry, _value: self.refresh(self.node.now))

    def _reader(self, source: Callable[[VirtualDrive], int], data_type: DataType) -> Callable[[], int]:
        low, high = (data_type.minimum, data_type.maximum) if data_type.is_integer else (-(1 << 31), 1 << 31)

        def read() -> int:
            self.mover.advance(self.node.now)
            return max(low, min(high, source(self)))

        return read

    def _check_mode(self, _entry: Entry, value: Value) -> Value:
        listed = self.number(o.SUPPORTED_DRIVE_MODES, default=-1)
        if value not in {0, *(HANDLERS if listed == -1 else supported_modes(listed))}:
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        return value

    def _check_option(self, entry: Entry, value: Value) -> Value:
        if isinstance(value, int) and value >= 0 and value not in OPTION_CODES[entry.index - self._offset]:
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        return value

    def _option(self, index: int) -> Option:
        """Return what an option code object says; a vendor's code is taken for the default."""
        codes = OPTION_CODES[index]
        return codes.get(self.number(index, default=DEFAULTS[index])) or codes[DEFAULTS[index]]

    # -- time and motion

    def advance(self, now: int) -> None:
        """Bring the axis to `now`."""
        self.mover.advance(now)

    def next_deadline(self) -> int | None:
        """Return when something happens by itself, None: nothing will."""
        return self.mover.next_deadline()

    def touch(self) -> None:
        """Say that values changed which nobody wrote."""
        self.node.touch()

    def stop(self, now: int, reaction: Reaction) -> None:
        """Bring the motor to rest as `reaction` says."""
        position, velocity = self.mover.state(now)
        deceleration = INFINITE
        if reaction is Reaction.SLOW_DOWN_RAMP:
            deceleration = self.handler.deceleration(self)
        elif reaction is Reaction.QUICK_STOP_RAMP:
            deceleration = self.ramp(o.QUICK_STOP_DECELERATION)
        self.mover.run(ramp_to(now, position, velocity, 0.0, 0.0, deceleration), now)

    def arrived(self, now: int) -> None:
        """Go on at the end of a demand: into the state that a stop leads to, or as the mode says."""
        target = self._stop_target
        if target is not None:
            self._finish(target, now)
        elif self.state is State.OPERATION_ENABLED and not self._halted:
            self.limits.arrived(now)
            self.handler.arrived(self, now)
        self.touch()

    def touched(self, side: int, now: int) -> None:
        """Stop at a wired limit switch."""
        if self.state is State.OPERATION_ENABLED and self._stop_target is None:
            self.limits.touched(side)
            self.stop(now, Reaction.QUICK_STOP_RAMP)

    def left_behind(self, error: float, now: int) -> None:
        """Judge a following error."""
        self.limits.left_behind(error, now)

    def sampled(self) -> None:
        """Look at values that move with the motor."""
        self.touch()

    def wants_samples(self) -> bool:
        """Whether an event-driven PDO shows them."""
        return self.node.has_event_pdos

    # -- the power state machine

    def power_on(self, now: int) -> None:
        """Start as after power-on: transitions 0 and 1. The motor stands where it is, and that is position 0."""
        self.mover.advance(now)
        self.mover.timers.clear()
        self._power_off(now)
        self.zero = self.mover.plant.position
        self.controlword = 0
        self.warning = False
        self.mode, self.handler = 0, Idle()
        self._enter(State.NOT_READY_TO_SWITCH_ON, now)
        self._enter(State.SWITCH_ON_DISABLED, now)
        self._select_mode(now)

    def refresh(self, now: int, *, controlword: bool = False) -> None:
        """Act on objects that were written: mode, then controlword, then set-points."""
        self.mover.advance(now)
        if self.mode != self._values.get(self._mode_address, 0):
            self._select_mode(now)
        if controlword:
            self._control(now)
        if self.live:
            self.handler.update(self, now)

    def _control(self, now: int) -> None:
        word, previous = self.number(o.CONTROLWORD), self.controlword
        self.controlword = word
        before = self.state
        command = command_of(word, previous)
        if command is not None:
            self._obey(command, now)
        if self.state is State.OPERATION_ENABLED and self._stop_target is None:
            self._halt(bool(word & HALT_BIT), now)
            if self.node.operational and before is State.OPERATION_ENABLED:
                self.handler.control(self, word, previous, now)
        if word != previous:
            self.touch()

    def _obey(self, command: Command, now: int) -> None:
        if "transition" in self.mover.timers and command is not Command.DISABLE_VOLTAGE:
            return  # under way; the controlword is looked at again when it is done
        transition = transition_of(self.state, command)
        if transition is not None:
            self._begin(transition, now)
        elif command is Command.ENABLE_OPERATION and self.state is State.READY_TO_SWITCH_ON:
            self._begin_from_ready(now)  # 3 and 4 in one write
        elif command is Command.ENABLE_OPERATION and self._stop_target is not None and self.node.operational:
            self._resume(now)

    def _begin_from_ready(self, now: int) -> None:
        transition = transition_of(State.READY_TO_SWITCH_ON, Command.SWITCH_ON)
        if transition is not None:
            self._begin(transition, now)

    def _resume(self, now: int) -> None:
        """Go on with the mode: enabled again on the ramp down of transition 5 or 8."""
        if self.state is State.OPERATION_ENABLED:
            self._stop_target = None
            self.handler.start(self, now)

    def _begin(self, transition: Transition, now: int) -> None:
        index = self.personality.delays.get(transition.number)
        delay = (self.number(index) * _MS if index else 0) + self.extra_delay_ns
        if delay and transition.target is not State.SWITCH_ON_DISABLED:
            self.mover.at("transition", now + delay, lambda then: self._perform(transition, then))
        else:
            self._perform(transition, now)

    def _perform(self, transition: Transition, now: int) -> None:
        before = self.state
        self._PERFORM.get(transition.number, VirtualDrive._plain)(self, transition, now)
        # A command that was held during a delay, or 0x0F in READY_TO_SWITCH_ON, goes on from here.
        command = command_of(self.controlword, self.controlword)
        if self.state is not before and self.state is State.SWITCHED_ON and command is Command.ENABLE_OPERATION:
            self._obey(command, now)

    def _plain(self, transition: Transition, now: int) -> None:
        self._enter(transition.target, now)

    def _enable(self, _transition: Transition, now: int) -> None:
        """Transition 4: only with supply, and only while set-points can come (NMT OPERATIONAL)."""
        if self.voltage and self.node.operational:
            self._stop_target, self._halted = None, False
            if not self.mover.powered:
                self.mover.power(True, now)
            self._enter(State.OPERATION_ENABLED, now)
            self._halted = bool(self.controlword & HALT_BIT) and self.handler.can_halt(self)
            self.handler.start(self, now)
            if self.fault_on_enable:
                self.fault(self.fault_on_enable, now)

    def _enable_again(self, transition: Transition, now: int) -> None:
        """Transition 16: from a quick stop that stays, 0x605A = 5 to 8."""
        if self._option(o.QUICK_STOP_OPTION).final_state is State.QUICK_STOP_ACTIVE:
            self._enable(transition, now)

    def _leave(self, transition: Transition, now: int) -> None:
        """Transitions 5 and 8: stop as the option code says, then the new state."""
        if self._stop_target is not transition.target:
            index = o.DISABLE_OPERATION_OPTION if transition.number == 5 else o.SHUTDOWN_OPTION
            self._stop_as(self._option(index).reaction, transition.target, now)

    def _quick_stop(self, _transition: Transition, now: int) -> None:
        """Transition 11: the state shows it at once, the option code says what follows."""
        option = self._option(o.QUICK_STOP_OPTION)
        self._enter(State.QUICK_STOP_ACTIVE, now)
        self._stop_as(option.reaction, option.final_state, now)

    def _reset_fault(self, transition: Transition, now: int) -> None:
        """Transition 15: only when every cause is gone."""
        if not self.causes and not self.reset_deaf:
            self.node.store.set(o.ERROR_CODE + self._offset, 0, 0)
            self._enter(transition.target, now)
            self.node.clear_errors()

    def _stop_as(self, reaction: Reaction, target: State, now: int) -> None:
        self.mover.cancel("transition")
        self._halted = False
        if reaction is Reaction.DISABLE:
            self._finish(target, now)
            return
        self._stop_target = target
        self.stop(now, reaction)

    def _finish(self, target: State, now: int) -> None:
        """End a stop: transition 5, 8, 14, or 12 by itself."""
        self._stop_target = None
        if target is not self.state:
            self._enter(target, now)

    def _enter(self, state: State, now: int) -> None:
        previous, self.state = self.state, state
        if previous in POWERED_STATES and state not in POWERED_STATES:
            self._power_off(now)
        if previous is not state:
            self.node.tell(DriveStateChanged(self.axis, previous, state))
            self.touch()

    def _power_off(self, now: int) -> None:
        self._stop_target, self._halted = None, False
        self.mover.cancel("transition", "homing", "window")
        self.mover.power(False, now)
        self.limits.reset()
        for handler in self.handlers.values():
            handler.reset()

    def _halt(self, wanted: bool, now: int) -> None:
        """Controlword bit 8, as 0x605D says; the mode goes on where it was."""
        if wanted == self._halted or (wanted and not self.handler.can_halt(self)):
            return
        self._halted = wanted
        if wanted:
            self.stop(now, self._option(o.HALT_OPTION).reaction)
        else:
            self.handler.start(self, now)

    def _select_mode(self, now: int) -> None:
        """Take 0x6060: at once in every state; in operation the new mode goes on from the present motion."""
        if self.mode_frozen:
            return
        if self.mode_delay_ns:
            self.mover.at("mode", now + self.mode_delay_ns, self._take_mode)
        else:
            self._take_mode(now)

    def _take_mode(self, now: int) -> None:
        mode = self.number(o.MODES_OF_OPERATION)
        if mode != self.mode:
            self.node.tell(ModeChanged(self.axis, mode))
        self.handler.reset()
        self.mover.cancel("homing", "window")
        self.mode, self.handler = mode, self.handlers.get(mode) or Idle()
        if self.state is State.OPERATION_ENABLED and self._stop_target is None and not self._halted:
            self.handler.start(self, now)
        self.touch()

    # -- what goes wrong

    def fault(self, code: int, now: int, *, register: int = ErrorRegister.GENERIC, data: bytes = b"") -> None:
        """Transition 13: report `code`, stop as 0x605E says, then FAULT."""
        self.node.emergency(code, register, data)
        self.enter_fault(code, now)

    def enter_fault(self, code: int, now: int) -> None:
        """Go to FAULT without an EMCY of its own; in a fault it only shows the newer code."""
        self.mover.advance(now)
        self.node.store.set(o.ERROR_CODE + self._offset, 0, code)
        if self.state in (State.FAULT_REACTION_ACTIVE, State.FAULT):
            return
        self.node.tell(DriveFaulted(self.axis, code))
        powered = self.state in POWERED_STATES and self.voltage
        self._enter(State.FAULT_REACTION_ACTIVE, now)
        if powered:
            self._stop_as(self._option(o.FAULT_REACTION_OPTION).reaction, State.FAULT, now)
        else:
            self._finish(State.FAULT, now)

    def lose_voltage(self, now: int) -> None:
        """Lose the supply of the power stage: every state above falls to SWITCH_ON_DISABLED, without a fault."""
        self.mover.advance(now)
        self.voltage = False
        self.mover.cancel("transition")
        if self.state not in (State.NOT_READY_TO_SWITCH_ON, State.FAULT_REACTION_ACTIVE, State.FAULT):
            self._enter(State.SWITCH_ON_DISABLED, now)
        self.touch()

    def connection_lost(self, now: int) -> None:
        """React to a lost heartbeat or guarding as 0x6007 says; without the object the axis goes on."""
        if self.has(o.ABORT_CONNECTION_OPTION):
            self._abort_connection(0x8130, now)

    def communication_stopped(self, now: int) -> None:
        """React to NMT STOPPED or a reset of communication; without 0x6007 that is a fault of operation."""
        self._abort_connection(0x8100, now)

    def _abort_connection(self, code: int, now: int) -> None:
        self.mover.advance(now)
        if self.state not in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
            return
        option = self.number(o.ABORT_CONNECTION_OPTION, default=DEFAULTS[o.ABORT_CONNECTION_OPTION])
        action = ABORT_CONNECTION.get(option, State.FAULT)
        if isinstance(action, Command):
            self._obey(action, now)
        elif action is not None:
            self.enter_fault(code, now)

    _PERFORM: ClassVar[dict[int, Callable[[VirtualDrive, Transition, int], None]]] = {
        4: _enable,
        5: _leave,
        8: _leave,
        11: _quick_stop,
        15: _reset_fault,
        16: _enable_again,
    }
    """Transition number to what it does; the others only change the state."""
