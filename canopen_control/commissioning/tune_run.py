"""Loop of a tuning run: sends an excitation cycle by cycle and records the response.

As for a jog, commands expire when the connection ends, and `run` always requests a stop at the end and waits until the
drive is disabled. Samples have a cycle number, so that lost cycles are counted.
"""

from __future__ import annotations

import enum
import math
import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.cia402.objects import TORQUE_ACTUAL
from canopen_control.client import RobotClient
from canopen_control.commissioning.driven_axis import (
    ENABLE_S,
    AxisCommand,
    DriveCurrent,
    axis_reading,
    choose_mode,
    ended_words,
    stop_drive,
)
from canopen_control.commissioning.frequency_response import HIGHEST
from canopen_control.commissioning.jog_motion import BLIND_S, JogEnd, JogKind
from canopen_control.commissioning.tune_gains import LOOP_DELAY_S
from canopen_control.errors import ConfigError, DriveError
from canopen_control.rpc.messages.robot import AxisRequest, ProcessData, Subscribe
from canopen_control.rpc.messages.state import StateSample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.commissioning.driven_axis import JogDrive
    from canopen_control.commissioning.jog_motion import JogLimits
    from canopen_control.commissioning.quantity import JogScale, Quantity
    from canopen_control.rpc.messages.robot import RobotPush


# Command of a tuning run: an excitation within limits of travel, speed and current, and the reason of its end.
#
# Sans-IO; times are monotonic nanoseconds. The run ends by itself if the remaining travel is not longer than the
# stopping distance, above the speed limit, above the current limit for `PEAK_S`, with samples without feedback for
# `BLIND_S`, or when the drive is no longer enabled; the command is 0 then. Without a position the travel is computed
# from the velocity. A torque accelerates a free shaft without limit. Therefore an additional torque of `STEERED` times
# the peak pushes the shaft, alternately in both directions, which the identification of friction needs, and back as
# soon as half of the travel or of the speed limit is reached.


STEERED: Final = 0.6  # additional torque as a fraction of the peak of the excitation
PEAK_S: Final = 0.1  # time for which the current may exceed its limit, as at a step
_HALF: Final = 0.5


@dataclass(frozen=True, slots=True)
class TuneSample:
    """Sample of a cycle: cycle number, command, position (rad), velocity (rad/s) and torque (per mille)."""

    cycle: int
    command: float
    position: float | None = None
    velocity: float | None = None
    effort: float | None = None


@dataclass(slots=True)
class TuneRecord:
    """Samples of a run in order of time; `period` is in s, `lost` counts the cycles without a sample."""

    period: float
    samples: list[TuneSample] = field(default_factory=list)
    lost: int = 0

    def put(self, sample: TuneSample) -> None:
        """Append a sample of a later cycle; other samples are ignored."""
        last = self.samples[-1] if self.samples else None
        if last is not None:
            if sample.cycle <= last.cycle:
                return
            self.lost += sample.cycle - last.cycle - 1
        self.samples.append(sample)

    @property
    def begin(self) -> int:
        """Cycle number of the first sample, or 0 without samples."""
        return self.samples[0].cycle if self.samples else 0

    def seconds(self, sample: TuneSample) -> float:
        """Return the time in s from the first sample to this sample."""
        return (sample.cycle - self.begin) * self.period


