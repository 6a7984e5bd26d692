"""One homing of one axis, from the user's word to the mode it had before (CiA 402-2, mode HM).

The law of this file: the method is checked against what the drive lists before anything is written. Homing may enable
the drive, because a user asked for a motion; afterwards the mode and the enable are what they were. Every way out
leaves bit 4 at 0, and only a homing that was seen to end well makes the axis homed.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING

from canopen_control.cia402 import objects
from canopen_control.cia402.homing import HomingDone, HomingSequence, require_method
from canopen_control.cia402.modes import OperationMode

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_client import SdoRequest
    from canopen_control.hardware.joint import JointDrive

__all__ = ["HomingRun"]


class _Phase(enum.Enum):
    METHOD = "the method is written"
    ENABLE = "the drive is enabled in mode HM"
    RUN = "homing"
    DONE = "over"


class HomingRun:
    """A homing under way; `result` is None until it is over, then "" or the reason why it failed."""

    def __init__(self, joint: JointDrive, method: int | None, *, timeout_ns: int) -> None:
        if method is not None:
            require_method(method, joint.parameters.homing_methods)
        self.result: str | None = None
        self.homed = False
        self._joint = joint
        self._method = method
        self._phase = _Phase.METHOD
        self._sequence = HomingSequence(timeout_ns=timeout_ns)
        self._mode_before, self._was_enabled = joint.machine.mode, joint.wanted
        index = joint.axis.index(objects.HOMING_METHOD)
        if method is None:
            joint.node.read(index, 0, self._method_known)
        else:
            joint.node.write(index, 0, method.to_bytes(1, "little", signed=True), self._method_known)

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        return self._phase is _Phase.DONE

    def abort(self, reason: str) -> None:
        """End it; bit 4 is 0 from the next cycle on."""
        if not self.over:
            self._end(reason)

    def step(self, now: int) -> int:
        """Return the mode's bits of the controlword for this cycle."""
        joint = self._joint
        if self._phase is _Phase.ENABLE:
            if not joint.wanted:
                self._end("the drive was not enabled")
            elif joint.machine.may_move and joint.machine.mode == OperationMode.HM:
                self._phase = _Phase.RUN
                self._sequence.start(self._method or 0)
        if self._phase is not _Phase.RUN:
            return 0
        ready = joint.machine.may_move and joint.machine.mode == OperationMode.HM
        bits = self._sequence.update(joint.machine.statusword, ready, now)
        for event in self._sequence.events():
            self.homed = isinstance(event, HomingDone)
            self._end("" if self.homed else event.text)
        return bits

    def _method_known(self, request: SdoRequest) -> None:
        if self._phase is not _Phase.METHOD:
            return
        if request.error is not None:
            self._end(str(request.error))
            return
        if self._method is None:
            self._method = int.from_bytes(request.data[:1], "little", signed=True)
        self._phase = _Phase.ENABLE
        self._joint.begin_homing()

    def _end(self, result: str) -> None:
        self._phase, self.result = _Phase.DONE, result
        self._joint.end_homing(self._mode_before, self._was_enabled, homed=self.homed)
