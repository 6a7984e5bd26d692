"""Controller gains of a drive: design, plant identification, writing to the drive, and reverting."""

from __future__ import annotations

import cmath
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from canopen_control.cia402.loop_gains import GainObject, LoopGain, gain_objects, gain_places
from canopen_control.commissioning.parameter_set import entry_label, read_values, value_text
from canopen_control.commissioning.restore import KeptParameters, Restore, refuse_moving, store
from canopen_control.errors import ConfigError, DriveError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.od.model import Address, Entry, ObjectDictionary, Value


# Gains that a tuning run writes to a drive, so that they can be reverted.
#
# The previous values are saved before the first change and kept until they are restored: gains that were set twice are
# reverted to the values before the first change. `Restore` writes, verifies and undoes a partial write.


@dataclass(frozen=True, slots=True)
class GainChange:
    """Old and new value of one gain object, as texts."""

    label: str
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.label}: {self.before} -> {self.after}"


def gain_values(
    od: ObjectDictionary, objects: Mapping[LoopGain, GainObject], gains: CascadeGains, units_per_rad: float
) -> dict[Address, Value]:
    """Return values for the gain objects; raise ConfigError for a gain that rounds to 0 or is out of range.

    `gains` refer to the shaft in rad; `units_per_rad` is the number of user units of 0x6064 in a rad.
    """
    values = {
        LoopGain.VELOCITY_P: gains.velocity_p / units_per_rad,
        LoopGain.VELOCITY_I: gains.velocity_i / units_per_rad,
        LoopGain.POSITION_P: gains.position_p,
        LoopGain.VELOCITY_FEED_FORWARD: 1.0,
    }
    return {
        (place.index, place.subindex): _raw(od[place.index, place.subindex], values[gain] / place.scale)
        for gain, place in objects.items()
    }


def _raw(entry: Entry, value: float) -> Value:
    if not entry.data_type.is_integer:
        return value
    number = round(value)
    low = entry.data_type.minimum if entry.low is None else entry.low
    high = entry.data_type.maximum if entry.high is None else entry.high
    if number == 0 or not low <= number <= high:
        raise ConfigError(
            f"{entry_label(entry)} would be {value:.4g}, outside of {max(1, low)} to {high}: the gain cannot be set "
            "with this scale; use another --crossover, or check --counts"
        )
    return number


def set_gains(session: NodeSession, values: Mapping[Address, Value], stored: KeptParameters) -> list[GainChange]:
    """Save the old gains, write new gains and verify them; raise DriveError if the drive is enabled or refuses."""
    refuse_moving(session)
    od = session.dictionary
    current, left_out = read_values(session, [od[address] for address in values])
    if left_out:
        raise DriveError(f"{session} does not allow to read its gains, so they could not be reverted: {left_out[0]}")
    stored.keep(od, {**current, **stored.read()})
    _write(session, values)
    return _changes(od, current, values)


def revert_gains(session: NodeSession, stored: KeptParameters) -> list[GainChange]:
    """Restore the gains stored by `set_gains`; raise DriveError if none are stored, or the drive refuses."""
    target = stored.read()
    if not target:
        raise DriveError(f"{session}: no gains of this drive were set from this computer, so nothing can be reverted")
    refuse_moving(session)
    od = session.dictionary
    current, _ = read_values(session, [od[address] for address in target if address in od])
    _write(session, target)
    stored.forget()
    return _changes(od, current, target)


def _changes(
    od: ObjectDictionary, current: Mapping[Address, Value], target: Mapping[Address, Value]
) -> list[GainChange]:
    return [
        GainChange(entry_label(od[address]), value_text(od[address], current[address]), value_text(od[address], value))
        for address, value in target.items()
    ]


def _write(session: NodeSession, values: Mapping[Address, Value]) -> None:
    restore = Restore(session, session.dictionary, values)
    if not restore.run():
        raise DriveError(f"{session} refused gains and is unchanged: {'; '.join(restore.refused)}")


# Design of the PI gains of a velocity loop for a phase margin, and of the P gain of the position loop around that loop.
#
# The plant is 1/(J s + B) with a dead time Td in the loop; the open loop has gain 1 at the crossover frequency with the
# requested phase margin. The computation uses phases only; if the controller needs an impossible phase, there is no PI
# solution and the crossover is too high for this dead time.


LOOP_DELAY_S: Final = 0.0005
"""Dead time in s of the velocity loop inside a drive, unless another value is known."""
_POSITION_SHARE: Final = 4.0  # ratio of the bandwidths of the velocity loop and the position loop


