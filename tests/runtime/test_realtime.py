"""`--realtime` and `--cpu`: obtained settings, restored settings, and refusals."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import gc
import os
import struct
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from canopen_control.errors import ConfigError
from canopen_control.runtime import realtime
from canopen_control.runtime.realtime import LATENCY_DEVICE, RealTime, keep_awake, keep_garbage_small

LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="scheduling policies are Linux's")
_POLICY = "import os; print(os.sched_getscheduler(0), len(os.sched_getaffinity(0)))"


def _may_be_realtime() -> bool:
    try:
        RealTime(1).close()
    except (ConfigError, AttributeError):
        return False
    return True


allowed = pytest.mark.skipif(not _may_be_realtime(), reason="this user may not use SCHED_FIFO or lock memory")


def _locked_kb() -> int:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(next(line for line in status.splitlines() if line.startswith("VmLck:")).split()[1])


def test_without_a_wish_nothing_is_asked_of_the_kernel() -> None:
    before = os.sched_getscheduler(0), os.sched_getaffinity(0)
    plain = RealTime(None)
    plain.pin()
    assert (os.sched_getscheduler(0), os.sched_getaffinity(0)) == before
    assert plain.text == ""
    plain.close()


@allowed
def test_the_thread_runs_with_fifo_and_locked_memory_until_it_is_closed() -> None:
    entered = RealTime(7)
    try:
        # /proc is the independent witness: the policy is the 41st field of stat, 1 is SCHED_FIFO
        fields = Path("/proc/thread-self/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        assert (fields[38], fields[37]) == ("1", "7")
        assert _locked_kb() > 1000
        assert entered.text.startswith("real-time: SCHED_FIFO 7, memory locked, processors ")
    finally:
        entered.close()
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert _locked_kb() == 0


@pytest.mark.process
@allowed
def test_neither_children_nor_later_threads_inherit_the_policy() -> None:
    entered = RealTime(7)
    policies: list[int] = []
    try:
        child = subprocess.run([sys.executable, "-c", _POLICY], capture_output=True, text=True, check=True)
        thread = threading.Thread(target=lambda: policies.append(os.sched_getscheduler(0)))
        thread.start()
        thread.join()
    finally:
        entered.close()
    assert child.stdout.split()[0] == str(os.SCHED_OTHER)
    assert policies == [os.SCHED_OTHER]


@pytest.mark.process
@LINUX
def test_the_processor_is_taken_by_pin_and_given_back_to_a_child_and_at_the_end() -> None:
    everywhere = os.sched_getaffinity(0)
    one = min(everywhere)
    entered = RealTime(None, one)
    assert os.sched_getaffinity(0) == everywhere, "children are still to be started"
    entered.pin()
    assert os.sched_getaffinity(0) == {one}
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        entered.release(child.pid)
        assert os.sched_getaffinity(child.pid) == everywhere
    finally:
        child.communicate(b"\n")
    entered.release(child.pid)  # it has ended: nothing to do
    entered.close()
    assert os.sched_getaffinity(0) == everywhere
    assert entered.text == f"runs on processor {one}"


@LINUX
@pytest.mark.parametrize("cpu", [-1, 4000, 1 << 40])
def test_a_processor_that_is_not_there_is_refused_with_those_that_are(cpu: int) -> None:
    with pytest.raises(ConfigError, match=f"--cpu {cpu}: choose a processor that this process may use: 0"):
        RealTime(None, cpu)


@LINUX
def test_a_refused_priority_reports_the_command_for_this_shell_and_gives_back_what_was_had(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_arguments: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "geteuid", lambda: 1)
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(RealTime, "_lock_memory", lambda *_: None)
    with pytest.raises(ConfigError, match=r"real-time priority 40 cannot be set .Operation not permitted.") as caught:
        RealTime(40, min(os.sched_getaffinity(0)))
    assert "sudo prlimit --pid $$ --rtprio=40 --memlock=unlimited" in str(caught.value)
    assert "/etc/security/limits.d" in str(caught.value)
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    with pytest.raises(ConfigError, match="--cap-add SYS_NICE"):
        RealTime(40)


@LINUX
def test_a_limit_of_locked_memory_is_refused_before_it_can_make_an_allocation_fail(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import resource

    monkeypatch.setattr(resource, "getrlimit", lambda _which: (8 << 20, 8 << 20))
    monkeypatch.setattr(realtime, "_may_lock_all", lambda: False)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: pytest.fail("not even tried"))
    with pytest.raises(ConfigError, match=r"memory cannot be locked .locked memory is limited to 8192 kB"):
        RealTime(40)


@allowed
@pytest.mark.parametrize(
    ("reason", "text"),
    [("", "processors kept awake"), ("/dev/x: Permission denied", "processors may sleep (/dev/x: Permission denied)")],
)
def test_processors_are_kept_awake_or_it_is_reported_with_why_they_may_sleep(
    monkeypatch: pytest.MonkeyPatch, reason: str, text: str
) -> None:
    undone: list[str] = []

    def keep(undo: contextlib.ExitStack) -> str:
        undo.callback(undone.append, "asleep again")
        return reason

    monkeypatch.setattr(realtime, "keep_awake", keep)
    cpu = min(os.sched_getaffinity(0))
    entered = RealTime(7, cpu)
    assert entered.text == f"real-time: SCHED_FIFO 7, memory locked, {text}, on processor {cpu}"
    entered.close()
    assert undone == ["asleep again"]


def test_other_systems_are_reported_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    RealTime(None).close()
    for priority, cpu in ((40, None), (None, 0)):
        with pytest.raises(ConfigError, match="require Linux"):
            RealTime(priority, cpu)


def test_garbage_is_collected_by_hand_every_ten_seconds_and_the_collector_put_back_at_the_end() -> None:
    class Node:
        pass

    hooks: list = []
    with contextlib.ExitStack() as undo:
        keep_garbage_small(undo, hooks, by_hand=True)
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 1000
        collect = hooks[0].after_cycle
        collect(0)
        full = gc.get_stats()[2]["collections"]
        for second in range(1, 31):
            one, other = Node(), Node()
            one.other, other.other = other, one  # a cycle that only the collector takes away
            collect(second * 1_000_000_000)
        assert gc.get_stats()[2]["collections"] == full + 3
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


def test_without_real_time_the_collector_stays_on() -> None:
    hooks: list = []
    with contextlib.ExitStack() as undo:
        keep_garbage_small(undo, hooks, by_hand=False)
        assert gc.isenabled()
        assert not hooks


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


def test_a_machine_without_it_reports_this(tmp_path):
    with contextlib.ExitStack() as undo:
        assert keep_awake(undo, str(tmp_path / "none")) == f"{tmp_path}/none: No such file or directory"


def test_a_user_without_permission_gets_the_command_to_type(monkeypatch):
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
