"""`cycle`: two drives, SYNC, two RPDOs and TPDOs each; our complete runtime against packages that only exchange them.

All take turns on one `local:` bus with the same virtual drives, in a process of their own: the runtime with diff drive,
joint states, supervision, 402 machines and API; the `canopen` package; python-can with a codec written by hand. Who has
its turn has a processor for itself, bus and drives the other: whoever the kernel puts aside for the bus it has just
woken would pay for that, and each of them is at its best so. Before the clock starts, a listener looks at the bytes of
every cycle; while it runs, the drives repeat what they sent last (`canopen_control_bench.slaves`), since those of a
real robot use no processor of its computer.

Paced as users run it, two drives and fleets, the wake-ups of the runtime are counted beside its CPU, and its system
calls for a second: counts are the same on a machine that has other things to do.
"""

from __future__ import annotations

import contextlib
import functools
import os
import threading
import time
from typing import TYPE_CHECKING, TypeVar

from canopen_control.bus.local import ask_hub
from canopen_control.client.robot_client import RobotClient
from canopen_control.errors import CanopenError, RemoteError
from canopen_control.rpc.messages.hub import GetHubStatus
from canopen_control.rpc.messages.robot import CommandController, GetStatus, TwistController
from canopen_control.version import COMPILED, build
from canopen_control_bench.figure import Figure, compared, limited, percentiles
from canopen_control_bench.fleet import CONTROLLER, FIRST_NODE, RADIUS_M, SCALE, write_fleet
from canopen_control_bench.listener import cycles_of, judge, listening
from canopen_control_bench.machine import apart, may_be_realtime
from canopen_control_bench.peers.pattern import target
from canopen_control_bench.stage import EDS, Contender, Slaves, Stage, stage
from canopen_control_bench.system_calls import count_calls
from canopen_control_bench.witness import unwitnessed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from canopen_control.frame import CanFrame
    from canopen_control.rpc.messages.declare import Request
    from canopen_control_bench.runner import Options
    from canopen_control_bench.turns import Turn


A = TypeVar("A")
OURS, PYTHON_CAN = "runtime", "python-can"
CANOPEN = "canopen"  # without its own thread: the faster of its two idioms
CANOPEN_THREADED = "canopen, its thread"
NAMES = (OURS, CANOPEN, CANOPEN_THREADED, PYTHON_CAN)
ROUNDS = 5
CPU_LIMIT, WAKE_LIMIT, LATE_LIMIT_US = 0.25, 0.4, 250.0
REALTIME_S = 60.0
PACED = (OURS, CANOPEN, PYTHON_CAN)
FAST_US = 1000
#: label: period in us and number of cycles per turn; not in a quick run
SLOWER = {"100 Hz": (10_000, 200), "500 Hz": (2000, 1000)}
#: label: drives, period in us and number of cycles per turn; not in a quick run
FLEETS = {"16 drives, 50 Hz": (16, 20_000, 150), "64 drives, 50 Hz": (64, 20_000, 100)}
FLEET_ROUNDS = 3
#: fraction of canopen's CPU time if CPUs may enter idle states, with the compiled cycle
AS_IS_LIMITS = {"1 kHz": 0.4, "100 Hz": 0.45, "16 drives, 50 Hz": 0.3, "64 drives, 50 Hz": 0.15}
COUNTED = "100 Hz"
WAKEUPS_LIMIT, CALLS_LIMIT = (
    1.3,
    5.0,
)  # per cycle of two drives at 100 Hz: one, four, and those of 20 commands a second
_BUS = ROBOT = "bench"
_CHECKED_CYCLES, _CHECKED_US, _ATTEMPTS = 100, 10_000, 5
_COUNTED_S = 1.0
_SETTLE_S, _SETTLED = 20.0, 0.01  # rad/s
_SPEED = 0.5  # m/s


