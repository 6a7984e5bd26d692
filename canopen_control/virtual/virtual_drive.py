"""One axis as a drive of CiA 402: power, modes, limits and motion on an object store, and what a write to it does.

Objects are written first and acted on afterwards, in this order: mode, controlword, set-points; so a PDO counts whole
before its controlword is looked at. Set-points are taken only in OPERATION_ENABLED while the node is OPERATIONAL.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.emcy_codes import ErrorRegister
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cia402 import objects as o
from canopen_control.cia402.loop_gains import LoopGain, gain_objects
from canopen_control.cia402.modes import mode_name, supported_modes
from canopen_control.cia402.options import OPTION_CODES, Reaction
from canopen_control.cia402.state import HALT_BIT, State, command_of
from canopen_control.rpc.messages.drive import AxisState, PlantState
from canopen_control.virtual.axis_limits import AxisLimits
from canopen_control.virtual.axis_objects import UNIT_OBJECTS, AxisObjects
from canopen_control.virtual.axis_readings import SOURCES, AxisReadings
from canopen_control.virtual.device_model import GENERIC, DeviceModel
from canopen_control.virtual.drive_modes import MODES, DriveModes, possible_modes
from canopen_control.virtual.mode_base import Axis
from canopen_control.virtual.mover import Mover
from canopen_control.virtual.overload import OVERLOAD, TORQUE_LIMITS, OverloadGuard
from canopen_control.virtual.plant import IdealPlant, Plant, ServoGains
from canopen_control.virtual.power_machine import PowerMachine
from canopen_control.virtual.set_point_meter import SetPointMeter
from canopen_control.virtual.touch_probes import TouchProbes

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.cia301.nmt import NmtSlave
    from canopen_control.cia402.loop_gains import GainObject
    from canopen_control.od.model import DataType, Entry, Value
    from canopen_control.virtual.node_outbox import Clock, NodeOutbox
    from canopen_control.virtual.object_store import ObjectStore
    from canopen_control.virtual.trajectory import Trajectory

__all__ = ["VirtualDrive"]

_OPTIONS = (o.QUICK_STOP_OPTION, o.SHUTDOWN_OPTION, o.DISABLE_OPERATION_OPTION, o.HALT_OPTION, o.FAULT_REACTION_OPTION)


class VirtualDrive:
    """Axis `axis` of a node; attaches itself to the objects of `store`.

    `shows_motion` says whether an event-driven TPDO waits for values that change with a motion. It is the `Motor` of
    its power state machine and takes the `Reactions` of its mover.
    """

    def __init__(
        self,
        axis: int,
        store: ObjectStore,
        outbox: NodeOutbox,
        clock: Clock,
        nmt: NmtSlave,
        *,
        plant: Plant | None = None,
        model: DeviceModel = GENERIC,
        shows_motion: Callable[[], bool],
    ) -> None:
        self.axis, self._store, self._outbox, self._clock = axis, store, outbox, clock
        self.wants_samples = shows_motion
        self.objects = objects = AxisObjects(store, axis, model)
        self.mover = mover = Mover(IdealPlant() if plant is None else plant, self)
        self.power: PowerMachine = PowerMachine(objects, mover, outbox, nmt, self)
        self.limits = AxisLimits(objects, mover, outbox, self.power)
        self.meter = SetPointMeter()
        self._overload = OverloadGuard()
        parts = Axis(objects, mover, self.power, self.limits, outbox, clock, self.meter)
        self.modes: DriveModes = DriveModes(parts)
        self.readings: AxisReadings = AxisReadings(parts, self.modes)
        self.probes = TouchProbes(objects, mover, outbox)
        self._mode_address = (o.MODES_OF_OPERATION + objects.offset, 0)
        self._values = store.values
        self._gains = gain_objects(store.od, axis)
        self._attach()

    @property
    def state(self) -> State:
        """The state of the power state machine."""
        return self.power.state

    def statusword(self) -> int:
        """Return 0x6041 at the time the drive was advanced to."""
        return self.readings.statusword.value()

    def describe(self) -> AxisState:
        """Return what the axis is doing, and its motor."""
        plant = self.mover.plant
        return AxisState(
            axis=self.axis,
            state=self.state.name,
            statusword=self.statusword(),
            controlword=self.power.controlword,
            mode=mode_name(self.modes.number),
            position=self.readings.position(),
            velocity=self.readings.velocity(),
            plant=PlantState(plant.position, plant.velocity, plant.torque),
            set_points=self.meter.tell(self.objects.units.velocity),
        )

    # -- objects

    def _attach(self) -> None:
        store, shift = self._store, self.objects.offset
        for index, source in SOURCES.items():
            self._show(index + shift, 0, partial(source, self.readings))
        for (index, subindex), shown in self.objects.model.display.items():
            self._show(index + shift, subindex, partial(shown, store))
        modes = store.od.get(o.SUPPORTED_DRIVE_MODES + shift)
        if modes is not None and not modes.value:  # a real drive knows what its maker did not write down
            store.preset(*modes.address, possible_modes(self.objects) & modes.data_type.maximum)
        store.guard([o.MODES_OF_OPERATION + shift], self._check_mode, by_values=True)
        store.guard([index + shift for index in _OPTIONS], self._check_option, by_values=True)
        controlword, objects = o.CONTROLWORD + shift, self.objects
        store.on_write([index + shift for index in UNIT_OBJECTS], lambda _entry, _value: objects.units.update(objects))
        store.on_write([o.TOUCH_PROBE_FUNCTION + shift], lambda _entry, _value: self.probes.update(self._clock.now))
        store.on_write([controlword], lambda _entry, _value: self.refresh(self._clock.now, controlword=True))
        store.on_write([index + shift for index in TORQUE_LIMITS], lambda _entry, _value: self._limit_torque())
        store.on_write([o.INTERPOLATION_DATA + shift], self._record_written)
        store.on_write({each.index for each in self._gains.values()}, lambda _entry, _value: self._tune())
        mine = {entry.index for entry in store.od if 0x6000 <= entry.index - shift < 0x6800} - {controlword}
        store.on_write(mine, lambda _entry, _value: self.refresh(self._clock.now))

    def _show(self, index: int, subindex: int, source: Callable[[], int]) -> None:
        entry = self._store.od.get(index, subindex)
        if entry is not None and (entry.data_type.is_integer or entry.data_type.is_real):
            self._store.on_read(index, subindex, self._reader(source, entry.data_type))

    def _reader(self, source: Callable[[], int], data_type: DataType) -> Callable[[], int]:
        low, high = (data_type.minimum, data_type.maximum) if data_type.is_integer else (-(1 << 31), 1 << 31)
        mover, clock = self.mover, self._clock

        def read() -> int:
            if mover.now != clock.now or mover.timers:
                mover.advance(clock.now)
            value = source()
            return low if value < low else high if value > high else value

        return read

    def _check_mode(self, _entry: Entry, value: Value) -> Value:
        listed = self.objects.number(o.SUPPORTED_DRIVE_MODES, default=-1)
        if value not in {0, *(MODES if listed == -1 else supported_modes(listed))}:
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        return value

    def _check_option(self, entry: Entry, value: Value) -> Value:
        if isinstance(value, int) and value >= 0 and value not in OPTION_CODES[entry.index - self.objects.offset]:
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        return value

    # -- what is written, and what happens

    def power_on(self, now: int) -> None:
        """Start as after power-on: transitions 0 and 1. The motor stands where it is, and that is position 0."""
        objects, power = self.objects, self.power
        self.mover.advance(now)
        self.mover.timers.clear()
        power.power_off(now)
        objects.units.zero = self.mover.plant.position
        power.controlword = 0
        self.readings.statusword.warning.heal()
        self.probes.reset()
        objects.units.update(objects)
        self._limit_torque()
        self._tune()
        self.modes.clear()
        power.enter(State.NOT_READY_TO_SWITCH_ON, now)
        power.enter(State.SWITCH_ON_DISABLED, now)
        self.modes.select(now)

    def refresh(self, now: int, *, controlword: bool = False, set_point: bool = False) -> None:
        """Act on objects that were written: mode, then controlword, then set-points.

        `set_point`: an RPDO brought that of the active mode.
        """
        self.mover.advance(now)
        if self.modes.number != self._values.get(self._mode_address, 0):
            self.modes.select(now)
        if controlword:
            self._control(now)
        if self.power.live:
            mode = self.modes.active
            mode.take(now) if set_point else mode.update(now)

    @property
    def set_point(self) -> int:
        """The object whose RPDOs are set-points of the active mode, 0: none."""
        return self.modes.active.set_point

    def set_point_received(self, now: int, *, overwrites: bool) -> None:
        """Note when an RPDO with a set-point arrived, and whether one is still waiting that it replaces."""
        if self.power.live:
            sync_ns = self._clock.sync_ns
            if sync_ns is not None:
                self.meter.received(now - sync_ns)
            self.meter.overwritten += overwrites

    def set_point_missed(self) -> None:
        """Note that a SYNC came without a set-point."""
        if self.power.live:
            self.modes.active.missed()

    def _limit_torque(self) -> None:
        """Let the loops have the torque that 0x6072 and 0x6073 allow; 0 is no limit."""
        limits = [float(limit) for index in TORQUE_LIMITS if (limit := self.objects.number(index)) > 0]
        self.mover.torque_limit = min(limits, default=math.inf)

    def _tune(self) -> None:
        """Give the loops the gains that the objects hold; without a P of velocity the drive has tuned itself."""
        values = {gain: self._gain(each) for gain, each in self._gains.items()}
        speed = self.objects.units.length
        proportional = values.get(LoopGain.VELOCITY_P, 0.0) / speed
        gains = ServoGains(
            proportional,
            values.get(LoopGain.VELOCITY_I, 0.0) / speed,
            values.get(LoopGain.POSITION_P, 0.0),
            values.get(LoopGain.VELOCITY_FEED_FORWARD, 0.0),
        )
        self.mover.set_loop(gains if proportional else None, self._clock.now)

    def _gain(self, place: GainObject) -> float:
        value = self._values.get((place.index, place.subindex), 0)
        return value * place.scale if isinstance(value, (int, float)) else 0.0

    def _record_written(self, entry: Entry, _value: Value) -> None:
        interpolated = self.modes.interpolated
        if self.modes.active is interpolated and entry.subindex == interpolated.buffer.last_subindex:
            interpolated.record_written(self._clock.now)

    def _control(self, now: int) -> None:
        power, mode = self.power, self.modes.active
        word, previous = self.objects.number(o.CONTROLWORD), power.controlword
        power.controlword = word
        before = power.state
        command = command_of(word, previous)
        if command is not None:
            power.obey(command, now)
        if power.running:
            power.halt(bool(word & HALT_BIT), now)
            if power.operational and before is State.OPERATION_ENABLED:
                mode.control(word, previous, now)
        elif not self.mover.powered:
            mode.control_unpowered(word, previous, now)
        if word != previous:
            self._outbox.values_changed()

    def fault(self, code: int, now: int, *, register: int = ErrorRegister.GENERIC, data: bytes = b"") -> None:
        """Let a fault occur: EMCY `code`, the stop that 0x605E says, FAULT."""
        self.power.fault(code, now, register=register, data=data)

    def set_inputs(self, bits: int, now: int) -> None:
        """Set the further bits of 0x60FD; bits 16 and 17 are the touch probes' inputs."""
        self.mover.advance(now)
        before, self.readings.inputs = self.readings.inputs, bits
        self.probes.inputs_changed(before, bits)
        self._outbox.values_changed()

    def connection_lost(self, now: int) -> None:
        """React to a lost heartbeat or guarding as 0x6007 says; without it 0x1029:01 decides, where that exists."""
        if self.objects.has(o.ABORT_CONNECTION_OPTION) or not self._store.has(0x1029, 1):
            self.power.abort_connection(0x8130, now)

    def communication_stopped(self, now: int) -> None:
        """React to NMT STOPPED or a reset of communication; without 0x6007 that is a fault of operation."""
        self.power.abort_connection(0x8100, now)

    # -- time

    def advance(self, now: int) -> None:
        """Bring the axis to `now`."""
        self.mover.advance(now)

    def next_deadline(self) -> int | None:
        """Return when something happens by itself, None: nothing will."""
        return self.mover.next_deadline()

    # -- the motor of the power state machine

    def start(self, now: int) -> None:
        """Let the active mode begin, from the present motion."""
        self.modes.active.start(now)

    def stop(self, now: int, reaction: Reaction) -> None:
        """Bring the motor to rest along the active mode's ramps."""
        self.modes.active.stop(now, reaction)

    def can_halt(self) -> bool:
        """Whether controlword bit 8 does anything in the active mode."""
        return self.modes.active.can_halt()

    def released(self) -> None:
        """Forget limits and set-points: the motor has no power."""
        self.limits.reset()
        self.modes.reset()

    # -- the reactions to the motion

    def arrived(self, now: int) -> None:
        """Go on at the end of a demand: into the state that a stop leads to, or as the mode says."""
        target = self.power.stop_target
        if target is not None:
            self.power.finish(target, now)
        elif self.power.running and not self.power.halted:
            self.limits.arrived(now)
            self.modes.active.arrived(now)
        self._outbox.values_changed()

    def limit_switch_hit(self, side: int, now: int) -> None:
        """Stop at a wired limit switch."""
        if self.power.running:
            self.limits.limit_switch_hit(side)
            self.stop(now, Reaction.QUICK_STOP_RAMP)

    def judge_following_error(self, error: float, now: int) -> None:
        """Judge a following error."""
        self.limits.judge_following_error(error, now)

    def judge_load(self, torque: float, now: int) -> None:
        """Judge the heat of a motor; too much of it is fault 0x2310."""
        if self._overload.exceeded(torque, now) and self.power.running:
            self.fault(OVERLOAD, now, register=ErrorRegister.GENERIC | ErrorRegister.CURRENT)

    def sampled(self) -> None:
        """Look at values that move with the motor."""
        self._outbox.values_changed()

    def next_index(self, demand: Trajectory, now: int) -> tuple[int, float] | None:
        """Return when and where a touch probe's index pulse comes."""
        return self.probes.next_index(demand, now)

    def index_passed(self, place: float) -> None:
        """Let the touch probes catch an index pulse."""
        self.probes.index_passed(place)
