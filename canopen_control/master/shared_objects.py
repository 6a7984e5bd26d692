"""Process data of objects that the motors of one device share, presented as separate objects per axis.

See `cia402.motors` for such devices. The controlword of the device is combined from those of its axes: an enabling bit
is set if all axes set it, halt and fault reset are set if any axis sets them. So all axes are enabled together, and a
stop of one axis stops all. An axis in a fault reacts only to a fault reset, and its enabling bits are ignored, so that
the other axes can still be stopped in a controlled way.
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


_ANY: Final = HALT_BIT | 0x80  # bits that are set if any axis sets them: halt, fault reset
_FAULT_MASK: Final = 0x4F
_FAULTS: Final = (0x08, 0x0F)  # masked statuswords: FAULT, FAULT REACTION ACTIVE (CiA 402-2, table 30)


class AxisControlword(Output):
    """Controlword of one axis of a device; `whole` is the device's controlword, `axes` has those of all axes."""

    __slots__ = ("axes", "statusword", "whole")

    def __init__(self, whole: Output, statusword: Input | None, axes: list[AxisControlword]) -> None:
        super().__init__()
        self.whole, self.statusword, self.axes = whole, statusword, axes
        axes.append(self)

    @property
    def counts(self) -> bool:
        """Whether the enabling bits of the axis count, because the axis is not in a fault."""
        status = self.statusword
        return status is None or not status.fresh or status.value & _FAULT_MASK not in _FAULTS

    def drive(self) -> None:
        """Mark the controlword as moving an axis, so that the RPDOs of the device's controlword are sent."""
        self.driven = True
        self.whole.drive()

    def set(self, value: int) -> None:
        """Set the controlword of this axis, and the combined controlword of the device."""
        self.value = value
        self.whole.set(combined(self.axes))


def combined(axes: Sequence[AxisControlword]) -> int:
    """Return the controlword of a device, combined from those of the axes that joints use."""
    every, some = 0xFFFF, 0
    for axis in axes:
        if axis.driven:  # used by a joint
            some |= axis.value
            if axis.counts:
                every &= axis.value
    return (0 if every == 0xFFFF else every & ~_ANY) | some & _ANY


def share_objects(image: ProcessImage, node_id: int, motors: MotorMap) -> None:
    """Add to `image` the objects that the axes of a node share, per axis; the node's PDOs must be in `image`."""
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
