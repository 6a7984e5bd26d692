"""Real-time scheduling of the robot's thread, for the options `--realtime` and `--cpu`.

If the kernel refuses a requested setting, the run ends before anything moves, and the error names the command that
would allow the setting. The only exception is disabling the CPU idle states, which most users are not allowed to do:
it is done if possible. No setting is inherited by child processes: the kernel resets the policy at every fork
(SCHED_RESET_ON_FORK, including later threads), exec unlocks the memory, the thread is pinned after the first children
were started, and `release` resets later children. The timer slack is left unchanged, because the cycle waits on
timerfd, which has no slack. `close` undoes all settings.

The garbage collector is called explicitly, every `_COLLECT_NS` after the frames of a cycle are sent; the objects
created during the start are frozen before, so that a full collection examines only later objects.
"""

from __future__ import annotations

import contextlib
import gc
import os
import struct
import sys
from typing import Final

from canopen_control.errors import ConfigError, RobotConfigError
from canopen_control.runtime.observer import RobotObserver

DEFAULT_PRIORITY: Final = 40  # below the interrupt threads of a PREEMPT_RT kernel (50), which receive the frames
HIGHEST_PRIORITY: Final = 99
LATENCY_DEVICE: Final = "/dev/cpu_dma_latency"
_NO_LATENCY: Final = struct.pack("=i", 0)  # us
_COLLECT_NS: Final = 10_000_000_000
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_CAP_IPC_LOCK: Final = 14


class RealTime:
    """Real-time settings of the calling thread: a `priority` for SCHED_FIFO or None, a fixed `cpu` or None.

    Raises ConfigError if the kernel refuses a setting. `text` describes the settings, "" without any; `pin` must be
    called to bind the thread to the `cpu`.
    """

    def __init__(self, priority: int | None, cpu: int | None = None) -> None:
        self._undo = contextlib.ExitStack()
        self._cpu = cpu
        self._processors: set[int] = set()
        self.text = ""
        try:
            self._enter(priority)
        except BaseException:
            self.close()
            raise

    def _enter(self, priority: int | None) -> None:
        if (priority is not None or self._cpu is not None) and not sys.platform.startswith("linux"):
            raise RobotConfigError("--realtime and --cpu require Linux; omit them")
        texts = []
        if self._cpu is not None:
            self._try_pin(self._cpu)
            texts.append(f"on processor {self._cpu}")
        if priority is not None:
            self._lock_memory(priority)
            self._schedule(priority)
            asleep = keep_awake(self._undo)
            awake = f"processors may sleep ({asleep})" if asleep else "processors kept awake"
            texts[:0] = [f"SCHED_FIFO {priority}", "memory locked", awake]
        if texts:
            self.text = f"real-time: {', '.join(texts)}" if priority is not None else f"runs {texts[0]}"

    def pin(self) -> None:
        """Bind the calling thread to the processor `cpu`, if given."""
        if self._cpu is not None:
            os.sched_setaffinity(0, {self._cpu})
            self._undo.callback(os.sched_setaffinity, 0, self._processors)

    def release(self, pid: int) -> None:
        """Remove the processor binding of a child process."""
        if self._cpu is not None:
            with contextlib.suppress(ProcessLookupError):
                os.sched_setaffinity(pid, self._processors)

    def close(self) -> None:
        self._undo.close()

    def _try_pin(self, cpu: int) -> None:
        self._processors = os.sched_getaffinity(0)
        try:
            os.sched_setaffinity(0, {cpu})
        except (OSError, ValueError, OverflowError):
            processors = ", ".join(map(str, sorted(self._processors)))
            raise RobotConfigError(f"--cpu {cpu}: choose a processor that this process may use: {processors}") from None
        os.sched_setaffinity(0, self._processors)

    def _schedule(self, priority: int) -> None:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[1]
        if 0 < priority <= limit or limit == resource.RLIM_INFINITY:
            resource.setrlimit(resource.RLIMIT_RTPRIO, (limit, limit))
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        except OSError as error:
            raise _refused(f"real-time priority {priority} cannot be set", error, priority) from None
        self._undo.callback(os.sched_setscheduler, 0, *before)

    def _lock_memory(self, priority: int) -> None:
        """Lock all current and future pages in memory.

        Raise ConfigError if a limit could make a later allocation fail.
        """
        import ctypes
        import resource

        hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)[1]
        if hard != resource.RLIM_INFINITY and not _may_lock_all():
            error = OSError(0, f"locked memory is limited to {hard // 1024} kB")
            raise _refused("its memory cannot be locked", error, priority)
        with contextlib.suppress(ValueError):
            resource.setrlimit(resource.RLIMIT_MEMLOCK, (hard, hard))
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
            number = ctypes.get_errno()
            raise _refused("its memory cannot be locked", OSError(number, os.strerror(number)), priority)
        self._undo.callback(libc.munlockall)


def keep_garbage_small(undo: contextlib.ExitStack, observers: list[RobotObserver], *, by_hand: bool) -> None:
    """Exclude existing objects from garbage collection; with `by_hand`, collect only after cycles."""
    gc.collect()
    gc.freeze()
    undo.callback(gc.unfreeze)
    if not by_hand:
        return
    gc.disable()
    undo.callback(gc.enable)
    observers.append(_Collector())


class _Collector(RobotObserver):
    """Observer that collects garbage after a cycle, every `_COLLECT_NS`."""

    _next_collection = 0

    def after_cycle(self, now: int) -> None:
        if now >= self._next_collection:
            self._next_collection = now + _COLLECT_NS
            gc.collect()


def _may_lock_all() -> bool:
    """Whether this process may lock unlimited memory (CAP_IPC_LOCK)."""
    with open("/proc/self/status", encoding="ascii") as status:
        capabilities = next(line for line in status if line.startswith("CapEff:")).split()[1]
    return bool(int(capabilities, 16) >> _CAP_IPC_LOCK & 1)


def _refused(request: str, error: OSError, priority: int) -> ConfigError:
    """Return the error for a refused setting, with the commands that permit it."""
    import pwd

    if os.geteuid() == 0:
        allow = "this looks like a container: start it with --cap-add SYS_NICE --cap-add IPC_LOCK"
    else:
        user = pwd.getpwuid(os.geteuid()).pw_name
        allow = (
            f"for this shell type: sudo prlimit --pid $$ --rtprio={priority} --memlock=unlimited   Permanently, from "
            f"the next login on: printf '{user} - rtprio {priority}\\n{user} - memlock unlimited\\n' | "
            "sudo tee /etc/security/limits.d/canopen_control.conf"
        )
    return RobotConfigError(f"--realtime: {request} ({error.strerror}); {allow}")


def keep_awake(undo: contextlib.ExitStack, device: str = LATENCY_DEVICE) -> str:
    """Keep all processors out of idle states (PM QoS) until `undo` is closed; return the reason for a failure, or "".

    An idle processor enters a sleep state, and leaving that state takes 1 to 200 us on real processors, 20 to 40 us on
    virtual processors, at every timer and every frame. While the file `/dev/cpu_dma_latency` is open and contains 0,
    idle processors spin instead (Linux, Documentation/power/pm_qos_interface.rst). This costs power, and ends with the
    process at the latest.
    """
    try:
        descriptor = os.open(device, os.O_WRONLY | os.O_CLOEXEC)
        undo.callback(os.close, descriptor)
        os.write(descriptor, _NO_LATENCY)
    except PermissionError as error:
        return f"{device}: {error.strerror}; to allow it type: sudo setfacl -m u:$USER:w {device}"
    except OSError as error:
        return f"{device}: {error.strerror}"
    return ""