class TuneMotion:
    """Motion of a shaft by an excitation; `kind` determines whether a velocity or a torque is commanded.

    The drive stops with `deceleration` in rad/s^2; 0 means that the stopping distance is neglected.
    """

    def __init__(
        self, kind: JogKind, excitation: Excitation, limits: JogLimits, *, now: int, deceleration: float = 0.0
    ) -> None:
        self.kind, self.limits = kind, limits
        self.ended = JogEnd.NONE
        self._excitation, self._begin, self._now = excitation, now, now
        self._deceleration = deceleration
        self._start: float | None = None
        self._travelled, self._speed = math.nan, 0.0
        self._push = 0.0
        self._too_much_since: int | None = None
        self._seen_at: int | None = None  # time of the last sample with a position or velocity, or of the first

    @property
    def command(self) -> float:
        """Command to send in rad/s or per mille of the rated torque; 0 after the end."""
        if self.ended is not JogEnd.NONE:
            return 0.0
        value = self._excitation.at((self._now - self._begin) * 1e-9)
        if self.kind is JogKind.TORQUE:
            value += self._push * STEERED * self._excitation.peak
        return value

    @property
    def elapsed(self) -> float:
        """Time in s since the start."""
        return (self._now - self._begin) * 1e-9

    @property
    def travelled(self) -> float:
        """Travel of the shaft from the start in rad; nan if unknown."""
        return self._travelled

    def tick(self, now: int) -> None:
        """Advance the time; end the run when the excitation is over."""
        self._now = now
        if now - self._begin >= self._excitation.seconds * 1e9:
            self.end(JogEnd.OVER)

    def see(self, position: float | None, velocity: float | None, current: float | None, *, enabled: bool) -> None:
        """Check measured values in rad, rad/s and per mille (None if unknown); end the run if a limit is exceeded."""
        if not enabled:
            self.end(JogEnd.STATE)
        self._check_current(current)
        before = self._now if self._seen_at is None else self._seen_at
        if velocity is not None and not math.isfinite(velocity):
            velocity = None
        if velocity is not None:
            self._speed = velocity
            if abs(velocity) > self.limits.speed:
                self.end(JogEnd.SPEED)
        if position is not None and math.isfinite(position):
            if self._start is None:
                self._start = position
            self._travelled = position - self._start
        elif velocity is not None:  # the travel of a drive without a position
            travelled = 0.0 if math.isnan(self._travelled) else self._travelled
            self._travelled = travelled + self._speed * (self._now - before) * 1e-9
        elif self._now - before > BLIND_S * 1e9:
            self.end(JogEnd.BLIND)
        else:
            self._seen_at = before
            return
        self._seen_at = self._now
        if abs(self._travelled) + self._stopping() >= self.limits.travel:  # False for nan
            self.end(JogEnd.TRAVEL)
        self._steer()

    def end(self, why: JogEnd) -> None:
        """End the commands with a reason; the first reason is kept."""
        if self.ended is JogEnd.NONE:
            self.ended = why

    def _check_current(self, current: float | None) -> None:
        if current is None or abs(current) <= self.limits.current:
            self._too_much_since = None
        elif self._too_much_since is None:
            self._too_much_since = self._now
        elif self._now - self._too_much_since > PEAK_S * 1e9:
            self.end(JogEnd.CURRENT)

    def _stopping(self) -> float:
        """Return the stopping distance in rad; 0 while the shaft moves towards the start."""
        if not self._deceleration or self._speed * self._travelled <= 0.0:
            return 0.0
        return self._speed * self._speed / (2.0 * self._deceleration)

    def _steer(self) -> None:
        """Choose the sign of the additional torque: alternating, but against a speed or travel above half its limit."""
        elapsed = (self._now - self._begin) * 1e-9 / self._excitation.seconds
        self._push = -1.0 if 0.25 <= elapsed < 0.75 else 1.0
        travel, speed = self._travelled / self.limits.travel, self._speed / self.limits.speed
        for share in (speed, 0.0 if math.isnan(travel) else travel):
            if abs(share) > _HALF:
                self._push = -math.copysign(1.0, share)


_SOURCE: Final = "tune"
_REMEDIES: Final = {
    JogEnd.CURRENT: "; use a weaker excitation, or raise --max-current if that is safe",
    JogEnd.SPEED: "; use a weaker excitation, or raise --max-speed if that is safe",
    JogEnd.BLIND: "; map 0x6064 or 0x606C in a TPDO",
    JogEnd.TRAVEL: "; use a shorter run (--for), or raise --max-travel if that is safe",
}
_WAIT_S: Final = 1.0  # timeout of the first sample
_SILENCE_S: Final = 0.3  # time without a sample after which the run ends


def _newest(client: RobotClient, timeout: float) -> Iterator[RobotPush]:
    """Wait for the next message until a timeout, then yield all received messages."""
    for message in client.messages(timeout):
        yield message
        break
    yield from client.messages(0)


