"""One axis as a drive of CiA 402: its objects, its motion, and what a write to them does.

The law of this file: objects are written first and acted on afterwards, in this order: mode, controlword, set-points;
so a PDO counts whole before its controlword is looked at. Set-points are taken only in OPERATION_ENABLED while the
node is OPERATIONAL. The states are `power`'s, the modes' motions the handlers', time and demand the mover's.

Positions inside are the plant's; the user's are smaller by `zero`, which homing moves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.emcy_codes import ErrorRegister
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import mode_name, supported_modes
from canopen_control.cia402.options import OPTION_CODES, Reaction
from canopen_control.cia402.state import (
    HALT_BIT,
    INTERNAL_LIMIT,
    REMOTE,
    TARGET_REACHED,
    VOLTAGE_ENABLED,
    WARNING,
    State,
    command_of,
)
from canopen_control.virtual.events import ModeChanged
from canopen_control.virtual.handler import Idle, ModeHandler
from canopen_control.virtual.limits import AxisLimits
from canopen_control.virtual.motion import INFINITE, ramp_to
from canopen_control.virtual.mover import Mover
from canopen_control.virtual.personality import GENERIC, Personality
from canopen_control.virtual.plant import IdealPlant, Plant
from canopen_control.virtual.power import PowerMachine
from canopen_control.virtual.probe import TouchProbes
from canopen_control.virtual.profiles import HANDLERS
from canopen_control.virtual.readings import SOURCES
from canopen_control.virtual.units import SOURCES_OF_UNITS, AxisUnits

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.od.model import DataType, Entry, Value
    from canopen_control.virtual.motion import Trajectory
    from canopen_control.virtual.node import VirtualNode

__all__ = ["VirtualDrive", "attach_drives"]

_MS = 1_000_000
_OPTIONS = (o.QUICK_STOP_OPTION, o.SHUTDOWN_OPTION, o.DISABLE_OPERATION_OPTION, o.HALT_OPTION, o.FAULT_REACTION_OPTION)


class VirtualDrive:
    """One axis of `node`; attaches itself to the node's objects.

    `inputs` are further bits of 0x60FD. Whoever injects faults uses `remote` (bit 9), `warning` (bit 7), what stands
    beside them in `__init__`, and `power`.
    """

    def __init__(
        self, node: VirtualNode, axis: int = 0, plant: Plant | None = None, personality: Personality = GENERIC
    ) -> None:
        self.node, self.axis, self.personality = node, axis, personality
        self.mover = Mover(IdealPlant() if plant is None else plant, self)
        self.limits = AxisLimits(self)
        self.power = PowerMachine(self)
        self.probes = TouchProbes(self)
        self.units: AxisUnits = AxisUnits()
        self.mode: int = 0
        self.controlword = self.inputs = 0
        self.zero = 0.0
        self.remote = True
        self.warning = self.mode_frozen = self.inverted = self.homing_fails = False
        self.mode_delay_ns = 0
        self.status_override: int | None = None
        self.status_set = self.status_clear = 0
        self.handlers: dict[int, ModeHandler] = {mode: make() for mode, make in HANDLERS.items()}
        self.handler: ModeHandler = Idle()
        self.offset = o.axis_index(o.CONTROLWORD, axis) - o.CONTROLWORD
        self._mode_address = (o.MODES_OF_OPERATION + self.offset, 0)
        self._values = node.store.values
        self._attach()

    # -- objects

    def number(self, index: int, subindex: int = 0, default: int = 0) -> int:
        """Return the value of an object of this axis, written for axis 0; `default` where it is absent."""
        value = self._values.get((index + self.offset, subindex), default)
        return value if isinstance(value, int) else default

    def has(self, index: int, subindex: int = 0) -> bool:
        """Whether this axis has an object, written for axis 0."""
        return (index + self.offset, subindex) in self._values

    def ramp(self, index: int) -> float:
        """Return an acceleration object in counts/s^2; the personality says what an absent one, or 0, means."""
        return self.number(index) * self.units.acceleration or self.personality.unset_ramp

    def speed(self, index: int, subindex: int = 0) -> float:
        """Return an object that holds a speed without direction, in counts/s."""
        return self.number(index, subindex) * self.units.speed

    def length(self, index: int) -> float:
        """Return an object that holds a distance without direction, in counts."""
        return self.number(index) * self.units.length

    @property
    def now(self) -> int:
        """The time the axis was brought to."""
        return self.mover.now or 0

    @property
    def live(self) -> bool:
        """Whether set-points move the motor: enabled, OPERATIONAL, not halted and not on a way out."""
        return self.power.running and not self.power.halted and self.node.operational

    @property
    def state(self) -> State:
        """The state of the power state machine."""
        return self.power.state

    @property
    def halted(self) -> bool:
        """Whether the halt bit holds the motor."""
        return self.power.halted

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
        word |= (VOLTAGE_ENABLED if self.power.voltage else 0) | (REMOTE if self.remote else 0)
        word |= (WARNING if self.warning else 0) | (INTERNAL_LIMIT if self.limits.active else 0)
        standing = TARGET_REACHED if self.mover.standing else 0
        if self.state is not State.OPERATION_ENABLED:
            return word | standing | self.handler.unpowered_bits(self)
        bits = self.handler.bits(self)
        return word | (bits & ~TARGET_REACHED | standing if self.power.halted else bits)

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
        store, shift = self.node.store, self.offset
        shown = {(index, 0): source for index, source in SOURCES.items()} | dict(self.personality.display)
        for (index, subindex), source in shown.items():
            entry = store.od.get(index + shift, subindex)
            if entry is not None and (entry.data_type.is_integer or entry.data_type.is_real):
                store.on_read(entry.index, subindex, self._reader(source, entry.data_type))
        store.guard([o.MODES_OF_OPERATION + shift], self._check_mode)
        store.guard([index + shift for index in _OPTIONS], self._check_option)
        controlword = o.CONTROLWORD + shift
        store.on_write([index + shift for index in SOURCES_OF_UNITS], lambda _entry, _value: self.units.update(self))
        store.on_write([o.TOUCH_PROBE_FUNCTION + shift], lambda _entry, _value: self.probes.update(self.node.now))
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
        if isinstance(value, int) and value >= 0 and value not in OPTION_CODES[entry.index - self.offset]:
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        return value

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
            deceleration = self.handler.quick_stop_deceleration(self)
        self.mover.run(ramp_to(now, position, velocity, 0.0, 0.0, deceleration), now)

    def arrived(self, now: int) -> None:
        """Go on at the end of a demand: into the state that a stop leads to, or as the mode says."""
        target = self.power.stop_target
        if target is not None:
            self.power.finish(target, now)
        elif self.power.running and not self.power.halted:
            self.limits.arrived(now)
            self.handler.arrived(self, now)
        self.touch()

    def touched(self, side: int, now: int) -> None:
        """Stop at a wired limit switch."""
        if self.power.running:
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

    def next_index(self, demand: Trajectory, now: int) -> tuple[int, float] | None:
        """Return when and where a touch probe's index pulse comes."""
        return self.probes.next_index(demand, now)

    def index_passed(self, place: float) -> None:
        """Let the touch probes catch an index pulse."""
        self.probes.index_passed(place)

    def set_inputs(self, bits: int, now: int) -> None:
        """Set the further bits of 0x60FD; bits 16 and 17 are the touch probes' inputs."""
        self.mover.advance(now)
        before, self.inputs = self.inputs, bits
        self.probes.inputs_changed(before, bits)
        self.touch()

    # -- what is written, and what happens

    def power_on(self, now: int) -> None:
        """Start as after power-on: transitions 0 and 1. The motor stands where it is, and that is position 0."""
        self.mover.advance(now)
        self.mover.timers.clear()
        self.power.power_off(now)
        self.zero = self.mover.plant.position
        self.controlword = 0
        self.warning = False
        self.probes.reset()
        self.units.update(self)
        self.mode, self.handler = 0, Idle()
        self.power.enter(State.NOT_READY_TO_SWITCH_ON, now)
        self.power.enter(State.SWITCH_ON_DISABLED, now)
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
            self.power.obey(command, now)
        if self.power.running:
            self.power.halt(bool(word & HALT_BIT), now)
            if self.node.operational and before is State.OPERATION_ENABLED:
                self.handler.control(self, word, previous, now)
        elif not self.mover.powered:
            self.handler.control_unpowered(self, word, previous, now)
        if word != previous:
            self.touch()

    def _select_mode(self, now: int) -> None:
        """Take 0x6060: at once in every state; in operation the new mode goes on from the present motion."""
        if self.mode_frozen:
            return
        if self.mode_delay_ns:
            if "mode" not in self.mover.timers:  # written again, it is still under way
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
        if self.power.running and not self.power.halted:
            self.handler.start(self, now)
        self.touch()

    # -- what goes wrong

    def fault(self, code: int, now: int, *, register: int = ErrorRegister.GENERIC, data: bytes = b"") -> None:
        """Transition 13: report `code`, stop as 0x605E says, then FAULT."""
        self.node.emergency(code, register, data)
        self.power.enter_fault(code, now)

    def connection_lost(self, now: int) -> None:
        """React to a lost heartbeat or guarding as 0x6007 says; without the object the axis goes on."""
        if self.has(o.ABORT_CONNECTION_OPTION):
            self.power.abort_connection(0x8130, now)

    def communication_stopped(self, now: int) -> None:
        """React to NMT STOPPED or a reset of communication; without 0x6007 that is a fault of operation."""
        self.power.abort_connection(0x8100, now)


def attach_drives(node: VirtualNode, plant: Callable[[int], Plant] | None = None) -> None:
    """Give `node` a drive on each axis that its dictionary has; `plant` makes the plant of an axis."""
    for axis in range(o.axis_count({entry.index for entry in node.od})):
        node.attach(VirtualDrive(node, axis, None if plant is None else plant(axis), node.personality))
