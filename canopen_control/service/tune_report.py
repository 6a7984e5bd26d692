"""What a tuning run has found: lines for people, a document (JSON), its record or frequency response as CSV or PNG."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError, DriveError
from canopen_control.host.files import write_whole
from canopen_control.service.frequency_response import bode_csv, bode_lines, filled, frequency_response
from canopen_control.service.loop_design import design_velocity_loop
from canopen_control.service.plant_model import identify_plant
from canopen_control.service.scope_files import plotted
from canopen_control.service.step_metrics import step_metrics
from canopen_control.service.tune_request import TuneTest

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from canopen_control.service.frequency_response import Bode
    from canopen_control.service.jog_units import JogScale
    from canopen_control.service.loop_design import LoopGains
    from canopen_control.service.plant_model import PlantModel
    from canopen_control.service.step_metrics import StepMetrics
    from canopen_control.service.tune_motion import TuneRecord, TuneSample
    from canopen_control.service.tune_request import TuneRequest

__all__ = ["CSV", "PICTURE", "Findings", "bode_of", "findings", "identified", "proposed", "report", "step_of"]

CSV, PICTURE = ".csv", ".png"


def report(record: TuneRecord, request: TuneRequest, scale: JogScale, output: Path | None) -> list[str]:
    """Return what it found; DriveError where the record tells nothing. A record is written before it is judged."""
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
            "velocity as commanded to velocity as measured; the phase has the way over the bus in it",
            *bode_lines(bode),
            f"bandwidth (-3 dB): {f'{bandwidth:.1f} Hz' if bandwidth is not None else 'beyond what was measured'}",
        ]
    return [*lines, *([] if output is None else [f"written: {output}"])]


@dataclass(frozen=True, slots=True)
class Findings:
    """What a test has found, for programs: rad/s, s, Hz, dB, degrees, torques in per mille; None for other tests.

    `no_gains` says why nothing is proposed; `velocity_i` is that of `gains`, `bandwidth` that of `bode`.
    """

    test: str
    period: float
    samples: int
    lost: int
    step: StepMetrics | None = None
    plant: PlantModel | None = None
    gains: LoopGains | None = None
    velocity_i: float | None = None
    no_gains: str | None = None
    bode: Bode | None = None
    bandwidth: float | None = None


def findings(record: TuneRecord, request: TuneRequest, scale: JogScale) -> Findings:
    """Return the same for programs; DriveError as `report`."""
    made = Findings(request.test.name.lower(), record.period, len(record.samples), record.lost)
    if request.test is TuneTest.STEP:
        return replace(made, step=step_of(record, request.height(scale)))
    if request.test is TuneTest.BODE:
        bode = bode_of(record, request)
        return replace(made, bode=bode, bandwidth=bode.bandwidth())
    plant = identified(record)
    try:
        gains = proposed(plant, request)
    except ConfigError as error:
        return replace(made, plant=plant, no_gains=str(error))
    return replace(made, plant=plant, gains=gains, velocity_i=gains.velocity_i)


def bode_picture(bode: Bode) -> bytes:
    """Draw gain and phase over the frequency, as PNG."""
    bandwidth = bode.bandwidth()
    frequencies = [point.frequency for point in bode.points]
    rows = [
        ("gain, dB", frequencies, [point.gain for point in bode.points]),
        ("phase, degrees", frequencies, [point.phase for point in bode.points]),
    ]
    return plotted(rows, "Hz", logarithmic=True, mark=bandwidth)


def record_picture(record: TuneRecord) -> bytes:
    """Draw what was commanded and measured over the time, as PNG."""
    times = [record.seconds(sample) for sample in record.samples]
    rows = [
        ("command", times, [sample.command for sample in record.samples]),
        ("rad/s", times, [math.nan if s.velocity is None else s.velocity for s in record.samples]),
        ("torque, per mille", times, [math.nan if s.effort is None else s.effort for s in record.samples]),
    ]
    return plotted(rows, "s")


def bode_of(record: TuneRecord, request: TuneRequest) -> Bode:
    """Return the frequency response of a record; DriveError where nothing of it can be trusted."""
    return frequency_response(*_pairs(record), record.period, low=request.band[0])


def _write(path: Path, content: bytes) -> None:
    try:
        write_whole(path, content)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror}") from None


def _pairs(record: TuneRecord) -> tuple[list[float], list[float]]:
    """Return what was commanded and measured in each cycle; one that was lost is between those around it."""
    cycles = [sample.cycle for sample in record.samples]
    commands, speeds = [sample.command for sample in record.samples], list(map(_speed, record.samples))
    return filled(cycles, commands), filled(cycles, speeds)


def _speed(sample: TuneSample) -> float:
    if sample.velocity is None:
        raise DriveError("no TPDO of the drive carries its velocity (0x606C), without which nothing can be judged")
    return sample.velocity


def step_of(record: TuneRecord, height: float) -> StepMetrics:
    """Measure the step of a record, whose beginning is the cycle that commanded it."""
    begin = next((sample for sample in record.samples if sample.command), None)
    if begin is None:
        raise DriveError("the step was never commanded")
    zero = record.seconds(begin)
    known = [
        sample
        for sample in record.samples
        if sample.velocity is not None and (sample.command or sample.cycle < begin.cycle)
    ]
    return step_metrics(
        [record.seconds(sample) - zero for sample in known], [sample.velocity or 0.0 for sample in known], height
    )


def step_lines(metrics: StepMetrics, scale: JogScale) -> Iterator[str]:
    """Yield the metrics of a step."""
    settled = "never" if metrics.settling is None else f"{metrics.settling * 1e3:.0f} ms"
    yield f"rise (10 to 90 %)   {metrics.rise * 1e3:.0f} ms, {metrics.delay * 1e3:.0f} ms after the command"
    yield f"overshoot           {metrics.overshoot:.1%}"
    yield f"settled to 2 %      {settled}"
    ripple = scale.velocity_words(metrics.ripple)
    yield f"steady-state error  {scale.velocity_words(metrics.error)}, ripple {ripple} rms"


def identified(record: TuneRecord) -> PlantModel:
    """Identify the plant of a record, by the torque that the drive tells, else by what was commanded."""
    told = all(sample.effort is not None for sample in record.samples)
    cycles = 1 + record.samples[-1].cycle - record.begin if record.samples else 0
    speeds, torques = [math.nan] * cycles, [math.nan] * cycles  # of a cycle that was lost
    for sample in record.samples:
        place = sample.cycle - record.begin
        speeds[place] = _speed(sample)
        torques[place] = sample.effort if told and sample.effort is not None else sample.command
    return identify_plant(torques, speeds, record.period)


def plant_lines(plant: PlantModel) -> Iterator[str]:
    """Yield what was identified, in per mille of the rated torque."""
    yield f"inertia             {plant.inertia:.4g} per mille s^2/rad"
    yield f"viscous friction    {plant.viscous:.4g} per mille s/rad"
    yield f"Coulomb friction    {plant.coulomb:.4g} per mille"
    yield f"constant load       {plant.load:.4g} per mille"
    yield f"the model explains  {plant.fit:.1%} of the changes of speed"


def proposed(plant: PlantModel, request: TuneRequest) -> LoopGains:
    """Return gains for what is wished."""
    return design_velocity_loop(plant, request.crossover, request.margin, request.loop_delay)


def proposal_lines(plant: PlantModel, request: TuneRequest) -> Iterator[str]:
    """Yield the proposal; a sentence where there is none."""
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
    """Return the record as CSV: s, rad, rad/s, per mille; what is not known is empty."""

    def text(value: float | None) -> str:
        return "" if value is None else f"{value:.9g}"

    rows = (
        ",".join((f"{record.seconds(s):.6f}", text(s.command), text(s.position), text(s.velocity), text(s.effort)))
        for s in record.samples
    )
    return "\n".join(["time_s,command,position_rad,velocity_rad_s,torque_permille", *rows]) + "\n"
