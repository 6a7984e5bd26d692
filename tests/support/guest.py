"""Tests inside a guest kernel: robby with its times multiplied, a listener that is only a raw socket, and ``ip``."""

from __future__ import annotations

import contextlib
import os
import re
import socket
import struct
import subprocess
import threading
import time
from pathlib import Path

from support.host import TIME_SCALE
from support.robots import copy_robby

from canopen_control.client.drive_client import DriveClient
from canopen_control.rpc.messages.drive import GetDriveState

GUEST = os.environ.get("CANOPEN_CONTROL_GUEST", "")
"""Which guest this is, empty outside of any."""

LEFT, RIGHT = 3, 2
# rad per microstep; the left motor is mounted in mirror image
RAD = {LEFT: -0.003926990816987242, RIGHT: 0.003926990816987242}
SYNC, NMT = 0x080, 0x000
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000

_FRAME = struct.Struct("=IB3x8s")
_CAN_RAW, _SOL_CAN_RAW, _RAW_FILTER = 1, 101, 1
_SO_RCVBUFFORCE, _SO_TIMESTAMPNS = 33, 35
_TIMESPEC = struct.Struct("@ll")


def scaled(seconds: float) -> float:
    """Return a time of a fast machine as it is here."""
    return seconds * TIME_SCALE


def scaled_robby(folder: Path, scale: float = TIME_SCALE) -> Path:
    """Copy robby with every time of its files multiplied by a scale: SYNC, heartbeats, cycle, time limits."""
    if scale == 1:
        return copy_robby(folder)
    cycle_ms = 20 * scale
    bus = {
        "node_id: 1\n": f"node_id: 1\n  boot_time: {round(5000 * scale)}\n",
        "sync_period: 20000": f"sync_period: {round(1000 * cycle_ms)}",
        "heartbeat_producer: 100": f"heartbeat_producer: {round(100 * scale)}",
        "sub_index: 1, value: 20}": f"sub_index: 1, value: {round(cycle_ms)}}}",
    }
    controllers = {
        "update_rate: 50": f"update_rate: {round(1000 / cycle_ms)}",
        "publish_rate: 50.0": f"publish_rate: {1000 / cycle_ms}",
        "command_timeout: 2.0": f"command_timeout: {2.0 * scale}",
        "cmd_vel_timeout: 0.5": f"cmd_vel_timeout: {0.5 * scale}",
    }
    return copy_robby(folder, bus=bus, controllers=controllers)


def ip(*words: str) -> str:
    """Run iproute2 and return what it prints."""
    return _run("ip", *words)


def throttle(interface: str, rate: str, limit: int = 320) -> None:
    """Let an interface send at a rate, 128 bits a frame, and hold `limit` bytes back; beyond, it refuses (ENOBUFS)."""
    if not Path("/sys/module/sch_tbf").is_dir():  # already loaded in the emulated PC, which has no module folder
        _run("modprobe", "sch_tbf")
    words = f"qdisc replace dev {interface} root tbf rate {rate} burst 160 limit {limit}"
    _run("tc", *words.split())


def _run(*words: str) -> str:
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, f"{words}: {done.stderr}"
    return done.stdout


class RawListener:
    """A raw CAN socket and a thread, nothing of ours; `frames` are (seconds by the kernel, identifier, data).

    Without `identifiers` it receives everything, the frames with flags too.
    """

    def __init__(self, interface: str, identifiers: tuple[int, ...] = ()) -> None:
        self.frames: list[tuple[float, int, bytes]] = []
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, _CAN_RAW)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, 16 << 20)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        if identifiers:
            filters = b"".join(struct.pack("=II", identifier, 0xC00007FF) for identifier in identifiers)
            self._socket.setsockopt(_SOL_CAN_RAW, _RAW_FILTER, filters)
        self._socket.bind((interface,))
        self._socket.settimeout(0.2)
        self._over = False
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self) -> None:
        while not self._over:
            with contextlib.suppress(TimeoutError):
                try:
                    record, ancillary, _flags, _address = self._socket.recvmsg(16, 64)
                except TimeoutError:
                    continue
                except OSError:  # the interface is down or gone
                    time.sleep(0.01)
                    continue
                identifier, length, data = _FRAME.unpack(record)
                (seconds, nanoseconds) = _TIMESPEC.unpack_from(ancillary[0][2])
                self.frames.append((seconds + nanoseconds * 1e-9, identifier, data[:length]))

    def of(self, identifier: int) -> list[tuple[float, bytes]]:
        """Return (seconds, data) of one identifier."""
        return [(when, data) for when, observed, data in list(self.frames) if observed == identifier]

    def speeds(self, node_id: int) -> list[tuple[float, float]]:
        """Return (seconds, rad/s at the wheel) as received in robby's second TPDO: position, velocity."""
        return [(when, RAD[node_id] * struct.unpack_from("<i", data, 4)[0]) for when, data in self.of(0x280 + node_id)]

    def is_at(self, speed: float) -> bool:
        """Whether both wheels turn at a speed in rad/s, by the newest of them."""
        return all(abs(self.speed(node_id) - speed) <= max(0.02, 0.01 * abs(speed)) for node_id in (LEFT, RIGHT))

    def speed(self, node_id: int) -> float:
        """Return the newest of them, 0 before any."""
        for _, observed, data in reversed(self.frames):
            if observed == 0x280 + node_id:
                return RAD[node_id] * struct.unpack_from("<i", data, 4)[0]
        return 0.0

    def close(self) -> None:
        self._over = True
        self._thread.join()
        self._socket.close()


def plant_speed(channel: str, node_id: int) -> float:
    """Return how fast the motor of a virtual drive turns, past the bus: in the drive's own units per second."""
    with DriveClient.connect(channel, node_id, 60) as drive:
        return drive.ask(GetDriveState()).axes[0].plant.velocity


class CandumpLine:
    """One line of ``candump -L``: time, interface, identifier as text, data."""

    _FORMAT = re.compile(r"\((\d+\.\d+)\) (\S+) ([0-9A-F]{3}|[0-9A-F]{8})#([0-9A-F]*|R\d?)( [RT])?")

    def __init__(self, line: str) -> None:
        match = self._FORMAT.fullmatch(line.strip())
        assert match is not None, line
        self.time, self.interface, self.identifier, self.data = float(match[1]), match[2], match[3], match[4]
