"""What the tests of the services share: golden vectors, frames by their log form, arbitrary frames."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from canopen_control.frame import REMOTE_FLAG, CanFrame

MS = 1_000_000


@cache
def vectors() -> dict[str, Any]:
    """Return the groups of golden vectors; they come from a generator of its own, not from this package."""
    return json.loads((Path(__file__).parent.parent / "data" / "services.json").read_text())


def frame(text: str) -> CanFrame:
    """Read candump's log form, ``703#7F`` or ``703#R1``; what follows a blank is a remark."""
    identifier, _, data = text.split(" ")[0].partition("#")
    if data.startswith("R"):
        return CanFrame(int(identifier, 16) | REMOTE_FLAG, bytes(int(data[1:] or "0")))
    return CanFrame(int(identifier, 16), bytes.fromhex(data))


# All identifiers of the services, with and without flags, and others.
identifiers = st.one_of(
    st.sampled_from([0x000, 0x080, 0x100, 0x7E4, 0x7E5, 0x083, 0x183, 0x203, 0x703, 0x70A]),
    st.sampled_from([0x183 | REMOTE_FLAG, 0x703 | REMOTE_FLAG]),
    st.integers(0, 0x7FF),
    st.integers(0, 0xFFFF_FFFF),
)
frames = st.builds(CanFrame, identifiers, st.binary(max_size=8))
