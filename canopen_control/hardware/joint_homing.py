"""One homing of one axis, from the request to the return to the previous mode (CiA 402-2, mode HM).

The method is checked against what the drive lists before anything is written. Homing may enable
the drive, because a user asked for a motion; afterwards the mode and the enable are what they were. Every way out
leaves bit 4 at 0, and only a homing that was seen to end well makes the axis homed. The joint that it is of asks for
`phase` in every cycle and does what that says; nothing here reaches back to it.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING

from canopen_control.cia402 import objects
from canopen_control.cia402.homing import METHODS_WITHOUT_MOTION, HomingDone, HomingSequence, require_method
from canopen_control.cia402.modes import OperationMode
from canopen_control.errors import DriveError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.hardware.axis_parameters import AxisParameters


class HomingPhase(enum.Enum):
    """Phase of a homing."""

    METHOD = "the method is written, and the speeds are bounded"
    KNOWN = "the drive is to be enabled in mode HM"
    ENABLE = "the drive is being enabled in mode HM"
    RUN = "homing"
    HOMED = "over: the drive has found its zero"
    FAILED = "over: it came to nothing"


class JointHoming:
    """Homing in progress; `result` is None until its end, then "" or the reason of a failure.

    `mode_before` and `was_enabled` are restored afterwards. DriveError for a method that is not in `methods`, the list
    of the drive (None: no list). `bound` keeps the speeds within the velocity limit, and returns "" or the reason why
    it cannot: then there is no homing.
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
        self._sequence = HomingSequence(timeout_ns=timeout_ns)
        index = axis.index(objects.HOMING_METHOD)
        if method is None:
            axis.node.read(index, 0, self._method_known)
        else:
            axis.node.write(index, 0, method.to_bytes(1, "little", signed=True), self._method_known)

    @property
    def over(self) -> bool:
        """Whether the homing has ended."""
        return self.homed or self.phase is HomingPhase.FAILED

    @property
    def homed(self) -> bool:
        """Whether the homing has ended successfully."""
        return self.phase is HomingPhase.HOMED

    def abort(self, reason: str) -> None:
        """End the homing; bit 4 is 0 from the next cycle on."""
        if not self.over:
            self._fail(reason)

    def step(self, is_wanted: bool, may_home: bool, now: int) -> int:
        """Return the mode's bits of the controlword for this cycle.

        `wanted`: the axis is still meant to be enabled; `may_home`: its chart permits motion.
        """
        machine = self._machine
        ready = may_home and machine.may_move and machine.mode == OperationMode.HM
        if self.phase is HomingPhase.ENABLE:
            if not is_wanted:
                self._fail("the drive was not enabled")
            elif ready:
                self.phase = HomingPhase.RUN
                self._sequence.start(self._method or 0)
        if self.phase is not HomingPhase.RUN:
            return 0
        bits = self._sequence.update(machine.statusword, ready, now)
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
    """Home position of an axis: the homing in progress, and the last one while its result is valid."""

    def __init__(self, axis: AxisProcessData, machine: DriveMachine, parameters: AxisParameters) -> None:
        self.homing: JointHoming | None = None
        self._last: JointHoming | None = None
        self._axis, self._machine, self._parameters = axis, machine, parameters

    @property
    def known(self) -> bool:
        """Whether the last homing has found the zero and it has not been lost since."""
        return self._last is not None and self._last.homed

    @property
    def result(self) -> str | None:
        """Reason of the last failed homing, "" after success, None before its end."""
        return None if self._last is None else self._last.result

    def begin(self, method: int | None, *, was_enabled: bool) -> None:
        """Start a homing; DriveError for a method that the drive does not list, and during another homing."""
        node = self._axis.node
        if self.homing is not None:
            raise DriveError(f"{node.who}: homing is under way already")
        timeout = round(node.config.motion.homing_timeout_seconds * 1e9)
        methods = self._parameters.homing_methods
        bound = self._parameters.bound_homing
        self.homing = JointHoming(
            self._axis, self._machine, method, methods, bound, was_enabled=was_enabled, timeout_ns=timeout
        )
        self._last = None

    def end(self, run: JointHoming) -> None:
        """Process the end of a homing."""
        self.homing, self._last = None, run

    def forget(self) -> None:
        """Reset after the zero was lost."""
        if self.known:
            self._last = None