class TuneRun:
    """Execution of one excitation on a drive; `run` returns the record.

    `progress` is called repeatedly with the elapsed seconds; if it raises, the drive is stopped and the error is passed
    on. `effort_unit` converts the joint's effort to per mille of the rated torque. If it is None, the torque is taken
    from the object `torque_index`, if a TPDO contains that object.
    """

    def __init__(
        self,
        drive: JogDrive,
        kind: JogKind,
        excitation: Excitation,
        limits: JogLimits,
        *,
        deceleration: float,
        effort_unit: float | None,
        progress: Callable[[float], object] = lambda _seconds: None,
        torque_index: int = TORQUE_ACTUAL,
    ) -> None:
        self._drive, self._kind, self._excitation = drive, kind, excitation
        self._limits, self._deceleration, self._effort_unit = limits, deceleration, effort_unit
        self._current = DriveCurrent(drive)
        self._sender = AxisCommand(drive, kind.value, _SOURCE)
        self._sample: StateSample | None = None
        self._left, self._has_torque = JogEnd.NONE, False
        self._report = progress
        self._torque_index = torque_index
        self._torque: float | None = None

    def run(self) -> TuneRecord:
        """Enable the drive, excite, stop and disable; raise DriveError if the run ended early, such as at a limit."""
        with RobotClient.connect(self._drive.robot) as client:
            try:
                motion, record = self._begin(client)
                self._move(client, motion, record)
            finally:
                stop_drive(client, self._drive, _SOURCE)
        if motion.ended is JogEnd.STATE:
            raise DriveError(f"{self._drive.joint}: {ended_words(self._sample, self._drive)}")
        if motion.ended is not JogEnd.OVER:
            raise DriveError(
                f"{motion.ended.value}: stopped and disabled; an incomplete run has no result"
                f"{_REMEDIES.get(motion.ended, '')}"
            )
        return record

    def leave(self, why: JogEnd = JogEnd.INTERRUPTED) -> None:
        """Request the end of the run with a reason: the drive is stopped and disabled, without a result."""
        self._left = why

    def _begin(self, client: RobotClient) -> tuple[TuneMotion, TuneRecord]:
        """Choose the mode and enable the drive; return the motion, whose time starts now, and an empty record."""
        node, joint = self._drive.node, self._drive.joint
        if self._drive.mode:
            choose_mode(
                client, AxisRequest(action="mode", node=node, joint=joint, mode=self._drive.mode, source=_SOURCE)
            )
        client.ask(Subscribe(state_rate=1000.0, pdos=self._effort_unit is None))  # every cycle
        period = self._first(client)
        client.ask(AxisRequest(action="enable", node=node, joint=joint, source=_SOURCE), ENABLE_S)
        for message in client.messages(0):  # queued messages from before the start
            if isinstance(message, ProcessData):
                self._take_torque(message)
        now = time.monotonic_ns()
        motion = TuneMotion(self._kind, self._excitation, self._limits, now=now, deceleration=self._deceleration)
        return motion, TuneRecord(period)

    def _first(self, client: RobotClient) -> float:
        """Return the cycle period in s from the first sample; raise DriveError if no sample arrives."""
        deadline = time.monotonic() + _WAIT_S
        while time.monotonic() < deadline:
            for message in client.messages(_WAIT_S):
                if isinstance(message, ProcessData):
                    self._take_torque(message)
                if isinstance(message, StateSample) and message.cycle.period_s:
                    return message.cycle.period_s
        raise DriveError(f"{self._drive.joint}: the robot reports no cycles")

    def _move(self, client: RobotClient, motion: TuneMotion, record: TuneRecord) -> None:
        last_sample = time.monotonic()
        while motion.ended is JogEnd.NONE:
            for message in _newest(client, record.period):
                if isinstance(message, StateSample):
                    last_sample = time.monotonic()
                    self._take(message, motion, record)
                elif isinstance(message, ProcessData):
                    self._take_torque(message)
            motion.tick(time.monotonic_ns())
            self._report(motion.elapsed)
            if time.monotonic() - last_sample > _SILENCE_S:
                motion.end(JogEnd.STATE)
            if self._left is not JogEnd.NONE:
                motion.end(self._left)
            self._command(client, motion)
        self._keep_torque(record)

    def _take_torque(self, data: ProcessData) -> None:
        """Remember the drive's torque if the process data contains it."""
        for mapped in data.nodes.get(self._drive.node, ()):
            if (mapped.index, mapped.subindex) == (self._torque_index, 0):
                self._torque = float(int.from_bytes(mapped.data, "little", signed=True))

    def _keep_torque(self, record: TuneRecord) -> None:
        if self._torque is not None and record.samples and record.samples[-1].effort is None:
            record.samples[-1] = replace(record.samples[-1], effort=self._torque)

    def _take(self, sample: StateSample, motion: TuneMotion, record: TuneRecord) -> None:
        """Check a sample against the limits and add it to the record."""
        self._sample = sample
        joint, axis = sample.joints.get(self._drive.joint), axis_reading(sample, self._drive)
        enabled = axis is None or axis.enabled
        if joint is None:
            motion.see(None, None, None, enabled=enabled)
            return
        unit = self._effort_unit
        self._keep_torque(record)
        effort = None if joint.effort is None or unit is None else joint.effort * unit
        torque = self._torque if effort is None else effort
        motion.see(joint.position, joint.velocity, self._current.value if torque is None else torque, enabled=enabled)
        cycle = sample.cycle.count + sample.cycle.missed
        record.put(TuneSample(cycle, joint.command or 0.0, joint.position, joint.velocity, effort))
        self._has_torque = torque is not None

    def _command(self, client: RobotClient, motion: TuneMotion) -> None:
        """Send the command; read the current by SDO if samples contain no torque."""
        if not self._has_torque:
            self._current.ask(client)
        if not self._sender.send(client, motion.command):
            motion.end(JogEnd.STATE)


