"""Results of a tuning run as text and as JSON, and the record or the frequency response as CSV or PNG."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from canopen_control.commissioning.frequency_response import bode_csv, bode_lines, filled, frequency_response
from canopen_control.commissioning.scope_capture import plotted
from canopen_control.commissioning.tune_gains import design_velocity_loop, identify_plant
from canopen_control.commissioning.tune_run import TuneTest
from canopen_control.errors import ConfigError, DriveError
from canopen_control.host.files import write_whole

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from canopen_control.commissioning.frequency_response import Bode
    from canopen_control.commissioning.quantity import JogScale
    from canopen_control.commissioning.tune_gains import CascadeGains, PlantModel
    from canopen_control.commissioning.tune_run import TuneRecord, TuneRequest, TuneSample


# Metrics of a step response: delay, rise time, overshoot, settling time, steady-state error, ripple, ITAE.
#
# The rise is from 10 to 90 % of the step; settling is into a band around the final value for the rest of the record;
# the final value is the mean of the last fifth. Times are seconds since the step was commanded, so they include the
# dead time of the bus; between two samples the response is interpolated linearly.


BAND: Final = 0.02  # settling band as a fraction of the step
_MIN_COUNT: Final = 10  # minimum number of samples after the step
_TAIL: Final = 5  # the last fifth of the record gives the final value
_MIN: Final = 0.2  # minimum fraction of the step in the response


@dataclass(frozen=True, slots=True)
class StepMetrics:
    """Metrics of a step to `target` that settled at `final`; times in s, `settling` is None if it did not settle.

    `overshoot` is a fraction of the reached step. In units of the response, `error` is the missing part of the step,
    and `ripple` the root mean square deviation from the final value. `itae` is the integral of time times absolute
    error, in units of the response times s^2.
    """

    target: float
    final: float
    delay: float
    rise_time: float
    overshoot: float
    settling: float | None
    error: float
    ripple: float
    itae: float


def step_metrics(times: Sequence[float], values: Sequence[float], target: float, *, band: float = BAND) -> StepMetrics:
    """Measure the response to a step to `target` at time 0; earlier samples give the initial value.

    Raise DriveError if there are too few samples, or the response does not follow the step.
    """
    before = [value for time, value in zip(times, values, strict=True) if time < 0.0]
    rows = [(time, value) for time, value in zip(times, values, strict=True) if time >= 0.0]
    if len(rows) < _MIN_COUNT:
        raise DriveError(f"{len(rows)} samples of the step are too few to measure it; use a longer step (--for S)")
    base = before[-1] if before else rows[0][1]
    tail = [value for _, value in rows[-max(1, len(rows) // _TAIL) :]]
    final = sum(tail) / len(tail)
    height = final - base
    if abs(height) < _MIN * abs(target - base) or height * (target - base) <= 0.0:
        raise DriveError(
            f"the drive did not follow the step: {target - base:g} was commanded, {height:g} was reached; "
            "check its limits, ramps and load"
        )
    shares = [(time, (value - base) / height) for time, value in rows]
    rise_begin, rise_end = _crossing(shares, 0.1), _crossing(shares, 0.9)
    return StepMetrics(
        target=target,
        final=final,
        delay=_crossing(shares, 0.05),
        rise_time=rise_end - rise_begin,
        overshoot=max(0.0, max(share for _, share in shares) - 1.0),
        settling=_settling(shares, band),
        error=target - final,
        ripple=math.sqrt(sum((value - final) ** 2 for value in tail) / len(tail)),
        itae=_itae(rows, target),
    )


def _crossing(shares: Sequence[tuple[float, float]], level: float) -> float:
    """Return the time at which the response first reaches a level, interpolated linearly."""
    last: tuple[float, float] | None = None
    for time, share in shares:
        if share >= level:
            if last is None or share == last[1]:
                return time
            return last[0] + (time - last[0]) * (level - last[1]) / (share - last[1])
        last = (time, share)
    return shares[-1][0]


def _settling(shares: Sequence[tuple[float, float]], band: float) -> float | None:
    """Return the time after which the response stays within the band, or None if it leaves the band near the end."""
    outside = [place for place, (_, share) in enumerate(shares) if abs(share - 1.0) > band]
    if not outside:
        return shares[0][0]
    place = outside[-1] + 1
    return None if place >= len(shares) - len(shares) // _TAIL else shares[place][0]


def _itae(rows: Sequence[tuple[float, float]], target: float) -> float:
    total = 0.0
    for (time, value), (after, next_value) in pairwise(rows):
        total += 0.5 * (after - time) * (time * abs(target - value) + after * abs(target - next_value))
    return total


CSV, PICTURE = ".csv", ".png"


def report(record: TuneRecord, request: TuneRequest, scale: JogScale, output: Path | None) -> list[str]:
    """Return the lines of the result, and write the output file, if any; raise DriveError if the record is unusable."""
    if output is not None and request.test is not TuneTest.BODE:
        _write(output, record_picture(record) if output.suffix == PICTURE else record_csv(record).encode())
    if request.test is TuneTest.STEP:
        lines = [*step_lines(step_of(record, request.height(scale)), scale)]
    elif request.test is TuneTest.IDENTIFY:
        plant = identified(record)
        lines = [*plant_lines(plant), *proposal_lines(plant, request)]
    else:
        bode = bode_of(record, request)
        if output is not None:
            _write(output, bode_picture(bode) if output.suffix == PICTURE else bode_csv(bode).encode())
        bandwidth = bode.bandwidth()
        lines = [
            "response of the measured to the commanded velocity; the phase includes the delay of the bus",
            *bode_lines(bode),
            f"bandwidth (-3 dB): {f'{bandwidth:.1f} Hz' if bandwidth is not None else 'above the measured range'}",
        ]
    return [*lines, *([] if output is None else [f"written: {output}"])]


@dataclass(frozen=True, slots=True)
class Findings:
    """Machine-readable results of a test in rad/s, s, Hz, dB, degrees and per mille of torque; None for other tests.

    `no_gains` is the reason why no gains are proposed; `velocity_i` belongs to `gains`, `bandwidth` to `bode`.
    """

    test: str
    period: float
    samples: int
    lost: int
    step: StepMetrics | None = None
    plant: PlantModel | None = None
    gains: CascadeGains | None = None
    velocity_i: float | None = None
    no_gains: str | None = None
    bode: Bode | None = None
    bandwidth: float | None = None


def findings(record: TuneRecord, request: TuneRequest, scale: JogScale) -> Findings:
    """Return the machine-readable results of a test; raise DriveError if the record is unusable."""
    result = Findings(request.test.name.lower(), record.period, len(record.samples), record.lost)
    if request.test is TuneTest.STEP:
        return replace(result, step=step_of(record, request.height(scale)))
    if request.test is TuneTest.BODE:
        bode = bode_of(record, request)
        return replace(result, bode=bode, bandwidth=bode.bandwidth())
    plant = identified(record)
    try:
        gains = proposed(plant, request)
    except ConfigError as error:
        return replace(result, plant=plant, no_gains=str(error))
    return replace(result, plant=plant, gains=gains, velocity_i=gains.velocity_i)


def bode_picture(bode: Bode) -> bytes:
    """Draw gain and phase over the frequency as a PNG."""
    bandwidth = bode.bandwidth()
    frequencies = [point.frequency for point in bode.points]
    rows = [
        ("gain, dB", frequencies, [point.gain for point in bode.points]),
        ("phase, degrees", frequencies, [point.phase for point in bode.points]),
    ]
    return plotted(rows, "Hz", logarithmic=True, mark=bandwidth)


def record_picture(record: TuneRecord) -> bytes:
    """Draw commanded and measured values over time as a PNG."""
    times = [record.seconds(sample) for sample in record.samples]
    rows = [
        ("command", times, [sample.command for sample in record.samples]),
        ("rad/s", times, [math.nan if s.velocity is None else s.velocity for s in record.samples]),
        ("torque, per mille", times, [math.nan if s.effort is None else s.effort for s in record.samples]),
    ]
    return plotted(rows, "s")


def bode_of(record: TuneRecord, request: TuneRequest) -> Bode:
    """Return the frequency response of a record; raise DriveError if no point is reliable."""
    return frequency_response(*_pairs(record), record.period, low=request.band[0])


def _write(path: Path, content: bytes) -> None:
    try:
        write_whole(path, content)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror}") from None


def _pairs(record: TuneRecord) -> tuple[list[float], list[float]]:
    """Return the commanded and the measured velocities of all cycles, with missing cycles interpolated linearly."""
    cycles = [sample.cycle for sample in record.samples]
    commands, speeds = [sample.command for sample in record.samples], list(map(_speed, record.samples))
    return filled(cycles, commands), filled(cycles, speeds)


def _speed(sample: TuneSample) -> float:
    if sample.velocity is None:
        raise DriveError("no TPDO of the drive contains its velocity (0x606C), which a result requires")
    return sample.velocity


def step_of(record: TuneRecord, height: float) -> StepMetrics:
    """Measure the step in a record from the cycle of its command on; raise DriveError if no step was commanded."""
    begin = next((sample for sample in record.samples if sample.command), None)
    if begin is None:
        raise DriveError("the step was never commanded")
    zero = record.seconds(begin)
    samples = [
        sample
        for sample in record.samples
        if sample.velocity is not None and (sample.command or sample.cycle < begin.cycle)
    ]
    return step_metrics(
        [record.seconds(sample) - zero for sample in samples], [sample.velocity or 0.0 for sample in samples], height
    )


def step_lines(metrics: StepMetrics, scale: JogScale) -> Iterator[str]:
    """Format the metrics of a step."""
    settled = "never" if metrics.settling is None else f"{metrics.settling * 1e3:.0f} ms"
    yield f"rise (10 to 90 %)   {metrics.rise_time * 1e3:.0f} ms, {metrics.delay * 1e3:.0f} ms after the command"
    yield f"overshoot           {metrics.overshoot:.1%}"
    yield f"settled to 2 %      {settled}"
    ripple = scale.velocity_words(metrics.ripple)
    yield f"steady-state error  {scale.velocity_words(metrics.error)}, ripple {ripple} rms"


def identified(record: TuneRecord) -> PlantModel:
    """Identify the plant from the measured torque if all samples have it, else from the commanded torque."""
    has_effort = all(sample.effort is not None for sample in record.samples)
    cycles = 1 + record.samples[-1].cycle - record.begin if record.samples else 0
    speeds, torques = [math.nan] * cycles, [math.nan] * cycles  # nan for a lost cycle
    for sample in record.samples:
        place = sample.cycle - record.begin
        speeds[place] = _speed(sample)
        torques[place] = sample.effort if has_effort and sample.effort is not None else sample.command
    return identify_plant(torques, speeds, record.period)


def plant_lines(plant: PlantModel) -> Iterator[str]:
    """Format the identified plant, in per mille of the rated torque."""
    yield f"inertia             {plant.inertia:.4g} per mille s^2/rad"
    yield f"viscous friction    {plant.viscous:.4g} per mille s/rad"
    yield f"Coulomb friction    {plant.coulomb:.4g} per mille"
    yield f"constant load       {plant.load:.4g} per mille"
    yield f"the model explains  {plant.fit:.1%} of the changes of speed"


def proposed(plant: PlantModel, request: TuneRequest) -> CascadeGains:
    """Return gains for the requested crossover and phase margin; raise ConfigError if none exist."""
    return design_velocity_loop(plant, request.crossover, request.margin, request.loop_delay)


def proposal_lines(plant: PlantModel, request: TuneRequest) -> Iterator[str]:
    """Format the proposed gains, or the reason why none exist."""
    try:
        gains = proposed(plant, request)
    except ConfigError as error:
        yield f"no proposal: {error}"
        return
    yield (
        f"for a crossover of {gains.crossover / math.tau:.3g} Hz and a phase margin of "
        f"{math.degrees(gains.margin):.0f} degrees, at {request.loop_delay * 1e3:.3g} ms dead time of the drive's loop:"
    )
    yield f"velocity P          {gains.velocity_p:.4g} per mille s/rad"
    yield f"velocity I          {gains.velocity_i:.4g} per mille/rad (reset time {gains.reset * 1e3:.3g} ms)"
    yield f"position P          {gains.position_p:.4g} 1/s, velocity feed-forward 1"


def record_csv(record: TuneRecord) -> str:
    """Format the record as CSV in s, rad, rad/s and per mille; unknown values are empty."""

    def text(value: float | None) -> str:
        return "" if value is None else f"{value:.9g}"

    rows = (
        ",".join((f"{record.seconds(s):.6f}", text(s.command), text(s.position), text(s.velocity), text(s.effort)))
        for s in record.samples
    )
    return "\n".join(["time_s,command,position_rad,velocity_rad_s,torque_permille", *rows]) + "\n"
