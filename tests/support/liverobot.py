"""Robby on the memory bus with a real clock: robot and drives on threads of this process, its API as clients see it."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from support.onbus import GENERIC, TMCM, OnBus

from canopen_control import Robot

if TYPE_CHECKING:
    from collections.abc import Iterator

STRANGER = 30  # a node that is not in the bus.yml


@contextlib.contextmanager
def live_robot(name: str) -> Iterator[OnBus]:
    """Run robby as robot `name` on `memory:NAME`, with a node that is not its own."""
    channel = f"memory:{name}"
    with (
        OnBus(channel, {3: TMCM, 2: TMCM, STRANGER: GENERIC}) as drives,
        Robot.from_config("robby", name=name, can=channel, drives=False),
    ):
        yield drives
