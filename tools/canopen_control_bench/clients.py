"""`clients`: the effect of the ROS bridge, the view and the monitor on the cycle of the robot that they watch.

They are processes of their own, so that all they can take from the cycle is the machine. Blocks of two seconds with and
without them take turns, now this one first and now that one: a client that looks on is stopped by a signal for those
without, so that the machine, which changes from minute to minute, is the same for both. Processors are kept awake, and
the robot has one for itself: two runs without anybody differ by a third where they may sleep, and by a tenth even so.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import signal
import subprocess
import threading
import time
from typing import TYPE_CHECKING

from canopen_control.errors import CanopenError
from canopen_control.host.environment import MODULE, clean_environment
from canopen_control.ros.installation import require_ros
from canopen_control.runtime.realtime import keep_awake
from canopen_control_bench.cycle import OURS, ROBOT, Arena, absolutes_of
from canopen_control_bench.figure import Figure, compared, limited, percentiles
from canopen_control_bench.machine import apart
from canopen_control_bench.stage import stage

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control_bench.runner import Options
    from canopen_control_bench.stage import Contender
    from canopen_control_bench.turns import Turn


INFLUENCE_LIMIT = 1.05
PERIOD_US = 10_000
ROUNDS, BLOCKS = 5, 5  # cycles of each kind per round; a p99 of 200 cycles would be the second worst cycle
SECONDS, BLOCK_S = 60.0, 2.0
_SETTLE_S, _CATCH_UP_S = 3.0, 0.3
_LAST_WORDS_S = 2.0


def measure(options: Options) -> list[Figure]:
    """Measure with the extras that are installed; a quick run has no ratio to check here."""
    if options.quick:
        return []
    figures = []
    with stage() as played:
        arena = Arena(played, 2, PERIOD_US)
        with arena.contender(OURS, check=False) as contender:
            with contextlib.ExitStack() as undo:
                asleep = options.as_is or keep_awake(undo)
                figures += _influence(contender, "may sleep" if asleep else "awake", as_is=options.as_is)
            figures.append(_together(contender, arena, options.seconds or SECONDS))
    return figures


def has_ros() -> bool:
    """Whether the bridge can run here."""
    try:
        require_ros()
    except CanopenError:
        return False
    return True


def _influence(contender: Contender, processors: str, *, as_is: bool) -> list[Figure]:
    """Compare the p99 of the whole cycle with and without the view, and with and without the monitor."""
    figures = []
    for name, verb in (("view", ("view", "--port", "0")), ("monitor", ("monitor",))):
        if not has_extra(name):
            continue
        with on_a_terminal(*verb, "--name", ROBOT) as pid:
            time.sleep(_SETTLE_S)
            contender.others[name] = pid
            rounds = [_round(contender, pid, as_is=as_is) for _ in range(ROUNDS)]
            del contender.others[name]
        figures.append(
            compared(
                f"with the {name}: cycle, p99",
                "us",
                [(p99_of(watched), p99_of(alone)) for watched, alone in rounds],
                peer_name="without",
                limit=INFLUENCE_LIMIT,
                absolutes=absolutes_of([turn for watched, _ in rounds for turn in watched])
                | {"processors": processors},
            )
        )
    return figures


def _round(contender: Contender, client: int, *, as_is: bool) -> tuple[list[Turn], list[Turn]]:
    """Return blocks in which a client watches, and blocks in which it is stopped."""
    watched: list[Turn] = []
    alone: list[Turn] = []
    for number in range(BLOCKS):
        for looks_on in (number % 2 == 0, number % 2 == 1):
            with contextlib.nullcontext() if looks_on else stopped(client):
                time.sleep(_CATCH_UP_S)
                with contextlib.nullcontext() if as_is else apart(contender.pid, contender.others.values()):
                    turn = contender.turn(round(BLOCK_S * 1e6 / PERIOD_US), PERIOD_US * 1000)
            (watched if looks_on else alone).append(turn)
    return watched, alone


@contextlib.contextmanager
def stopped(leader: int) -> Iterator[None]:
    """Stop the processes of a group, and resume them at the end."""
    os.killpg(leader, signal.SIGSTOP)
    try:
        yield
    finally:
        os.killpg(leader, signal.SIGCONT)


def p99_of(turns: Sequence[Turn]) -> float:
    """Return the p99 of the whole cycle over several turns, in us."""
    return percentiles([whole_n for turn in turns for whole_n in turn.whole_ns], 1e-3)["p99"]


def has_extra(name: str) -> bool:
    """Whether the dependencies of the verb `view` or `monitor` are installed."""
    return importlib.util.find_spec({"view": "nicegui", "monitor": "textual"}[name]) is not None


def _together(contender: Contender, arena: Arena, seconds: float) -> Figure:
    """Run at 100 Hz with the bridge and the view; no cycle may be skipped."""
    with contextlib.ExitStack() as company:
        if has_ros():
            bridge = arena.stage.start("canopen_control.ros.bridge", "--name", ROBOT, ros=True)
            company.callback(bridge.end)
            contender.others["bridge"] = bridge.pid
        if has_extra("view"):
            contender.others["view"] = company.enter_context(on_a_terminal("view", "--port", "0", "--name", ROBOT))
        time.sleep(_SETTLE_S)
        turn = contender.turn(round(seconds * 1e6 / PERIOD_US), PERIOD_US * 1000)
    absolutes = absolutes_of([turn])
    return limited("100 Hz with bridge and view: cycles left out", "", [turn.missed], limit=0.0, absolutes=absolutes)


@contextlib.contextmanager
def on_a_terminal(*words: str) -> Iterator[int]:
    """Run a verb on a terminal that is not displayed, and yield its process id."""
    ours, theirs = os.openpty()
    process = subprocess.Popen(
        [*MODULE, "canopen_control", *words],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env={**clean_environment(ros=False), "TERM": "xterm-256color"},
        start_new_session=True,
    )
    os.close(theirs)
    said = bytearray()
    drain = threading.Thread(target=_drain, args=(ours, said), daemon=True)
    drain.start()
    try:
        yield process.pid
        if process.poll() is not None:
            drain.join(_LAST_WORDS_S)
            raise CanopenError(f"{words[0]} ended with {process.returncode}: {bytes(said)[-300:]!r}")
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        drain.join()
        os.close(ours)


def _drain(terminal: int, said: bytearray) -> None:
    """Read all output until it ends, keeping the last part."""
    with contextlib.suppress(OSError):
        while data := os.read(terminal, 65536):
            said += data
            del said[:-4096]