@dataclass(frozen=True, slots=True)
class CascadeGains:
    """Gains of a velocity loop (PI) and a position loop (P), with crossover in rad/s and phase margin in rad.

    `velocity_p` is in torque per rad/s, `reset` (Ti) in s, `position_p` in 1/s.
    """

    velocity_p: float
    reset: float
    position_p: float
    crossover: float
    margin: float

    @property
    def velocity_i(self) -> float:
        """Integral gain in torque per rad: the P gain divided by the reset time."""
        return self.velocity_p / self.reset


def design_velocity_loop(
    plant: PlantModel, crossover: float, margin: float, delay: float = LOOP_DELAY_S
) -> CascadeGains:
    """Return gains for a crossover in rad/s and a phase margin in rad.

    Raise ConfigError if a PI cannot achieve both.
    """
    viscous = max(0.0, plant.viscous)
    lag = -math.atan2(plant.inertia * crossover, viscous) - crossover * delay
    needed = margin - math.pi - lag
    if not -math.pi / 2.0 < needed < 0.0:
        raise ConfigError(_impossible(needed, crossover, margin, delay))
    reset = math.tan(needed + math.pi / 2.0) / crossover
    gain = abs(complex(viscous, plant.inertia * crossover)) / math.hypot(1.0, 1.0 / (crossover * reset))
    return CascadeGains(gain, reset, crossover / _POSITION_SHARE, crossover, margin)


def _impossible(needed: float, crossover: float, margin: float, delay: float) -> str:
    words = f"a crossover of {crossover / math.tau:.3g} Hz with a phase margin of {math.degrees(margin):.0f} degrees"
    if needed >= 0.0:
        return (
            f"no PI controller gives {words} at a dead time of {delay * 1e3:.3g} ms: use a lower "
            "--crossover or --phase-margin"
        )
    return f"{words} needs no P gain: use a larger --phase-margin, or a higher --crossover"


def phase_margin(plant: PlantModel, gains: CascadeGains, delay: float = LOOP_DELAY_S) -> tuple[float, float]:
    """Return the crossover in rad/s and the phase margin in rad of gains on a plant, for example with another load.

    The gain of the open loop falls monotonically, so bisection finds the crossover.
    """

    def loop(omega: float) -> complex:
        s = complex(0.0, omega)
        controller = gains.velocity_p * (1.0 + 1.0 / (gains.reset * s))
        return controller * cmath.exp(-s * delay) / (plant.inertia * s + max(0.0, plant.viscous))

    low, high = 1e-3, 1e6
    for _ in range(100):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if abs(loop(middle)) > 1.0 else (low, middle)
    lag = -math.atan2(plant.inertia * low, max(0.0, plant.viscous)) - low * delay
    return low, math.pi + lag - math.atan2(1.0, gains.reset * low)


# Identification of a motor with its load by least squares: inertia, viscous and Coulomb friction, constant load, dead
# time.
#
# The model is J dw/dt = u - B w - C sgn(w) + g, and its integral over each cycle is fitted. A torque is constant for a
# cycle, but the time of its change within the cycle is unknown. So the dead time is determined first, in steps of a
# quarter of a cycle, as the value with the least residual: ignoring one cycle of dead time would change the inertia by
# a quarter. Samples around standstill are left out, since there Coulomb friction is any torque up to C. Friction cannot
# be negative: if the fit would make a coefficient negative, as noise does on an axis without friction, the coefficient
# is 0 and the others are fitted without it. Units: u in per mille of the rated torque (or Nm), w in rad/s, so J in
# per mille s^2/rad (or kg m^2).


_MAX_DELAY: Final = 4.0  # longest dead time in cycles
_STEPS: Final = 4  # steps of the dead time per cycle
_STANDING: Final = 0.05  # fraction of the highest speed that counts as standstill
_MIN_COUNT: Final = 50
_VISCOUS, _COULOMB = 1, 2  # columns of the friction coefficients
_MODELS: Final = ([0, 1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 3])
"""Fitted columns: all, and subsets without a friction that would be negative; the last has no friction."""
_TRUSTED: Final = 0.7  # minimum fraction of the speed changes that the model must explain


