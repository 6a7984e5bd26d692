"""Frequency response by spectral estimation, with gain, phase and coherence, as a table with bars and as CSV.

H is the cross spectrum of input and output divided by the power spectrum of the input, each averaged over a band of
neighbouring frequencies (Daniell smoothing). The record is not windowed: an excitation that begins and ends at
standstill needs no window, and the edges of a window would show as a response. Where the coherence is below `TRUSTED`,
noise or friction dominates, and the band is left out. The result is the response of the sampled system: the input is
constant during a cycle, and the output is sampled at the end of the cycle.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from canopen_control.errors import DriveError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray


TRUSTED: Final = 0.9
HIGHEST: Final = 1.0 / 3.0  # highest frequency of a point, as a fraction of the sampling rate
_MIN_COUNT: Final = 100  # minimum number of samples
_BINS: Final = 5  # minimum number of bins in a band
_SHARE: Final = 0.06  # width of a band as a fraction of its frequency
_ROWS: Final = 16
_BAR: Final = 40
_MIN_SPAN: Final = 3.0  # minimum range of the bars in dB, so that noise on a flat response is not magnified


@dataclass(frozen=True, slots=True)
class BodePoint:
    """Frequency in Hz, gain in dB, unwrapped phase in degrees, and coherence from 0 to 1."""

    frequency: float
    gain: float
    phase: float
    coherence: float


@dataclass(frozen=True, slots=True)
class Bode:
    """Reliable points of a frequency response, in ascending order of frequency."""

    points: tuple[BodePoint, ...]

    def bandwidth(self) -> float | None:
        """Return the frequency in Hz at which the gain is 3 dB below the gain at the lowest frequency.

        None if the gain does not fall by 3 dB within the points.
        """
        level = self.points[0].gain - 3.0
        for before, after in pairwise(self.points):
            if after.gain <= level:
                share = (before.gain - level) / (before.gain - after.gain)
                return before.frequency * math.pow(after.frequency / before.frequency, share)
        return None


def filled(cycles: Sequence[int], values: Sequence[float]) -> list[float]:
    """Return a value for every cycle between the first and the last, with linear interpolation of missing values."""
    if not cycles:
        return []
    return [float(value) for value in np.interp(range(cycles[0], cycles[-1] + 1), cycles, values)]


def frequency_response(
    inputs: Sequence[float], outputs: Sequence[float], period: float, *, low: float = 0.0, high: float = math.inf
) -> Bode:
    """Estimate the response from `low` to `high` in Hz; raise DriveError if no point is reliable."""
    u, y = np.asarray(inputs, float), np.asarray(outputs, float)
    if len(u) < _MIN_COUNT:
        raise DriveError(f"{len(u)} samples are too few for a frequency response; excite the axis longer (--for S)")
    length = len(u) + len(u) // 8  # zero padding, so that the end does not wrap around to the start
    first, second = np.fft.rfft(u, length), np.fft.rfft(y, length)
    frequencies = np.fft.rfftfreq(length, period)
    top = min(high, HIGHEST / period)
    points = []
    for begin, end in _bands(frequencies, max(low, float(frequencies[1])), top):
        auto, answer, cross = (
            float((np.abs(first[begin:end]) ** 2).sum()),
            float((np.abs(second[begin:end]) ** 2).sum()),
            complex((np.conj(first[begin:end]) * second[begin:end]).sum()),
        )
        if not auto or not answer or abs(cross) ** 2 < TRUSTED * auto * answer:
            continue
        place = float((frequencies[begin:end] * np.abs(first[begin:end]) ** 2).sum()) / auto
        gain, phase = 20.0 * math.log10(abs(cross) / auto), math.degrees(cmath.phase(cross))
        points.append(BodePoint(place, gain, phase, min(1.0, abs(cross) ** 2 / (auto * answer))))
    if not points:
        raise DriveError(
            "no point of the frequency response is reliable (the coherence is below "
            f"{TRUSTED:g} everywhere): use a stronger or longer excitation, in one direction"
        )
    return Bode(tuple(_unwrapped(points)))


def _bands(frequencies: NDArray[np.floating], low: float, high: float) -> Iterator[tuple[int, int]]:
    """Yield consecutive bands of FFT bins as (begin, end); higher bands are wider."""
    begin = int(np.searchsorted(frequencies, low))
    last = int(np.searchsorted(frequencies, high, side="right"))
    while begin < last:
        width = max(_BINS, round(_SHARE * begin))
        end = min(begin + width, last)
        if end - begin > _BINS // 2:
            yield begin, end
        begin = end


def _unwrapped(points: Sequence[BodePoint]) -> Iterator[BodePoint]:
    last = points[0].phase
    for point in points:
        last += (point.phase - last + 180.0) % 360.0 - 180.0
        yield replace(point, phase=last)


def _thinned(bode: Bode, rows: int) -> list[BodePoint]:
    """Return at most `rows` points, at approximately constant frequency ratios."""
    points = bode.points
    low, high = points[0].frequency, points[-1].frequency
    if len(points) <= rows:
        return list(points)
    kept_points: dict[float, BodePoint] = {}
    for row in range(rows):
        place = low * (high / low) ** (row / (rows - 1))
        nearest = min(points, key=lambda point: abs(math.log(point.frequency / place)))
        kept_points[nearest.frequency] = nearest
    return list(kept_points.values())


def bode_lines(bode: Bode, rows: int = _ROWS) -> list[str]:
    """Return a table of at most `rows` points, with a bar for each gain."""
    points = _thinned(bode, rows)
    top, bottom = max(point.gain for point in points), min(point.gain for point in points)
    span = max(top - bottom, _MIN_SPAN)
    lines = [f"{'Hz':>8}  {'dB':>7}  {'degrees':>8}  coherence"]
    for point in points:
        bar = "#" * (_BAR - round((_BAR - 1) * (top - point.gain) / span))
        lines.append(f"{point.frequency:8.2f}  {point.gain:7.2f}  {point.phase:8.1f}  {point.coherence:9.2f}  {bar}")
    return lines


def bode_csv(bode: Bode) -> str:
    """Format all points as CSV."""
    rows = [f"{p.frequency:.6g},{p.gain:.6g},{p.phase:.6g},{p.coherence:.6g}" for p in bode.points]
    return "\n".join(["frequency_hz,gain_db,phase_deg,coherence", *rows]) + "\n"
