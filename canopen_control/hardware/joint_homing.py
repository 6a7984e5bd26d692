"""One homing of one axis, from the user's word to the mode it had before (CiA 402-2, mode HM).

The law of this file: the method is checked against what the drive lists before anything is written. Homing may enable
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
    """How far a homing has come."""

    METHOD = "the method is written, and the speeds are bounded"
    KNOWN = "the drive is to be enabled in mode HM"
    ENABLE = "the drive is being enabled in mode HM"
    RUN = "homing"
    HOMED = "over: the drive has found its zero"
    FAILED = "over: it came to nothing"


class JointHoming:
    """A homing under way; `result` is None until it is over, then "" or the reason why it failed.

    `mode_before` and `was_enabled` are what the axis goes back to. Raises DriveError for a method that is not among
    those that the drive lists, `methods` (None: it lists none). `bound` keeps the speeds within the velocity limit, and
    says in the end "" or why they are not: then there is no homing.
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
        """Whether it has ended."""
        return self.homed or self.phase is HomingPhase.FAILED

    @property
    def homed(self) -> bool:
        """Whether it has ended well."""
        return self.phase is HomingPhase.HOMED

    def abort(self, reason: str) -> None:
        """End it; bit 4 is 0 from the next cycle on."""
        if not self.over:
            self._fail(reason)

    def step(self, wanted: bool, may_home: bool, now: int) -> int:
        """Return the mode's bits of the controlword for this cycle.

        `wanted`: the axis is to be enabled still; `may_home`: its chart lets it move.
        """
        machine = self._machine
        ready = may_home and machine.may_move and machine.mode == OperationMode.HM
        if self.phase is HomingPhase.ENABLE:
            if not wanted:
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
    """Whether the zero of an axis is known: its homing under way and, while what it found is true, the last one."""

    def __init__(self, axis: AxisProcessData, machine: DriveMachine, parameters: AxisParameters) -> None:
        self.homing: JointHoming | None = None
        self._last: JointHoming | None = None
        self._axis, self._machine, self._parameters = axis, machine, parameters

    @property
    def known(self) -> bool:
        """Whether the last homing has found the zero, and nothing has lost it since."""
        return self._last is not None and self._last.homed

    @property
    def result(self) -> str | None:
        """Why the last homing failed, "" where it did not, None before its end."""
        return None if self._last is None else self._last.result

    def begin(self, method: int | None, *, was_enabled: bool) -> None:
        """Begin a homing; DriveError for a method that the drive does not list, and while one is under way."""
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
        """Take that a homing is over."""
        self.homing, self._last = None, run

    def forget(self) -> None:
        """Take that the zero is not known any more."""
        if self.known:
            self._last = None