@dataclass(frozen=True, slots=True)
class PlantModel:
    """Identified plant; `load` is g, `delay` is in s, `fit` is the explained fraction of speed changes (1 is all)."""

    inertia: float
    viscous: float
    coulomb: float
    load: float
    delay: float
    fit: float

    @property
    def time_constant(self) -> float:
        """Time constant J/B in s; infinite without viscous friction."""
        return self.inertia / self.viscous if self.viscous > 0.0 else math.inf

    def scaled(self, unit: float) -> PlantModel:
        """Return the model with torques in another unit, converted by the factor `unit`."""
        parts = (self.inertia * unit, self.viscous * unit, self.coulomb * unit, self.load * unit)
        return PlantModel(*parts, self.delay, self.fit)


def identify_plant(torque: Sequence[float], speed: Sequence[float], period: float) -> PlantModel:
    """Identify the plant from samples every `period` s; raise DriveError if they are unsuitable.

    An unknown sample is nan; it is left out, as are the following cycles in which its torque acts.
    """
    u, w = np.asarray(torque, float), np.asarray(speed, float)
    if len(w) < _MIN_COUNT:
        raise DriveError(f"{len(w)} samples are too few for an identification; excite the axis longer (--for S)")
    fastest = float(np.nanmax(np.abs(w)))
    if not fastest:
        raise DriveError(
            "the shaft did not move: the torque does not overcome the friction; use more torque, or free the shaft"
        )
    best: tuple[float, NDArray[np.floating], float, float] | None = None
    first = int(_MAX_DELAY) + 1
    for quarter in range(round(_MAX_DELAY * _STEPS) + 1):
        delay = quarter / _STEPS
        fitted = _fit(_delayed(u, delay, first), w, first, fastest, period)
        if best is None or fitted[1] < best[2]:
            best = delay, fitted[0], fitted[1], fitted[2]
    assert best is not None
    delay, parts, residual, power = best
    share = 1.0 - residual / power if power > 0.0 else 0.0
    if parts[0] <= 0.0 or share < _TRUSTED:
        raise DriveError(
            f"the model of a mass with friction does not explain the speed (only {share:.0%} of its changes): use a "
            "stronger excitation, and check that the shaft is free and that nothing else drives it"
        )
    inertia = 1.0 / parts[0]
    viscous, coulomb = abs(parts[_VISCOUS]) * inertia, abs(parts[_COULOMB]) * inertia
    return PlantModel(inertia, viscous, coulomb, parts[3] * inertia, delay * period, min(1.0, share))


def _delayed(u: NDArray[np.float64], delay: float, first: int) -> NDArray[np.float64]:
    """Return the mean torque between samples, from sample `first` on, delayed by `delay` cycles."""
    periods = int(delay)
    part = delay - periods
    late = u[first - periods : len(u) - periods]
    later = u[first - periods - 1 : len(u) - periods - 1]
    return (1.0 - part) * late + part * later


def _fit(
    u: NDArray[np.float64], w: NDArray[np.float64], first: int, fastest: float, period: float
) -> tuple[NDArray[np.floating], float, float]:
    """Return 1/J, -B/J, -C/J and g/J, and the sums of squares of the residual and of the speed changes.

    Raise DriveError if too few samples show motion, or motion in one direction only.
    """
    before, after = w[first - 1 : -1], w[first:]
    mean = 0.5 * (before + after)
    moving = np.minimum(np.abs(before), np.abs(after)) > _STANDING * fastest
    moving &= (before * after > 0.0) & np.isfinite(u)
    if int(moving.sum()) < _MIN_COUNT:
        raise DriveError(
            "the shaft hardly moved: the torque does not overcome the friction; use more torque, or free the shaft"
        )
    turned = np.sign(mean[moving])
    if int(min((turned > 0.0).sum(), (turned < 0.0).sum())) < _MIN_COUNT // 5:
        raise DriveError(
            "the shaft turned in one direction only, so friction and load cannot be distinguished: "
            "use a stronger excitation"
        )
    change = (after - before)[moving]
    allowed: list[tuple[NDArray[np.floating], float, float]] = []
    columns = period * np.column_stack([u[moving], mean[moving], turned, np.ones(len(change))])
    power = float(change @ change)
    for model in _MODELS:
        parts = np.zeros(columns.shape[1])
        parts[list(model)], _, _, _ = np.linalg.lstsq(columns[:, model], change, rcond=None)
        residual = change - columns @ parts
        if parts[_VISCOUS] <= 0.0 and parts[_COULOMB] <= 0.0:
            allowed.append((parts, float(residual @ residual), power))
            if model == _MODELS[0]:
                break
    return min(allowed, key=lambda fit: fit[1])


