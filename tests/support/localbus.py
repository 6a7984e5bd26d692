"""Helpers for tests on ``local:`` buses: a runtime folder of their own, and hubs that end with the test."""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import signal
import tempfile
import time
from typing import TYPE_CHECKING

from support.host import TIMEOUT_S

from canopen_control.bus.local import LocalPort, ask_hub, open_local
from canopen_control.frame import CanFrame, frames_of
from canopen_control.host.sockets import list_sockets
from canopen_control.rpc.messages.hub import GetHubStatus, HubStatus

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@contextlib.contextmanager
def runtime_folders(setenv: Callable[[str, str], None]) -> Iterator[str]:
    """Set folders for sockets and logs of this test alone, and end the hubs in them afterwards."""
    folder = tempfile.mkdtemp(prefix="cc-")
    setenv("XDG_RUNTIME_DIR", folder)
    setenv("XDG_STATE_HOME", folder + "/state")
    try:
        yield folder
        end_hubs()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def end_hubs() -> None:
    """End every hub of the runtime folder and wait until it is gone."""
    for name in list_sockets("busctl"):
        kill_hub(name, signal.SIGTERM)


def hub_status(name: str) -> HubStatus:
    """Ask a hub for its status."""
    return ask_hub(name, GetHubStatus())


def kill_hub(name: str, number: int = signal.SIGKILL) -> None:
    """Send a signal to a hub that is expected to end it, and wait until it has."""
    pid = hub_status(name).pid
    fd = os.pidfd_open(pid)
    try:
        os.kill(pid, number)
        assert select.select([fd], [], [], TIMEOUT_S)[0], f"hub {pid} does not end"
    finally:
        os.close(fd)


def receive(port: LocalPort, count: int) -> list[CanFrame]:
    """Wait until a port has received `count` frames, and return them."""
    frames: list[CanFrame] = []
    deadline = time.monotonic() + TIMEOUT_S
    while len(frames) < count:
        assert select.select([port], [], [], deadline - time.monotonic())[0], f"only {len(frames)} of {count} came"
        frames += frames_of(port.receive())
    return frames


__all__ = ["TIMEOUT_S", "end_hubs", "hub_status", "kill_hub", "open_local", "receive", "runtime_folders"]
