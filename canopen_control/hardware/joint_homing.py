"""Homing of one axis, from the request to the return to the previous mode (CiA 402-2, mode HM).

The method is checked against the drive's list before anything is written. Homing may enable the drive, because a user
requested the motion; afterwards mode and power are restored. Bit 4 is 0 at every exit, and only a homing run whose
success was observed makes the axis homed. The joint calls `step` in every cycle and applies the result.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.homing import (
    METHODS_WITHOUT_MOTION,
    HomingDone,
    HomingPosition,
    HomingSequence,
    require_method,
)
from canopen_control.cia402.modes import OperationMode
from canopen_control.errors import DriveError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.hardware.axis_parameters import AxisParameters


_SETTLED: Final = 0.01  # rad or m: a position that changes less after homing has settled
_NEAR: Final = 0.1  # rad or m: distance in which a drive stops after it has found its home position


class HomingPhase(enum.Enum):
    """Phase of homing; each value is a description in words."""

    METHOD = "the method is being written, and the speeds are being limited"
    KNOWN = "method and speeds are set; the drive can be enabled in mode HM"
    ENABLE = "the drive is being enabled in mode HM"
    RUN = "homing"
    HOMED = "ended: the drive has found its zero"
    FAILED = "ended without success"


class JointHoming:
    """Homing in progress; `result` is None until the end, then "" or the reason for a failure.

    `mode_before` and `was_enabled` are restored afterwards. Raises DriveError for a method that is not in `methods`,
    the drive's list (None: no list). `bound` reduces the homing speeds to the velocity limit, and calls back with "" or
    the reason why that failed; then homing is refused.
    """

    def __init__(
        self,
        axis: AxisProcessData,
        machine: DriveMachine,
        method: int | None,
        methods: Collection[int] | None,
        bound: Callable[[Callable[[str], None]], None],
        *,
        was_enabled: bool,
        timeout_ns: int,
    ) -> None:
        if method is not None:
            require_method(method, methods)
        self.result: str | None = None
        self.phase = HomingPhase.METHOD
        self.mode_before, self.was_enabled = machine.mode, was_enabled
        self._machine = machine
        self._method, self._bound = method, bound
        self._ended_at: int | None = None
        self._axis = axis
        counts = abs(axis.scale.pos_to_dev)
        self._sequence = HomingSequence(
            timeout_ns=timeout_ns, tolerance=max(1, round(_SETTLED * counts)), near=max(1, round(_NEAR * counts))
        )
        index = axis.index(objects.HOMING_METHOD)
        if method is None:
            axis.node.read(index, 0, self._method_known)
        else:
            axis.node.write(index, 0, method.to_bytes(1, "little", signed=True), self._method_known)

    @property
    def over(self) -> bool:
        """Whether the homing has ended, successfully or not."""
        return self.homed or self.phase is HomingPhase.FAILED

    @property
    def homed(self) -> bool:
        return self.phase is HomingPhase.HOMED

    def ended_within(self, now: int, limit_ns: int) -> bool:
        """Whether at most `limit_ns` have passed since the first call after the end."""
        if self._ended_at is None:
            self._ended_at = now
        return now - self._ended_at < limit_ns

    def abort(self, reason: str) -> None:
        """End the homing as failed, unless it has already ended; bit 4 is 0 from the next cycle on."""
        if not self.over:
            self._fail(reason)

    def step(
        self, enable_requested: bool, may_home: bool, now: int, *, standing: bool, position: HomingPosition | None
    ) -> int:
        """Run one cycle of the homing; return the mode-specific bits of the controlword.

        `enable_requested` is True if the axis is enabled or being enabled, `may_home` if its statechart permits
        homing, `standing` if the axis is known to stand still; `position` is None if unknown.
        """
        machine = self._machine
        ready = may_home and machine.may_move and machine.mode == OperationMode.HM
        if self.phase is HomingPhase.ENABLE:
            if not enable_requested:
                self._fail("the drive was not enabled")
            elif ready:
                self.phase = HomingPhase.RUN
                self._sequence.start(self._method or 0)
        if self.phase is not HomingPhase.RUN:
            return 0
        bits = self._sequence.update(machine.statusword, ready, now, standing=standing, position=position)
        for event in self._sequence.events():
            if isinstance(event, HomingDone):
                self.phase, self.result = HomingPhase.HOMED, ""
            else:
                self._fail(event.text)
        return bits

    def _method_known(self, request: SdoRequest) -> None:
        if self.phase is not HomingPhase.METHOD:
            return
        if request.error is not None:
            self._fail(str(request.error))
            return
        if self._method is None:
            self._method = int.from_bytes(request.data[:1], "little", signed=True)
        if self._axis.has(objects.HOME_OFFSET):
            self._axis.node.read(self._axis.index(objects.HOME_OFFSET), 0, self._offset_known)
        else:
            self._bound_speeds()

    def _offset_known(self, request: SdoRequest) -> None:
        if self.phase is not HomingPhase.METHOD:
            return
        if request.error is None:
            self._sequence.home_offset = int.from_bytes(request.data[:4], "little", signed=True)
        self._bound_speeds()

    def _bound_speeds(self) -> None:
        # CiA 402-2, 0x6098: methods 35 and 37 use the present position, so the speeds have no effect
        if self._method in METHODS_WITHOUT_MOTION:
            self.phase = HomingPhase.KNOWN
        else:
            self._bound(self._speeds_bounded)

    def _speeds_bounded(self, why: str) -> None:
        if self.phase is not HomingPhase.METHOD:
            return
        if why:
            self._fail(why)
        else:
            self.phase = HomingPhase.KNOWN

    def _fail(self, reason: str) -> None:
        self.phase, self.result = HomingPhase.FAILED, reason


class HomePosition:
    """Home position of an axis: the homing in progress, and the result of the last homing."""

    def __init__(self, axis: AxisProcessData, machine: DriveMachine, parameters: AxisParameters) -> None:
        self.homing: JointHoming | None = None
        self._last: JointHoming | None = None
        self._axis, self._machine, self._parameters = axis, machine, parameters

    @property
    def known(self) -> bool:
        """Whether the last homing was successful and the home position is still valid."""
        return self._last is not None and self._last.homed

    @property
    def result(self) -> str | None:
        """Result of the last homing: "" on success, else the reason for the failure; None if no homing has ended."""
        return None if self._last is None else self._last.result

    def begin(self, method: int | None, *, was_enabled: bool) -> None:
        """Start homing; raise DriveError if homing is in progress already, or if the drive does not list the method."""
        node = self._axis.node
        if self.homing is not None:
            raise DriveError(f"{node.label}: homing is already in progress; wait for its end")
        timeout = round(node.config.motion.homing_timeout_seconds * 1e9)
        methods = self._parameters.homing_methods
        bound = self._parameters.bound_homing
        self.homing = JointHoming(
            self._axis, self._machine, method, methods, bound, was_enabled=was_enabled, timeout_ns=timeout
        )
        self._last = None

    def end(self, run: JointHoming) -> None:
        """Record the result of a completed homing."""
        self.homing, self._last = None, run

    def forget(self) -> None:
        """Discard a successful homing when the home position is lost; keep the result of a failed homing."""
        if self.known:
            self._last = None