GAIN_NAMES: Final = {gain.name.lower(): gain for gain in LoopGain}
_GAIN: Final = re.compile(r"(\w+)=0x([0-9a-f]{1,4}):([0-9a-f]{1,2})\*(.+)", re.IGNORECASE)
_OF_SHAFT: Final = (LoopGain.VELOCITY_P, LoopGain.VELOCITY_I)


def parse_gain(text: str) -> tuple[LoopGain, GainObject]:
    """Parse `velocity_p=0x3210:01*0.001`, where 0.001 is the gain for a raw value of 1.

    Raise ConfigError for other texts.
    """
    match = _GAIN.fullmatch(text.strip())
    if match is None or match[1].lower() not in GAIN_NAMES:
        raise ConfigError(
            f"--gain {text}: give the gain, its object and the gain for a value of 1, as in "
            f"velocity_p=0x3210:01*0.001; the gains are {', '.join(GAIN_NAMES)}"
        )
    try:
        scale = float(match[4])
    except ValueError:
        scale = 0.0
    if not 0.0 < scale < float("inf"):
        raise ConfigError(f"--gain {text}: {match[4]!r} is not a scale; give a number above 0")
    return GAIN_NAMES[match[1].lower()], GainObject(int(match[2], 16), int(match[3], 16), scale)


def settable_gains(
    session: NodeSession, axis: int, named: Iterable[str], units_per_rad: float
) -> Mapping[LoopGain, GainObject]:
    """Return the gain objects of a drive, with `named` in place of known objects.

    Raise ConfigError if some are unknown. Scales in `named` refer to the shaft; `units_per_rad` is the number of user
    units per rad.
    """
    od = session.dictionary
    objects = gain_objects(od, axis)
    for gain, place in map(parse_gain, named):
        if (place.index, place.subindex) not in od:
            raise ConfigError(f"--gain: {session} has no 0x{place.index:04X}:{place.subindex:02X} in its EDS")
        scale = place.scale / units_per_rad if gain in _OF_SHAFT else place.scale
        objects[gain] = GainObject(place.index, place.subindex, scale)
    if missing := [gain.name.lower() for gain in _OF_SHAFT if gain not in objects]:
        if places := gain_places(od, axis):
            named_places = (
                f"--gain {gain.name.lower()}=0x{i:04X}:{sub:02X}*SCALE" for gain, (i, sub) in places.items()
            )
            names = ", ".join(f"{entry_label(od[place])} ({gain.name.lower()})" for gain, place in places.items())
            raise ConfigError(
                f"{session}: the manufacturer's gains are in {names}; the gain for a value of 1 is only in the manual, "
                f"so nothing is set without: {' '.join(named_places)}"
            )
        raise ConfigError(
            f"{session}: the objects of {' and '.join(missing)} are unknown, "
            "or the drive has no such loops (as a stepper); omit --apply, or give "
            "them: --gain velocity_p=0x3210:01*0.001"
        )
    return objects


@dataclass(frozen=True, slots=True)
class GainPlace:
    """Axis and its `named` gain objects; if `stores`, the gains are also saved in the drive (0x1010)."""

    axis: int = 0
    named: tuple[str, ...] = ()
    channel: str = ""
    stores: bool = False


def applied(session: NodeSession, gains: CascadeGains, units_per_rad: float, place: GainPlace) -> Iterator[str]:
    """Set the gains of an axis; yield a text for each change, and one on whether the drive has stored the gains."""
    objects = settable_gains(session, place.axis, place.named, units_per_rad)
    values = gain_values(session.dictionary, objects, gains, units_per_rad)
    yield from _change_lines(session, set_gains(session, values, _stored_gains(session, place)), place)


def reverted(session: NodeSession, place: GainPlace) -> Iterator[str]:
    """Revert the gains of an axis; yield a text for each change, and one on whether the drive has stored the gains."""
    yield from _change_lines(session, revert_gains(session, _stored_gains(session, place)), place)


def _stored_gains(session: NodeSession, place: GainPlace) -> KeptParameters:
    return KeptParameters("gains", session, session.identity(), place.channel)


def _change_lines(session: NodeSession, changes: Iterable[GainChange], place: GainPlace) -> Iterator[str]:
    yield from map(str, changes)
    if place.stores:
        store(session)
    yield f"{session}: {'stored' if place.stores else 'not stored: a power cycle undoes it'}"
