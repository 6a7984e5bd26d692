"""The numbers that messages have, each with its range: what is outside is refused where a message is decoded."""

from __future__ import annotations

from typing import Annotated, Final

import msgspec

__all__ = ["BitRate", "Bits", "Count", "Identifier", "Index", "NodeId", "Subindex", "UnixTime"]

_LAST_COUNT: Final = (1 << 63) - 1
_LAST_TIME: Final = 1e11  # the year 5138: a calendar has all before it

Index = Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)]
Subindex = Annotated[int, msgspec.Meta(ge=0, le=0xFF)]
NodeId = Annotated[int, msgspec.Meta(ge=1, le=127)]
Identifier = Annotated[int, msgspec.Meta(ge=0, le=0xFFFFFFFF)]  # of a frame, with the flags of its kind
Bits = Annotated[int, msgspec.Meta(ge=0, le=64)]
BitRate = Annotated[int, msgspec.Meta(gt=0, le=_LAST_COUNT)]  # bit/s
Count = Annotated[int, msgspec.Meta(ge=0, le=_LAST_COUNT)]
UnixTime = Annotated[float, msgspec.Meta(ge=0, lt=_LAST_TIME)]  # seconds
