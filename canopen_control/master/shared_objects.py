"""Process data of objects that the motors of one device share, as if each axis had its own (`cia402.motors`).

The controlword of the device is made of those of its axes: a bit that enables is set when every axis sets it, halt and
fault reset when one does. So all axes are enabled together, and the first one that is to stop stops all. An axis in a
fault obeys nothing but a fault reset, and is not counted: the others can still be led to a controlled stop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import CONTROLWORD, STATUSWORD
from canopen_control.cia402.state import HALT_BIT
from canopen_control.master.cycle import Output

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.cia402.motors import MotorMap
    from canopen_control.master.cycle import Input, ProcessImage


_ANY: Final = HALT_BIT | 0x80  # bits that one axis is enough for: halt, fault reset
_FAULT_MASK: Final = 0x4F
_FAULTS: Final = (0x08, 0x0F)  # of a statusword: FAULT, FAULT REACTION ACTIVE (CiA 402-2, table 30)


class AxisControlword(Output):
    """Controlword of one axis; `axes` are those of all axes behind the object `whole`."""

    __slots__ = ("axes", "statusword", "whole")

    def __init__(self, whole: Output, statusword: Input | None, axes: list[AxisControlword]) -> None:
        super().__init__()
        self.whole, self.statusword, self.axes = whole, statusword, axes
        axes.append(self)

    @property
    def counts(self) -> bool:
        """Whether the axis obeys more than a fault reset."""
        status = self.statusword
        return status is None or not status.fresh or status.value & _FAULT_MASK not in _FAULTS

    def drive(self) -> None:
        """Mark the object as moving an axis."""
        self.driven = True
        self.whole.drive()

    def set(self, value: int) -> None:
        """Set the controlword of this axis, and that of the device."""
        self.value = value
        self.whole.set(combined(self.axes))


def combined(axes: Sequence[AxisControlword]) -> int:
    """Return the controlword of the device."""
    every, some = 0xFFFF, 0
    for axis in axes:
        if axis.driven:  # by a joint
            some |= axis.value
            if axis.counts:
                every &= axis.value
    return (0 if every == 0xFFFF else every & ~_ANY) | some & _ANY


def share_objects(image: ProcessImage, node_id: int, motors: MotorMap) -> None:
    """Give each axis of a node the objects that it shares with the others; call it when its PDOs are in `image`."""
    for address, copies in motors.shared.items():
        for copy in copies:
            image.share(node_id, address, copy)
    whole = image.output(node_id, CONTROLWORD)
    if whole is None:
        return
    axes: list[AxisControlword] = []
    for index, _ in ((CONTROLWORD, 0), *motors.shared[CONTROLWORD, 0]):
        statusword = image.input(node_id, STATUSWORD + index - CONTROLWORD)
        image.put_before(node_id, index, AxisControlword(whole, statusword, axes))
