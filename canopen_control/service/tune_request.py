"""What a tuning run is asked for: the test, its excitation within the limits, and the words that are confirmed."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError
from canopen_control.service.excitation import LEAD_S, RAMP_S, Chirp, Prbs, Step
from canopen_control.service.frequency_response import HIGHEST
from canopen_control.service.jog_motion import JogKind
from canopen_control.service.loop_design import LOOP_DELAY_S
from canopen_control.service.tune_motion import STEERED

if TYPE_CHECKING:
    from canopen_control.service.excitation import Excitation
    from canopen_control.service.jog_motion import JogLimits
    from canopen_control.service.jog_units import JogScale, Quantity

__all__ = ["TuneRequest", "TuneTest"]

_BIAS, _AMPLITUDE = 1.5, 0.75  # rad/s, of a frequency response: it never turns round
_LOW_HZ: Final = 0.5
_BEYOND: Final = 1.15
_HOLD_CYCLES: Final = 5  # of a PRBS of torque
_SHORTEST: Final = 2.0 * RAMP_S + LEAD_S + 0.2


class TuneTest(enum.Enum):
    """What is measured."""

    STEP = "step"
    BODE = "frequency response"
    IDENTIFY = "identification"

    @property
    def seconds(self) -> float:
        """How long it takes where nobody says otherwise."""
        return 2.0 if self is TuneTest.STEP else 8.0


@dataclass(frozen=True, slots=True)
class TuneRequest:
    """A test: `speed` of a step, `torque` of an identification in per mille, `signal` of a frequency response.

    `period` of the cycle in s, `crossover` in rad/s, `margin` in rad, `loop_delay` in s are for the proposal.
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
        """What is commanded."""
        return JogKind.TORQUE if self.test is TuneTest.IDENTIFY else JogKind.VELOCITY

    @property
    def band(self) -> tuple[float, float]:
        """The frequencies of a frequency response, in Hz: a little beyond a third of the sampling rate."""
        return _LOW_HZ, _BEYOND * HIGHEST / self.period

    def height(self, scale: JogScale) -> float:
        """Return the step in rad/s."""
        assert self.speed is not None
        return scale.si(self.speed)

    def excitation(self, scale: JogScale) -> Excitation:
        """Return the signal."""
        if self.test is TuneTest.STEP:
            return Step(self.height(scale), self.seconds + LEAD_S)
        if self.test is TuneTest.IDENTIFY:
            return Prbs(self.torque / (1.0 + STEERED), _HOLD_CYCLES * self.period, self.seconds)
        if self.signal == "prbs":
            return Prbs(_AMPLITUDE, self.period, self.seconds, bias=_BIAS)
        return Chirp(_AMPLITUDE, _BIAS, *self.band, self.seconds)

    def check(self, limits: JogLimits, scale: JogScale) -> None:
        """Raise ConfigError for what is beyond the limits before it begins, or too short to tell anything."""
        if self.seconds < _SHORTEST:
            raise ConfigError(f"{self.seconds:g} s are too short for a {self.test.value}; {_SHORTEST:g} s at least")
        if self.kind is JogKind.TORQUE:
            if self.torque > limits.current:
                raise ConfigError(f"a torque of {self.torque:g} per mille is beyond --max-current {limits.current:g}")
            return
        peak = self.excitation(scale).peak
        if peak > limits.speed * (1 + 1e-9):
            words = scale.velocity_words
            raise ConfigError(
                f"{words(peak)} is beyond the limit of {words(limits.speed)}; raise that, if it is safe: --max-speed"
            )

    def words(self, scale: JogScale) -> str:
        """Say what will be commanded."""
        if self.test is TuneTest.STEP:
            return f"a step to {scale.velocity_words(self.height(scale))} for {self.seconds:g} s"
        if self.test is TuneTest.IDENTIFY:
            return f"a torque of up to {self.torque / 10:g} % of the rated one, both ways, for {self.seconds:g} s"
        around = f"{scale.velocity_words(_BIAS)} and {scale.velocity_words(_AMPLITUDE)} more or less"
        low, high = self.band
        what = f"a sine from {low:g} to {high:.3g} Hz" if self.signal == "chirp" else "a pseudo-random sequence"
        return f"{around}, as {what}, for {self.seconds:g} s"
