"""Parameters of a drive read by SDO after every boot: modes, limits, units, homing methods.

Only objects in the EDS are read, an abort means that the drive lacks the object, and the axis is `loaded` when every
read has ended; nothing is enabled before. Units of the drive (0x608F, 0x6091, 0x6092) are used only if bus.yml gives no
scale.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.units import INT32_MAX, INT32_MIN, Scale, counts_per_revolution, is_feed
from canopen_control.errors import ConfigError, SdoAbort
from canopen_control.hardware.axis import TORQUE_MAX, configured_scale
from canopen_control.od.codec import decode, encode

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.hardware.axis import AxisProcessData


_ASKED: Final = (
    (objects.SUPPORTED_DRIVE_MODES, (0,)),
    (objects.SOFTWARE_POSITION_LIMIT, (1, 2)),
    (objects.MAX_PROFILE_VELOCITY, (0,)),
    (objects.MAX_MOTOR_SPEED, (0,)),
    (objects.PROFILE_DECELERATION, (0,)),
    (objects.POSITIVE_TORQUE_LIMIT, (0,)),
    (objects.NEGATIVE_TORQUE_LIMIT, (0,)),
    (objects.POSITION_ENCODER_RESOLUTION, (1, 2)),
    (objects.GEAR_RATIO, (1, 2)),
    (objects.FEED_CONSTANT, (1, 2)),
    (objects.SUPPORTED_HOMING_METHODS, tuple(range(1, 40))),
)
_PROFILE: Final = ((objects.PROFILE_VELOCITY, (0,)), (objects.PROFILE_ACCELERATION, (0,)))
_HOMING_SPEEDS: Final = (1, 2)  # to the switch, and to the zero
_UNLIMITED: Final = 0xFFFFFFFF
# the values that the format itself takes where no scale is given
_NOT_GIVEN: Final = {"pos_to_dev": 1000.0, "pos_from_dev": 0.001, "vel_to_dev": 1000.0, "vel_from_dev": 0.001}


class AxisParameters:
    """Parameters of one axis; `on_loaded` is called after each `load`, `failed` lists objects without an answer.

    With `profile` the ramp is asked for too that the drive would make by itself (0x6081, 0x6083). `tell` takes what was
    found later, in a sentence.
    """

    def __init__(
        self,
        axis: AxisProcessData,
        on_loaded: Callable[[], None],
        report: Callable[[str], None] = lambda _text: None,
        *,
        profile: bool = False,
    ) -> None:
        self._asked = _ASKED + _PROFILE if profile else _ASKED
        self.loaded = False
        self.failed: list[str] = []
        self.values: dict[tuple[int, int], int] = {}
        self._axis, self._on_loaded, self._report = axis, on_loaded, report
        self._open = 0
        self._round = self._bounded_round = 0

    def load(self) -> None:
        """Read the parameters of a drive that has just booted."""
        axis = self._axis
        self.loaded, self.failed = False, []
        self._round += 1
        axis.limits.ramp_unbounded = axis.limits.described < math.inf
        addresses = [(index, sub) for index, subs in self._asked for sub in subs if axis.has(index, sub)]
        self._open = len(addresses)
        for index, subindex in addresses:
            axis.node.read(axis.index(index), subindex, self._answer(index, subindex, self._round))
        if not addresses:
            self._finish()

    def forget(self) -> None:
        """Discard the parameters of a drive that is gone; pending answers are ignored."""
        self.loaded = False
        self._round += 1

    def get(self, index: int, subindex: int = 0) -> int | None:
        """Return a value, None if the drive lacks it."""
        return self.values.get((index, subindex))

    @property
    def homing_methods(self) -> frozenset[int] | None:
        """Methods listed in 0x60E3, None for an empty list."""
        listed = [value for (index, _), value in self.values.items() if index == objects.SUPPORTED_HOMING_METHODS]
        return frozenset(listed) if listed else None

    def bound_ramp(self) -> None:
        """Reduce the drive's own ramp of PP (0x6081) to the velocity limit.

        No set-point is sent before; once per `load`.
        """
        axis, number = self._axis, self._round
        if not self.loaded or not axis.limits.ramp_unbounded or self._bounded_round == number:
            return
        self._bounded_round = number

        def settled(_bounded: bool, text: str) -> None:
            if number == self._round:
                axis.limits.ramp_unbounded = False
                self._tell_if(text)

        if axis.has(objects.PROFILE_VELOCITY):
            self._lower(objects.PROFILE_VELOCITY, 0, settled)
        else:
            settled(False, "its EDS has no 0x6081, so its moves in PP are as fast as the drive makes them")

    def bound_homing(self, done: Callable[[str], None]) -> None:
        """Reduce the homing speeds (0x6099) to the velocity limit.

        Then call `done` with "" or the reason of a failure.
        """
        axis = self._axis
        subindices = [sub for sub in _HOMING_SPEEDS if axis.has(objects.HOMING_SPEEDS, sub)]
        if axis.limits.described == math.inf:
            subindices = []
        elif not subindices:
            self._report(f"its EDS has no 0x{axis.index(objects.HOMING_SPEEDS):04X}, so it homes as fast as it does")

        def settled(bounded: bool, text: str) -> None:
            if not bounded:
                done(text)
                return
            self._tell_if(text)
            if subindices:
                self._lower(objects.HOMING_SPEEDS, subindices.pop(0), settled)
            else:
                done("")

        settled(True, "")

    def _lower(self, base: int, subindex: int, settled: Callable[[bool, str], None]) -> None:
        """Reduce a speed of the drive to the velocity limit.

        `settled` receives whether it is within, and the text to report. A profile velocity of 0 counts as none; a
        homing speed of 0 moves nothing.
        """
        axis, index = self._axis, self._axis.index(base)
        entry, words = axis.node.od[index, subindex], axis.limits.words
        place = f"0x{index:04X}" + (f":{subindex:02X}" if subindex else "")
        most = int(axis.limits.described * abs(axis.scale.vel_to_dev))

        def read(request: SdoRequest) -> None:
            if request.error is not None:
                settled(False, f"{place} was not read, so it may move faster than {words}: {request.error}")
                return
            limit = int.from_bytes(request.data, "little")
            if limit <= most and (limit or base != objects.PROFILE_VELOCITY):
                settled(True, "")
                return

            def written(done: SdoRequest) -> None:
                if done.error is not None:
                    settled(False, f"{place} stays {limit}, faster than {words}: {done.error}")
                    return
                if (output := axis.output(base, subindex)) is not None:
                    output.know(most)
                settled(True, f"{place} was {limit} and is {most} now, {words}")

            axis.node.write(index, subindex, encode(most, entry.data_type), written)

        axis.node.read(index, subindex, read)

    def _tell_if(self, text: str) -> None:
        if text:
            self._report(text)

    def _answer(self, index: int, subindex: int, number: int) -> Callable[[SdoRequest], None]:
        def answered(request: SdoRequest) -> None:
            if number == self._round:
                self._take(index, subindex, request)

        return answered

    def _take(self, index: int, subindex: int, request: SdoRequest) -> None:
        entry = self._axis.node.od.get(self._axis.index(index), subindex)
        if request.error is not None:
            self.values.pop((index, subindex), None)
            if not isinstance(request.error, SdoAbort):
                self.failed.append(str(request.error))
        elif entry is not None:
            try:
                value = decode(request.data, entry.data_type)
            except ValueError as error:
                self.failed.append(f"0x{request.index:04X}:{subindex:02X} {entry.name}: {error}")
            else:
                self.values[index, subindex] = value if isinstance(value, int) else 0
        self._open -= 1
        if self._open == 0:
            self._finish()

    def _finish(self) -> None:
        self._apply_scale()
        self._apply_limits()
        self.loaded = True
        self._on_loaded()

    def _pair(self, index: int) -> tuple[int, int] | None:
        first, second = self.get(index, 1), self.get(index, 2)
        return (first, second) if first and second and first > 0 and second > 0 else None

    def counts_per_turn(self) -> float | None:
        """Return the position units per revolution of the shaft, None if the drive does not give them."""
        encoder = self._pair(objects.POSITION_ENCODER_RESOLUTION)
        gear, feed = self._pair(objects.GEAR_RATIO) or (1, 1), self._pair(objects.FEED_CONSTANT)
        if encoder is None and feed is None:
            return None
        try:
            # A feed constant of one unit per turn is what drives without user units answer: it says nothing.
            return counts_per_revolution(encoder or (1, 1), gear, feed if feed not in (None, (1, 1)) else None)
        except ConfigError:
            return None

    def _apply_scale(self) -> None:
        axis, counts = self._axis, self.counts_per_turn()
        units = axis.node.config.units.of_axis(axis.number)
        if counts is None or any(units[name] != value for name, value in _NOT_GIVEN.items()):
            axis.scale = configured_scale(axis.node, axis.number)
        else:
            axis.scale = Scale.from_units(counts, eff_from_dev=units["eff_from_dev"])
        scale, turn = axis.scale, self._counts_of_motor()
        axis.turn = turn or abs(scale.pos_to_dev) * math.tau
        axis.rpm_to_dev = math.copysign(60.0 / math.tau, scale.vel_to_dev)
        if turn is not None:
            to_dev = scale.pos_to_dev if scale.pos_to_dev != _NOT_GIVEN["pos_to_dev"] else scale.vel_to_dev
            axis.rpm_to_dev = to_dev / turn * 60.0

    def _counts_of_motor(self) -> float | None:
        """Return the position units per motor revolution from drive or bus.yml; None without either."""
        encoder, gear = self._pair(objects.POSITION_ENCODER_RESOLUTION), self._pair(objects.GEAR_RATIO) or (1, 1)
        feed = self._pair(objects.FEED_CONSTANT)
        if feed is not None and is_feed(feed):
            return feed[0] / feed[1] * gear[1] / gear[0]
        if encoder is not None and is_feed(encoder):
            return encoder[0] / encoder[1]
        return self._axis.node.config.units.counts_per_revolution

    def _apply_limits(self) -> None:
        limits = self._axis.limits
        low, high = self.get(objects.SOFTWARE_POSITION_LIMIT, 1), self.get(objects.SOFTWARE_POSITION_LIMIT, 2)
        if low is not None and high is not None and low < high:
            limits.low, limits.high = low, high
        else:
            limits.low, limits.high = INT32_MIN, INT32_MAX
        limits.take_velocity(min(self._largest_velocity(), float(INT32_MAX)), self._axis.scale)
        limits.deceleration = self.get(objects.PROFILE_DECELERATION) or math.inf
        positive, negative = self.get(objects.POSITIVE_TORQUE_LIMIT), self.get(objects.NEGATIVE_TORQUE_LIMIT)
        limits.torque_positive = min(positive or TORQUE_MAX, TORQUE_MAX)
        limits.torque_negative = min(negative or TORQUE_MAX, TORQUE_MAX)

    def _largest_velocity(self) -> float:
        """Return the smaller of 0x607F and 0x6080 (in rpm of the motor); 0 and all ones mean no limit."""
        bounds = [math.inf]
        profile, motor = self.get(objects.MAX_PROFILE_VELOCITY), self.get(objects.MAX_MOTOR_SPEED)
        axis = self._axis
        if profile and profile < _UNLIMITED >> 1:
            bounds.append(profile)
        if motor and motor < _UNLIMITED >> 1 and self._counts_of_motor() is not None:
            bounds.append(motor * abs(axis.scale.vel_to_dev / axis.rpm_to_dev))
        return min(bounds)
