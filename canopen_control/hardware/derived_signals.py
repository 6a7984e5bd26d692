"""What several values of a device make together: the velocity of an encoder, the orientation of an inclinometer.

The velocity is the way between the two newest TPDOs by the time between them, and 0 when none comes for a while from a
device that sends when something changes. Two angles are no heading: the orientation is that of roll (`lateral`) and
pitch (`longitudinal`) with yaw 0, as a quaternion; rates and accelerations, which an IMU has, are nan.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.hardware.device_inputs import InputSignal
from canopen_control.hardware.interfaces import StateInterface
from canopen_control.profiles.device_type import Profile

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.hardware.device_inputs import NodeInputs, RawInput
    from canopen_control.profiles.device_signal import Signal

__all__ = ["DERIVED", "EncoderVelocity", "TiltOrientation"]

_ORIENTATION: Final = ("orientation.x", "orientation.y", "orientation.z", "orientation.w")
_ABSENT: Final = tuple(f"{what}.{axis}" for what in ("angular_velocity", "linear_acceleration") for axis in "xyz")
DERIVED: Final = {Profile.ENCODER: ("velocity",), Profile.INCLINOMETER: (*_ORIENTATION, *_ABSENT)}
"""Names of further state interfaces by profile."""

_STANDING_NS: Final = 50_000_000


class EncoderVelocity:
    """The velocity of an encoder's position, in its unit per second."""

    def __init__(self, state: StateInterface, signals: Mapping[str, Signal], inputs: NodeInputs) -> None:
        signal = signals["position"]
        self._state, self._raw = state, inputs.of(signal.address)
        self._position = InputSignal(signal, StateInterface(state.joint, "position of the velocity"), inputs)
        self._last = math.nan
        self._at = -1
        self._interval = 0

    def read(self, now: int) -> None:
        """Show the velocity at `now`."""
        self._position.read(now)
        position, raw = self._position.state.value, self._raw
        if math.isnan(position):
            self._state.value = self._last = math.nan
            return
        if raw.stamp != self._at:
            self._came(position, raw)
        elif now - self._at > max(_STANDING_NS, 2 * self._interval):
            self._state.value = 0.0

    def _came(self, position: float, raw: RawInput) -> None:
        self._interval = raw.stamp - self._at
        known = not math.isnan(self._last) and self._interval > 0
        self._state.value = (position - self._last) * 1e9 / self._interval if known else math.nan
        self._last, self._at = position, raw.stamp


class TiltOrientation:
    """One of the interfaces of an IMU, from the two angles of an inclinometer."""

    def __init__(self, state: StateInterface, signals: Mapping[str, Signal], inputs: NodeInputs) -> None:
        self._state = state
        self._angles = [
            InputSignal(signals[name], StateInterface(state.joint, f"{name} of {state.interface}"), inputs)
            for name in ("lateral", "longitudinal")
        ]

    def read(self, now: int) -> None:
        """Show it at `now`."""
        for angle in self._angles:
            angle.read(now)
        roll, pitch = (angle.state.value / 2 for angle in self._angles)
        name = self._state.interface
        if name == "orientation.x":
            self._state.value = math.sin(roll) * math.cos(pitch)
        elif name == "orientation.y":
            self._state.value = math.cos(roll) * math.sin(pitch)
        elif name == "orientation.z":
            self._state.value = -math.sin(roll) * math.sin(pitch)
        elif name == "orientation.w":
            self._state.value = math.cos(roll) * math.cos(pitch)
