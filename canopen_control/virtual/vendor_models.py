"""Device models of vendors whose drives treat set-points in a way of their own, by the vendor id 0x1018:01.

Only what the vendors' objects and public manuals tell of missing set-points; everything else is the generic drive's.
maxon's EPOS4 stands at the end of the interpolation until the next set-point comes, and takes it at once where 0x60C2
is 0, the default of its files. Elmo's Gold drives go on for as many periods as 0x2F75 says, then they fault with EMCY
0xFF02 (interpolation underflow); the motor stops as 0x605E says.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_control.virtual.device_model import DeviceModel, MissingSetPoint

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.od.model import ObjectDictionary

__all__ = ["ELMO", "MAXON", "MODELS", "vendor_model"]

INTERPOLATION_UNDERFLOW: Final = 0xFF02  # EMCY of Elmo
_EXTRAPOLATION_CYCLES: Final = (0x2F75, 0)

MAXON: Final = DeviceModel(missing=MissingSetPoint())
ELMO: Final = DeviceModel(
    missing=MissingSetPoint(cycles=1, cycles_object=_EXTRAPOLATION_CYCLES, fault=INTERPOLATION_UNDERFLOW)
)

MODELS: Final[Mapping[int, DeviceModel]] = MappingProxyType({0x9A: ELMO, 0xFB: MAXON})
"""Vendor id of CiA to the model of that vendor's drives."""


def vendor_model(od: ObjectDictionary) -> DeviceModel | None:
    """Return the model of a dictionary's vendor, None where nothing is known of it."""
    entry = od.get(0x1018, 1)
    vendor = None if entry is None else entry.value
    return MODELS.get(vendor) if isinstance(vendor, int) else None