# Excitation signals for tuning and identification: step, logarithmic chirp, pseudo-random binary sequence (PRBS).
#
# Sans-IO: a signal is a function of the seconds since its start, in the unit of the command (rad/s, or per mille of the
# rated torque). A chirp and a PRBS fade in and out over `RAMP_S`, so that neither begins nor ends with a jolt. All
# signals are zero at and after their end.


RAMP_S: Final = 0.2
LEAD_S: Final = 0.3  # standstill before a step, which gives the initial value
_TAPS: Final = {7: (7, 6), 8: (8, 6, 5, 4), 9: (9, 5), 10: (10, 7), 11: (11, 9)}
"""Feedback taps of shift registers, by number of bits, that generate the longest possible sequence, 2**bits - 1."""


class Excitation(Protocol):
    """Excitation signal as a function of time in s."""

    @property
    def seconds(self) -> float: ...

    @property
    def peak(self) -> float:
        """Maximum magnitude of the signal."""

    def at(self, seconds: float) -> float:
        """Return the value at a time in s after the start."""


@dataclass(frozen=True, slots=True)
class StepExcitation:
    """Step: zero for `LEAD_S`, then `height` until the end."""

    height: float
    seconds: float

    @property
    def peak(self) -> float:
        return abs(self.height)

    def at(self, seconds: float) -> float:
        return self.height if LEAD_S <= seconds < self.seconds else 0.0


@dataclass(frozen=True, slots=True)
class Chirp:
    """Sine of `amplitude` around `bias` whose frequency rises exponentially from `low` to `high` Hz.

    The bias keeps the motor turning in one direction, so that friction does not change its sign (Coulomb friction is
    not linear). Frequencies must be above 0.
    """

    amplitude: float
    bias: float
    low: float
    high: float
    seconds: float

    @property
    def peak(self) -> float:
        return abs(self.bias) + abs(self.amplitude)

    def at(self, seconds: float) -> float:
        span = self.seconds - 2.0 * RAMP_S
        rate = math.log(self.high / self.low) / span
        since = min(max(seconds - RAMP_S, 0.0), span)
        phase = math.tau * self.low * (math.expm1(rate * since) / rate if rate else since)
        return _envelope(seconds, self.seconds) * (self.bias + self.amplitude * math.sin(phase))


@dataclass(frozen=True, slots=True)
class Prbs:
    """Pseudo-random binary sequence around `bias` from a shift register of `bits` bits; a value lasts `hold` s."""

    amplitude: float
    hold: float
    seconds: float
    bits: int = 9
    bias: float = 0.0
    _sequence: tuple[int, ...] = field(init=False, repr=False, default=())

    def __post_init__(self) -> None:
        object.__setattr__(self, "_sequence", _maximum_length(self.bits))

    @property
    def peak(self) -> float:
        return abs(self.bias) + abs(self.amplitude)

    def at(self, seconds: float) -> float:
        if not 0.0 <= seconds < self.seconds:
            return 0.0
        bit = self._sequence[int(seconds / self.hold) % len(self._sequence)]
        return _envelope(seconds, self.seconds) * (self.bias + self.amplitude * bit)


def _envelope(seconds: float, length: float) -> float:
    """Return the factor of fade-in and fade-out, from 0 to 1, of a signal of `length` s."""
    return max(0.0, min(1.0, seconds / RAMP_S, (length - seconds) / RAMP_S))


def _maximum_length(bits: int) -> tuple[int, ...]:
    """Return one period of a shift register's sequence of 1 and -1; all bits are 1 at the start."""
    register, bits_out = [1] * bits, []
    for _ in range((1 << bits) - 1):
        bits_out.append(1 if register[-1] else -1)
        fed = 0
        for tap in _TAPS[bits]:
            fed ^= register[tap - 1]
        register = [fed, *register[:-1]]
    return tuple(bits_out)


