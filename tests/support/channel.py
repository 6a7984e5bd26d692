"""Where tests of whole processes put their robots: on `local:` buses, or all on one interface of a real kernel.

CANOPEN_CONTROL_TEST_CHANNEL=vcan0 says the latter; then times are multiplied as in all tests of a guest. A test that is
about the embedded bus itself is marked `embedded` and is not among those of such a run.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from support.guest import scaled_robby

if TYPE_CHECKING:
    from pathlib import Path

CHANNEL = os.environ.get("CANOPEN_CONTROL_TEST_CHANNEL", "")


def channel_of(name: str) -> str:
    """Return the channel of a test that would call its bus `name`."""
    return CHANNEL or f"local:{name}"


def python_can_of(name: str) -> dict[str, Any]:
    """Return how python-can opens that channel."""
    if CHANNEL:
        return {"interface": "socketcan", "channel": CHANNEL}
    return {"interface": "canopen_control", "channel": name, "label": "witness"}


def robby_of(folder: Path) -> str:
    """Return the robby to run: the bundled one, or a copy with times as a slow machine needs them."""
    if not CHANNEL:
        return "robby"
    place = folder / "robby"
    return str(place if place.exists() else scaled_robby(folder))
