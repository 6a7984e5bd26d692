"""Robby on the memory bus in virtual time: robot and drives on threads of this process, its API as clients see it."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from support.lockstep import lockstep
from support.onbus import GENERIC, TMCM, OnBus

from canopen_control import Robot

if TYPE_CHECKING:
    from collections.abc import Iterator

STRANGER = 30  # a node that is not in the bus.yml


@contextlib.contextmanager
def live_robot(name: str, *, real_time: bool = False) -> Iterator[OnBus]:
    """Run robby as robot `name` on `memory:NAME`, with a node that is not its own.

    In virtual time, unless what looks at it has threads of its own.
    """
    channel = f"memory:{name}"
    with (
        contextlib.nullcontext() if real_time else lockstep(),
        OnBus(channel, {3: TMCM, 2: TMCM, STRANGER: GENERIC}, real_time=real_time) as drives,
        Robot.from_config("robby", name=name, can=channel, drives=False),
    ):
        yield drives
