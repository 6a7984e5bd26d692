"""Processors that do not sleep: what a program that waits for the next millisecond asks of the kernel.

A processor with nothing to do sleeps, and coming back takes 1 to 200 us on real ones, 20 us and twice that on virtual
ones, at every timer and every frame. While the file `/dev/cpu_dma_latency` is open with a 0 in it, idle processors
spin instead (Linux, Documentation/power/pm_qos_interface.rst). That costs current; it ends with the process at the
latest.
"""

from __future__ import annotations

import os
import struct
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import contextlib

__all__ = ["LATENCY_DEVICE", "keep_awake"]

LATENCY_DEVICE: Final = "/dev/cpu_dma_latency"
_NO_LATENCY: Final = struct.pack("=i", 0)  # us


def keep_awake(undo: contextlib.ExitStack, device: str = LATENCY_DEVICE) -> str:
    """Keep all processors awake until `undo` is closed; returns "", or why they may sleep and what would help."""
    try:
        descriptor = os.open(device, os.O_WRONLY | os.O_CLOEXEC)
        undo.callback(os.close, descriptor)
        os.write(descriptor, _NO_LATENCY)
    except PermissionError as error:
        return f"{device}: {error.strerror}; to allow it type: sudo setfacl -m u:$USER:w {device}"
    except OSError as error:
        return f"{device}: {error.strerror}"
    return ""
