"""Processors kept awake: a request that lives as long as the file is open, and the reason where there is none."""

from __future__ import annotations

import contextlib
import errno
import os
import struct

import pytest

from canopen_control.host.awake import LATENCY_DEVICE, keep_awake


def _latency_us() -> int:
    """What the kernel holds to, of all requests: reading the file is the independent witness."""
    descriptor = os.open(LATENCY_DEVICE, os.O_RDONLY)
    try:
        (value,) = struct.unpack("=i", os.read(descriptor, 4))
    finally:
        os.close(descriptor)
    return int(value)


@pytest.mark.skipif(not os.access(LATENCY_DEVICE, os.R_OK | os.W_OK), reason="this user may not ask for latencies")
def test_no_latency_is_asked_for_until_the_end():
    before = _latency_us()
    with contextlib.ExitStack() as undo:
        assert keep_awake(undo) == ""
        assert _latency_us() == 0
    assert _latency_us() == before


def test_a_machine_without_it_says_so(tmp_path):
    with contextlib.ExitStack() as undo:
        assert keep_awake(undo, str(tmp_path / "none")) == f"{tmp_path}/none: No such file or directory"


def test_a_user_who_may_not_learns_what_to_type(monkeypatch):
    def refuse(_device, _flags):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(os, "open", refuse)
    with contextlib.ExitStack() as undo:
        assert keep_awake(undo) == (
            "/dev/cpu_dma_latency: Permission denied; to allow it type: sudo setfacl -m u:$USER:w /dev/cpu_dma_latency"
        )


def test_a_request_is_four_bytes_and_its_file_is_closed(tmp_path):
    device = tmp_path / "latency"
    device.touch()
    open_before = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0
    with contextlib.ExitStack() as undo:
        assert keep_awake(undo, str(device)) == ""
    assert device.read_bytes() == b"\0\0\0\0"
    assert (len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0) == open_before


def test_a_refused_request_leaves_nothing_open(tmp_path, monkeypatch):
    device = tmp_path / "latency"
    device.touch()
    closed = []
    close = os.close

    def refuse(_descriptor, _data):
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    def note(descriptor):
        closed.append(descriptor)
        close(descriptor)

    monkeypatch.setattr(os, "write", refuse)
    monkeypatch.setattr(os, "close", note)
    with contextlib.ExitStack() as undo:
        assert keep_awake(undo, str(device)) == f"{device}: Invalid argument"
        assert not closed
    assert len(closed) == 1