class Arena:
    """A bus with drives, and the contenders that use it in turns."""

    def __init__(
        self,
        played: Stage,
        count: int,
        period_us: int,
        *,
        base: bool = True,
        cpu: int | None = None,
        buses: Sequence[str] = (_BUS,),
    ) -> None:
        self.stage, self.count, self.period_us = played, count, period_us
        self.base, self.cpu, self.buses = base, cpu, buses
        self.channel = f"local:{buses[0]}"
        self.nodes = range(FIRST_NODE, FIRST_NODE + count // len(buses))
        self.others: dict[str, int] = {}
        self.slaves: list[Slaves] = []
        for bus in buses:
            drives = played.slaves(f"local:{bus}", FIRST_NODE, len(self.nodes))
            self.slaves.append(drives)
            more = "" if bus == buses[0] else f" of {bus}"
            self.others |= {f"drives{more}": drives.pid, f"hub{more}": ask_hub(bus, GetHubStatus()).pid}
        self.robot = self._write()

    def _write(self) -> Path:
        return write_fleet(self.stage.folder, self.count, self.period_us, base=self.base, buses=len(self.buses))

    @property
    def _channels(self) -> str:
        names = ["", *(f"b{number}=" for number in range(1, len(self.buses)))]
        return ",".join(f"{name}local:{bus}" for name, bus in zip(names, self.buses, strict=True))

    def pace(self, period_us: int) -> None:
        """Set the cycle period of our robot."""
        if period_us != self.period_us:
            self.period_us = period_us
            self.robot = self._write()

    @contextlib.contextmanager
    def contender(self, name: str, *, check: bool = True) -> Iterator[Contender]:
        """Give the bus to a contender, after checking its bytes. Ours is commanded meanwhile."""
        if name != OURS:
            contender = self._peer(name)
            if check:
                self.check(contender, lambda number, position: (target(number, position),))
            yield contender
            contender.leave()
            return
        if check:
            self._check_ours()
        contender = self.ours()
        with commanding(self) as move:
            move()
            yield contender
        contender.leave()

    def _check_ours(self) -> None:
        """Check our bytes at a slow pace, which leaves drives and listener enough CPU time."""
        period_us = self.period_us
        self.pace(max(period_us, _CHECKED_US))
        contender = self.ours()
        with commanding(self):
            _settle()
            self.check(contender, self._expected_of_ours)
        contender.leave()
        self.pace(period_us)

    @contextlib.contextmanager
    def replayed(self) -> Iterator[None]:
        """Have the drives answer like real ones, using almost no CPU time of this machine."""
        for slaves in self.slaves:
            slaves.replay(True)
        yield
        for slaves in self.slaves:
            slaves.replay(False)

    def ours(self) -> Contender:
        """Start our runtime without commands, and return it when it is running."""
        cpu = [] if self.cpu is None else [str(self.cpu)]
        ours = ["canopen_control_bench.subject", str(self.robot), ROBOT, self._channels, *cpu]
        return self.stage.contender(*ours, others=self.others)

    def _peer(self, name: str) -> Contender:
        module = "pythoncan_pdo" if name == PYTHON_CAN else "canopen_pdo"
        words = [self.channel, EDS, str(FIRST_NODE), str(self.count), *(["--inline"] if name == CANOPEN else [])]
        return self.stage.contender(f"canopen_control_bench.peers.{module}", *words, others=self.others)

    def check(self, contender: Contender, expected: Callable[[int, int], Sequence[int]]) -> None:
        """Check the bytes of some cycles; raises CanopenError with what is wrong.

        Where it is only that the drives had no processor for long, on a busy machine, it is looked at again.
        """
        offset = 0 if contender.words[0].endswith("subject") else 1
        for attempt in range(_ATTEMPTS):
            cycles = cycles_of(self._listen(contender))
            verdict = judge(cycles, self.nodes, lambda number, position: expected(number + offset, position))
            if not verdict.count and verdict.cycles >= _CHECKED_CYCLES // 2:
                return
            if verdict.count > verdict.starved or attempt == _ATTEMPTS - 1:
                raise CanopenError(
                    f"{contender.words[0]}: {verdict.count} mistakes in the bytes of {verdict.cycles} cycles, "
                    f"{verdict.late} of them late: {'; '.join(verdict.wrong)}"
                )

    def _listen(self, contender: Contender) -> list[CanFrame]:
        period_ns = max(self.period_us, _CHECKED_US) * 1000
        with listening(self.channel) as hear:
            contender.order(_CHECKED_CYCLES, period_ns)
            frames = hear(_CHECKED_CYCLES * period_ns / 1e9 + 0.3)
            contender.answer()
        return frames

    def _expected_of_ours(self, _number: int, _position: int) -> Sequence[int]:
        """Return the target velocities of ours when driving straight ahead, by base or by forward controller."""
        radians = _SPEED / RADIUS_M
        return (round(radians * SCALE), int(radians * SCALE))


@contextlib.contextmanager
def commanding(arena: Arena) -> Iterator[Callable[[], None]]:
    """Command our robot over its API at 20 Hz: straight ahead, and faster and slower once the function was called."""
    ended, moves = threading.Event(), threading.Event()

    def command(client: RobotClient) -> None:
        number = 0
        while not ended.wait(0.05):
            number += 1
            speed = _SPEED * (1 if not moves.is_set() or number // 20 % 2 else -1)
            with contextlib.suppress(RemoteError):
                if arena.base:
                    client.notify(TwistController(controller=CONTROLLER, linear=speed, angular=0.0, source="bench"))
                else:
                    values = [speed / RADIUS_M] * arena.count
                    client.notify(CommandController(controller=CONTROLLER, values=values, source="bench"))

    client = RobotClient.connect(ROBOT)
    thread = threading.Thread(target=command, args=(client,), daemon=True)
    thread.start()
    try:
        yield moves.set
    finally:
        ended.set()
        thread.join()
        client.close()


def _settle() -> None:
    """Wait until all wheels turn at their commanded speed, and the limiter is idle."""
    end = time.monotonic() + _SETTLE_S
    wanted = _SPEED / RADIUS_M
    while time.monotonic() < end:
        time.sleep(0.2)
        joints = ask_robot(GetStatus()).joints.values()
        if all(abs((joint.velocity or 0.0) - wanted) < _SETTLED for joint in joints):
            return
    raise CanopenError(f"the wheels do not reach {wanted:.1f} rad/s within {_SETTLE_S:g} s")


def ask_robot(request: Request[A]) -> A:
    """Send a request to our robot over its API."""
    client = RobotClient.connect(ROBOT)
    try:
        return client.ask(request)
    finally:
        client.close()


def rounds_of(
    arena: Arena,
    names: Sequence[str],
    count: int,
    run: Callable[[Contender], A],
    *,
    check: bool = True,
    as_is: bool = False,
) -> dict[str, list[A]]:
    """Run the contenders in turns, `count` times each, without pauses; the bytes of the first turns are checked.

    Each has a processor for itself meanwhile, but for `as_is`.
    """
    turns: dict[str, list[A]] = {name: [] for name in names}
    for number in range(count):
        for name in names:
            with arena.contender(name, check=check and number == 0) as contender, arena.replayed():
                alone = contextlib.nullcontext() if as_is else apart(contender.pid, arena.others.values())
                with alone:
                    turns[name].append(run(contender))
    return turns


def measure(options: Options) -> list[Figure]:
    """Measure free-running and paced cycles; a contender that has run freely is paced at 1 kHz right after."""
    names = (OURS, CANOPEN) if options.quick else NAMES
    free_cycles, paced_cycles = (1000, 1000) if options.quick else (3000, 2000)
    with stage() as played:
        arena = Arena(played, 2, FAST_US)

        def free_and_fast(contender: Contender) -> tuple[Turn, Turn]:
            return contender.turn(free_cycles, 0), contender.turn(paced_cycles, FAST_US * 1000)

        both = rounds_of(arena, names, ROUNDS, free_and_fast, as_is=options.as_is)
        figures = cpu_figures("free-running", {name: [free for free, _ in turns] for name, turns in both.items()})
        fast = {name: [paced for _, paced in turns] for name, turns in both.items()}
        figures += _paced_figures("1 kHz", fast, options)
        for label, (period_us, cycles) in () if options.quick else SLOWER.items():
            arena.pace(period_us)
            run = functools.partial(Contender.turn, cycles=cycles, period_ns=period_us * 1000)
            turns = rounds_of(arena, PACED, ROUNDS, run, as_is=options.as_is)
            figures += _paced_figures(label, turns, options)
            if label == COUNTED:
                figures += [wakeups_figure(label, turns[OURS]), *_calls(arena, label)]
    return figures if options.quick else [*figures, *_fleets(options), *_realtime(options.seconds or REALTIME_S)]


def _paced_figures(label: str, turns: dict[str, list[Turn]], options: Options) -> list[Figure]:
    paced = {name: turns[name] for name in turns if name in PACED}
    return [*cpu_figures(label, paced, as_is=options.as_is), *wake_figures(label, turns, quick=options.quick)]


def _fleets(options: Options) -> list[Figure]:
    """Measure fleets at a fixed pace against canopen, whose bytes are checked by `scale`."""
    figures = []
    for label, (count, period_us, cycles) in FLEETS.items():
        with stage() as played:
            arena = Arena(played, count, period_us, base=False)
            run = functools.partial(Contender.turn, cycles=cycles, period_ns=period_us * 1000)
            turns = rounds_of(arena, (OURS, CANOPEN), FLEET_ROUNDS, run, check=False, as_is=options.as_is)
            figures += cpu_figures(label, turns, as_is=options.as_is)
    return figures


def wakeups_figure(label: str, turns: Sequence[Turn]) -> Figure:
    """Return how often the runtime woke per cycle: once, plus the commands of its client."""
    woken = [turn.wakeups / turn.cycles for turn in turns]
    return limited(f"cycle, {label}: wake-ups", "", woken, limit=WAKEUPS_LIMIT, counted=True)


def _calls(arena: Arena, label: str) -> list[Figure]:
    """Count the system calls of the runtime for a second, if strace is available."""
    with arena.contender(OURS, check=False) as contender, arena.replayed():
        cycles = 4_000_000 // arena.period_us
        contender.order(cycles, arena.period_us * 1000)
        begin = time.monotonic()
        calls = count_calls(contender.pid, _COUNTED_S)
        contender.answer()
    if not calls or time.monotonic() - begin < _COUNTED_S:
        return []
    each = {name: round(count * arena.period_us / _COUNTED_S / 1e6, 2) for name, count in calls.items()}
    told = dict(sorted(each.items(), key=lambda item: -item[1])[:6])
    found = sum(calls.values()) * arena.period_us / _COUNTED_S / 1e6
    return [limited(f"cycle, {label}: system calls", "", [found], limit=CALLS_LIMIT, absolutes=told, counted=True)]


def _realtime(seconds: float) -> list[Figure]:
    """Run at 1 kHz with --realtime --cpu: no cycle may be skipped, and almost none may be late.

    A witness on the same processor tells which of those left out the machine itself stood still for.
    """
    if not may_be_realtime():
        return []
    cpu, period_ns = max(os.sched_getaffinity(0)), 1_000_000
    with stage() as played:
        arena = Arena(played, 2, period_ns // 1000, cpu=cpu)
        with arena.contender(OURS) as contender:
            witness = played.witness(cpu, period_ns // 2)
            turn = contender.turn(round(seconds * 1e9 / period_ns), period_ns)
            stalls = witness.stalls()
    return realtime_figures(turn, stalls, period_ns)


def realtime_figures(turn: Turn, stalls: Sequence[tuple[int, int]], period_ns: int) -> list[Figure]:
    """Return the figures of a turn with --realtime, corrected by the stalls that a witness saw."""
    ours = sum((woke - edge) // period_ns for edge, woke in unwitnessed(turn.stalls, stalls))
    late = percentiles(turn.late_ns, 1e-3)["p99.9"]
    seen = absolutes_of([turn]) | {"stalls of the machine": len(stalls)}
    return [
        limited("1 kHz --realtime: cycles left out by ours", "", [ours], limit=0.0, absolutes=seen),
        limited("1 kHz --realtime: lateness, p99.9", "us", [late], limit=LATE_LIMIT_US),
    ]


def cpu_figures(label: str, turns: dict[str, list[Turn]], *, as_is: bool = False) -> list[Figure]:
    """Return CPU time per cycle against each peer; with `as_is`, CPUs may idle, and the compiled build is judged."""
    paced = AS_IS_LIMITS.get(label) if as_is and build() == COMPILED else None
    return [
        compared(
            f"cycle, {label}: CPU",
            "us",
            [(ours.cpu_us, peer.cpu_us) for ours, peer in zip(turns[OURS], turns[name], strict=True)],
            peer_name=name,
            limit=None if name != CANOPEN else paced if turns[OURS][0].late_ns else CPU_LIMIT,
            absolutes=absolutes_of(turns[OURS]),
        )
        for name in turns
        if name != OURS
    ]


def wake_figures(label: str, turns: dict[str, list[Turn]], *, quick: bool = False) -> list[Figure]:
    """Return p90 and p99 of the time from wake-up to the last frame of the cycle on the bus.

    A quick run has a limit for p90 only: ten cycles decide the p99 of its turns, and on a shared machine the host takes
    the processor away in more than ten, from ours and from the peer, so that the ratio approaches 1.
    """
    figures = []
    for name in ("p90", "p99"):
        rounds = [
            (percentiles(ours.work_ns, 1e-3)[name], percentiles(peer.work_ns, 1e-3)[name])
            for ours, peer in zip(turns[OURS], turns[CANOPEN], strict=True)
        ]
        limit = WAKE_LIMIT if label == "1 kHz" and (name == "p90" or not quick) else None
        figures.append(compared(f"cycle, {label}: wake to RPDO, {name}", "us", rounds, peer_name=CANOPEN, limit=limit))
    return figures


def absolutes_of(turns: Sequence[Turn]) -> dict[str, float]:
    """Return the other results of some turns: percentiles in us, and CPU time per cycle of the other processes."""
    cycles = sum(turn.cycles for turn in turns)
    found: dict[str, float] = {"cycles": cycles, "missed": sum(turn.missed for turn in turns)}
    for key, values in (
        ("late", [late_n for turn in turns for late_n in turn.late_ns]),
        ("wake to RPDO", [work_n for turn in turns for work_n in turn.work_ns]),
    ):
        if values:
            found.update((f"{key} {name} us", round(value, 1)) for name, value in percentiles(values, 1e-3).items())
    for name in turns[0].others_ns:
        found[f"{name} CPU us"] = round(sum(turn.others_ns[name] for turn in turns) / cycles / 1000, 1)
    for name in turns[0].others_wakeups:
        found[f"{name} wake-ups"] = round(sum(turn.others_wakeups[name] for turn in turns) / cycles, 2)
    return found
