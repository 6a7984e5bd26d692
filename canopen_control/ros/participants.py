"""Identification of the ROS program that sent a request by its DDS participant.

Rules (DDS, Fast DDS): the first twelve bytes of a GUID identify the participant; usually a process has one. A
participant that ends announces this; one that was killed is detected when its lease expires, after 20 s by default.
Fast DDS composes these bytes from vendor, host and process, so that a participant on the same host can be checked at
once.
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import RosMessage
    from canopen_control.ros.rcl import Node


_PREFIX: Final = 12
_VENDOR: Final = b"\x01\x0f"  # eProsima
_PROCFS: Final = Path("/proc")
_PIDS: Final = 1 << 22  # the upper limit of process ids in Linux


def client_of(header: RosMessage) -> bytes | None:
    """Return the DDS participant that sent a request, or None if unknown.

    The header is an rmw_request_id_t of C: a GUID of 16 bytes and the sequence number of the request. rclpy exposes
    only the number; pybind11 stores the structure's address after the head of the Python object. The number confirms
    the address.
    """
    pointer = ctypes.c_size_t.from_address(id(header) + object.__basicsize__).value
    if not pointer or pointer % 8:
        return None
    if ctypes.c_int64.from_address(pointer + 16).value != header.sequence_number:
        return None
    return ctypes.string_at(pointer, _PREFIX)


class ActionClients:
    """DDS participants that have a client of one action; `action` is its full name."""

    def __init__(self, node: Node, action: str) -> None:
        self._node, self._action = node, action

    def present(self) -> set[bytes]:
        """Return the participants whose clients DDS has discovered."""
        publishers = self._node.get_publishers_info_by_topic(
            f"rq{self._action}/_action/send_goalRequest", no_mangle=True
        )
        return set(map(_participant, publishers))

    def runs_here(self, participant: bytes) -> bool:
        """Whether a participant is a running process on this host; False for a process in another container."""
        host = self._host()
        return host is not None and participant[:4] == _VENDOR + host and runs(_process(participant))

    def _host(self) -> bytes | None:
        """Return the two bytes that identify this host in a participant, or None if unknown."""
        own = self._node.get_publishers_info_by_topic(f"rt{self._action}/_action/status", no_mangle=True)
        for participant in map(_participant, own):
            if participant[:2] == _VENDOR and _process(participant) == os.getpid() % 65536:
                return participant[2:4]
        return None


def folder_of(node: Node, participant: bytes | None) -> Path | None:
    """Return the working directory of a participant's process; None if unreadable or on another host."""
    own = map(_participant, node.get_publishers_info_by_topic("/rosout"))
    host = next((gid[2:4] for gid in own if gid[:2] == _VENDOR and _process(gid) == os.getpid() % 65536), None)
    if participant is None or host is None or participant[:4] != _VENDOR + host:
        return None
    numbers = range(_process(participant), _PIDS, 65536)
    pids = [number for number in numbers if number and (_PROCFS / str(number)).exists()]
    if len(pids) != 1:
        return None
    try:
        return (_PROCFS / str(pids[0]) / "cwd").readlink()
    except OSError:  # the process belongs to another user, or has ended
        return None


def _participant(endpoint: RosMessage) -> bytes:
    return bytes(endpoint.endpoint_gid[:_PREFIX])


def _process(participant: bytes) -> int:
    return int.from_bytes(participant[4:6], "little")


def runs(lowest: int, procfs: Path = _PROCFS) -> bool:
    """Whether a process exists whose id has the lower 16 bits `lowest`; zombies do not count."""
    for number in range(lowest, _PIDS, 65536):
        try:
            text = (procfs / str(number) / "stat").read_text()
        except OSError:
            continue
        if text.rpartition(")")[2].split()[:1] != ["Z"]:
            return True
    return False