MAX_TORQUE: Final = 300.0  # torque limit of an identification, in per mille of the rated torque
_BIAS, _AMPLITUDE = 1.5, 0.75  # rad/s; the direction of rotation does not change
_LOW_HZ: Final = 0.5
_BEYOND: Final = 1.15
_HOLD_CYCLES: Final = 5  # cycles per value of a torque PRBS
_SHORTEST: Final = 2.0 * RAMP_S + LEAD_S + 0.2


class TuneTest(enum.Enum):
    """Kinds of tuning tests; the values are texts for users."""

    STEP = "step"
    BODE = "frequency response"
    IDENTIFY = "identification"

    @property
    def seconds(self) -> float:
        """Default duration in s."""
        return 2.0 if self is TuneTest.STEP else 8.0


@dataclass(frozen=True, slots=True)
class TuneRequest:
    """Test to run: `speed` of a step, `torque` of an identification in per mille, `signal` of a frequency response.

    `period` is the cycle in s. `crossover` in rad/s, `margin` in rad and `loop_delay` in s are for the proposed gains.
    """

    test: TuneTest
    seconds: float
    period: float
    speed: Quantity | None = None
    torque: float = 0.0
    signal: str = "chirp"
    crossover: float = 20.0 * math.tau
    margin: float = math.pi / 3.0
    loop_delay: float = LOOP_DELAY_S

    @property
    def kind(self) -> JogKind:
        """Quantity that the test commands: a torque for an identification, else a velocity."""
        return JogKind.TORQUE if self.test is TuneTest.IDENTIFY else JogKind.VELOCITY

    @property
    def band(self) -> tuple[float, float]:
        """Lowest and highest frequency of a chirp in Hz; the latter is slightly above a third of the sampling rate."""
        return _LOW_HZ, _BEYOND * HIGHEST / self.period

    def height(self, scale: JogScale) -> float:
        """Return the height of a step in rad/s."""
        assert self.speed is not None
        return scale.si(self.speed)

    def excitation(self, scale: JogScale) -> Excitation:
        if self.test is TuneTest.STEP:
            return StepExcitation(self.height(scale), self.seconds + LEAD_S)
        if self.test is TuneTest.IDENTIFY:
            return Prbs(self.torque / (1.0 + STEERED), _HOLD_CYCLES * self.period, self.seconds)
        if self.signal == "prbs":
            return Prbs(_AMPLITUDE, self.period, self.seconds, bias=_BIAS)
        return Chirp(_AMPLITUDE, _BIAS, *self.band, self.seconds)

    def check(self, limits: JogLimits, scale: JogScale) -> None:
        """Raise ConfigError if the test exceeds the limits, or is too short to give a result."""
        if self.seconds < _SHORTEST:
            raise ConfigError(
                f"{self.seconds:g} s are too short for a {self.test.value}; at least {_SHORTEST:g} s are needed"
            )
        if self.kind is JogKind.TORQUE:
            if not 0.0 < self.torque <= MAX_TORQUE:
                raise ConfigError(f"a torque of {self.torque:g} per mille is not above 0 and at most {MAX_TORQUE:g}")
            if self.torque > limits.current:
                raise ConfigError(f"a torque of {self.torque:g} per mille exceeds --max-current {limits.current:g}")
            return
        peak = self.excitation(scale).peak
        if peak > limits.speed * (1 + 1e-9):
            words = scale.velocity_words
            raise ConfigError(
                f"{words(peak)} exceeds the limit of {words(limits.speed)}; raise --max-speed if that is safe"
            )

    def words(self, scale: JogScale) -> str:
        if self.test is TuneTest.STEP:
            return f"a step to {scale.velocity_words(self.height(scale))} for {self.seconds:g} s"
        if self.test is TuneTest.IDENTIFY:
            share = f"{self.torque / 10:g} % of the rated torque"
            return f"a torque of up to {share}, in both directions, for {self.seconds:g} s"
        around = f"{scale.velocity_words(_BIAS)} and {scale.velocity_words(_AMPLITUDE)} more or less"
        low, high = self.band
        signal = f"a sine from {low:g} to {high:.3g} Hz" if self.signal == "chirp" else "a pseudo-random sequence"
        return f"{around}, as {signal}, for {self.seconds:g} s"
