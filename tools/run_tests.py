"""The parts of ./tools/test: their commands, which of them run in parallel, and their report.

tools/test prepares the environment and starts this program in the checkout's folder. Each part is one command in a
process group of its own. A lane runs its parts one after the other, and lanes run at the same time. The output of a
part is printed in one piece when the part has ended.

This process adopts what its parts leave behind (PR_SET_CHILD_SUBREAPER, prctl(2)): the CPU time that is printed is that
of every process, and none is left when the run ends, however it ends.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

GOOD, FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130  # 130: 128 + SIGINT, as shells report it
_PR_SET_CHILD_SUBREAPER: Final = 36
_GRACE_S: Final = 10.0  # time in s that pytest and the robots in its tests need to end after SIGINT
_TESTS_FAILED: Final = 1  # pytest: all tests ran and some failed; other codes mean that they could not be run
_NO_TESTS: Final = 5
_NOT_RUN: Final = 1
_NO_GUEST: Final = 2  # exit code of tools/guest/run_tests: the guest is not available on this machine
_KIND: Final = "CANOPEN_CONTROL_GUEST_KIND"  # environment variable for the tests of a guest
# adopted processes are reaped at this interval: tests check that ended processes have disappeared
_TURN_S: Final = 0.02
_PROGRESS_TURNS: Final = 50
_OF_CHECKS: Final = 450_000  # ruff and mypy take about as long as the tests in this number of bytes
_GIVING_WAY: Final = 3  # niceness of parts that only compute, next to tests that wait for other processes
_LEAVING_ALL: Final = 19  # niceness of parts that only compute, next to robots with limited reaction times
_COMPILE: Final = "compile"
# fraction of a property's examples; the pure-Python run tests more examples of the same property
_COMPILED_SHARE: Final = "0.1"
_KEPT_OUT: Final = "not socketcan and not hardware"  # these need a kernel with CAN, as in the guests

#: Marks of tests that start processes. tests/conftest.py requires that they are in the test's own file.
PROCESS_MARKS: Final = ("process", "ros", "wheel", "browser", "socketcan", "tmux", "hardware")
#: Folders of tests of whole processes.
PROCESS_FOLDERS: Final = ("bench", "integration", "socketcan", "hardware_can", "tools")
#: Kinds of tests that run in ./tools/test --rest instead of ./tools/test, in addition to `rest`.
REST_KINDS: Final = ("alone", "timed", "wheel", "socketcan", "hardware")
#: Files with long tests, below tests/; the default run has faster tests of the same subjects.
REST_FILES: Final = frozenset(
    {
        "cli/test_clone.py",
        "cli/test_jog.py",
        "cli/test_ros.py",
        "docs/test_adapter_howto.py",
        "docs/test_examples.py",
        "docs/test_firmware_page.py",
        "faults/test_together.py",
        "integration/test_configs.py",
        "integration/test_drive_page.py",
        "integration/test_examples.py",
        "integration/test_flight.py",
        "integration/test_interop_services.py",
        "integration/test_kill_sweep.py",
        "integration/test_latched_restart.py",
        "integration/test_listeners.py",
        "integration/test_peer_files.py",
        "integration/test_recorded_scenario.py",
        "integration/test_report_browser.py",
        "integration/test_ros_axes.py",
        "integration/test_ros_bases.py",
        "integration/test_ros_compiled.py",
        "integration/test_ros_network.py",
        "integration/test_ros_services.py",
        "integration/test_ros_simulation.py",
        "integration/test_ros_trajectories.py",
        "integration/test_same_motion.py",
        "integration/test_set_points.py",
        "integration/test_square.py",
        "integration/test_starting.py",
        "integration/test_trajectories.py",
        "integration/test_trajectory_shapes.py",
        "integration/test_true_pose_of_a_run.py",
        "integration/test_tutorials.py",
        "integration/test_virtual_drive_and_canopen.py",
        "physics/test_ground_contact_mecanum_contact.py",
        "ros/test_bridge.py",
        "runtime/test_setpoints_properties.py",
        "runtime/test_shared_world.py",
        "simulation/test_cluster.py",
        "tools/test_campaign.py",
        "tools/test_campaign_health.py",
        "tools/test_campaign_nightly.py",
        "tools/test_campaign_observer.py",
        "tools/test_campaign_script.py",
        "tools/test_guests.py",
    }
)
#: Tests of simulated and of whole robots that also run with the compiled package.
COMPILED_SIMULATIONS: Final = ("simulation/test_campaign.py", "simulation/test_simulation_run.py")
COMPILED_ROBOTS: Final = ("integration/test_run.py", "integration/test_recovery.py", "integration/test_same_motion.py")
#: Loops in which ROS programs froze earlier: CANOPEN_CONTROL_LOOP_S is the duration of each.
ROS_LOOPS: Final = "tests/integration/test_ros_freezes.py"
ROBOTS_ON_KERNEL_CAN: Final = tuple(
    f"integration/test_{name}.py"
    for name in ("run", "recovery", "same_motion", "interop_sdo", "virtual_drive_and_canopen")
)
#: Debian packages of --rest, each with a program that shows whether it is installed.
SCREENS: Final = {"chromium": ("chromium",), "tmux": ("tmux",)}
GUESTS: Final = {
    "tools/socketcan_guest": ("user-mode-linux", "can-utils", "iproute2", "kmod"),
    "tools/can_hardware_guest": ("qemu-system-x86", "busybox-static", "cpio", "can-utils", "iproute2"),
}


class UsageError(Exception):
    """The arguments of ./tools/test name something that does not exist."""


@dataclass(frozen=True)
class Part:
    """One command of a run.

    `second_look` is the command that runs the failed tests of this part once more, None where a failure is final.
    `needs` names a part of an earlier step, of another lane, or before it in its lane: this part waits for the end of
    that one, and where that one has failed, this part fails without being run.
    """

    name: str
    command: tuple[str, ...]
    environment: dict[str, str] = field(default_factory=dict)
    nice: int = 0
    second_look: tuple[str, ...] | None = None
    needs: str = ""

    @property
    def cache(self) -> Path:
        """The cache folder of pytest for this part."""
        return Path(".pytest_cache", re.sub(r"\W+", "_", self.name))


@dataclass
class Result:
    """The result of a part: exit code, wall clock time and CPU time in s."""

    part: Part
    code: int
    wall: float
    cpu: float
    failed: tuple[str, ...] = ()


# ---------------------------------------------------------------------------------------------------- parts


def pytest(name: str, expression: str, *arguments: str, compiled: Path | None = None, again: bool = False) -> Part:
    """Return the part that runs the tests selected by EXPRESSION, on the compiled package if its folder is given.

    With `again`, tests that fail are run once more when nothing else runs, and the second result counts.
    """
    python = [sys.executable, *(["-P"] if compiled else []), "-m", "pytest", "-q", "-rs"]
    selection = f"{_KEPT_OUT} and ({expression})" if expression else _KEPT_OUT
    part = Part(name, (*python, "-m", selection, *arguments))
    part = replace(part, command=(*part.command, "-o", f"cache_dir={part.cache}"))
    if compiled:
        environment = {"PYTHONPATH": str(compiled), "CANOPEN_CONTROL_EXAMPLES_SHARE": _COMPILED_SHARE}
        part = replace(part, environment=environment, needs=_COMPILE)
    if again:
        part = replace(part, second_look=(*_in_one_process(part.command), "--last-failed", "--maxfail=3", "-v"))
    return part


def _in_one_process(command: Sequence[str]) -> tuple[str, ...]:
    return (*command, "-n", "0")


def files_with(*marks: str) -> list[str]:
    """Return the test files that contain one of the marks, sorted.

    The files of PROCESS_FOLDERS belong to the mark `process` without naming it.
    """
    named = re.compile(rf"mark\.({'|'.join(marks)})\b")
    found = []
    for path in sorted(Path("tests").rglob("test_*.py")):
        whole = "process" in marks and path.parts[1] in PROCESS_FOLDERS
        if whole or named.search(path.read_text(encoding="utf-8")):
            found.append(str(path))
    return found


def checks() -> list[Part]:
    """Return the parts that check the sources without running them."""
    ruff = (sys.executable, "-m", "ruff")
    return [
        Part("ruff check", (*ruff, "check", ".")),
        Part("ruff format", (*ruff, "format", "--check", ".")),
        Part("mypy --strict", (sys.executable, "-m", "mypy"), nice=_GIVING_WAY),
    ]


DEALT: Final = ("-n", "2", "--dist", "worksteal")  # tests without processes: no CPU is idle at the end of a long file
# the tests of a file share its fixtures, such as running robots and browsers
SHARED: Final = ("-n", "2", "--dist", "loadfile")
SHARED_BY_3: Final = ("-n", "3", "--dist", "loadfile")  # without limits in time: they wait for half of their duration
APART: Final = ("-n", "8", "--dist", "loadgroup")  # a few tests that mostly wait for answers: all at once


def default_lanes() -> list[list[Part]]:
    """Return the lanes of ./tools/test: tests that only compute, alongside tests that wait for processes.

    The tests without a process run in two plain pytest processes. Workers of pytest-xdist would each collect all of
    them, which takes longer than an uneven end costs: the third lane fills it.
    """
    slow = pytest("tests with processes", "process and not rest", *SHARED, *files_with(*PROCESS_MARKS))
    one, two = (
        replace(
            pytest(f"tests without a process, {number} of 2", "not process and not rest", *paths),
            nice=_GIVING_WAY,
        )
        for number, paths in enumerate(halves(), 1)
    )
    return [[slow], [*checks(), one], [two]]


def halves() -> tuple[list[str], list[str]]:
    """Return the folders and files with tests that start no process, in two lists of similar size in bytes."""
    halves: tuple[list[str], list[str]] = ([], [])
    sizes = [0, _OF_CHECKS]
    entries = {
        str(path): sum(file.stat().st_size for file in path.rglob("test_*.py"))
        if path.is_dir()
        else path.stat().st_size
        for path in Path("tests").iterdir()
        if path.is_dir() or path.match("test_*.py")
        if path.name not in PROCESS_FOLDERS
    }
    for name, size in sorted(entries.items(), key=lambda entry: (-entry[1], entry[0])):
        smaller = sizes[0] > sizes[1]
        if size:
            halves[smaller].append(name)
            sizes[smaller] += size
    return halves[1], halves[0]


def rest_steps() -> list[list[list[Part]]]:
    """Return the steps of ./tools/test --rest, each a list of lanes: everything that the default run omits.

    Whole robots whose reactions have a limit in time (`timed`) run two at a time, what measures (`alone`) runs alone.
    What only computes has the lowest priority, and takes what they leave: the compiled package and the long tests
    without a process, in one pytest process each, since workers of pytest-xdist would each collect all of them. The
    timed tests come first: they leave most of the processors to the compiler, for which the robots on the compiled
    package wait at the end. The loops of ROS programs are a step of their own where they run for longer.
    """
    compiled = Path("build/compiled").absolute()
    rest = rest_files()
    with_processes = set(files_with(*PROCESS_MARKS))
    long = pytest("long tests with processes", "process and rest and not alone and not timed", *SHARED_BY_3,
                  *(path for path in rest if path in with_processes), again=True)  # fmt: skip
    long_fast = pytest("long tests without a process", "not process and rest and not alone and not timed", *rest,
                       again=True)  # fmt: skip
    compiled_modules = pytest("compiled, tests of its modules", "not sources and not rest",
                              *files_of_compiled_modules(), *(f"tests/{name}" for name in COMPILED_SIMULATIONS),
                              compiled=compiled, again=True)  # fmt: skip
    compiled_robots = pytest("compiled, whole robots", "not sources", *SHARED,
                             *(f"tests/{name}" for name in COMPILED_ROBOTS), compiled=compiled, again=True)  # fmt: skip
    loops = [ROS_LOOPS] if os.environ.get("CANOPEN_CONTROL_LOOP_S") else []
    timed = pytest("timed tests", "timed and not alone", *SHARED,
                   *(path for path in files_with("timed") if path not in loops), again=True)  # fmt: skip
    long_loops = pytest("loops of ROS programs", "timed", *APART, *loops, again=True)
    alone = pytest("tests that measure", "alone", *files_with("alone"), again=True)
    computing = [[Part(_COMPILE, ("tools/compile",)), compiled_modules], [long_fast]]
    return [
        [*([replace(part, nice=_LEAVING_ALL) for part in lane] for lane in computing), [timed, long, compiled_robots]],
        guests(),  # time in a guest is slower than on the host, so nothing runs in parallel
        *([[[long_loops]]] if loops else []),
        [[alone]],
    ]


def rest_files() -> list[str]:
    """Return the test files with tests that the default run omits, sorted."""
    whole = [f"tests/{name}" for name in REST_FILES]
    return sorted({*whole, *files_with("rest", *REST_KINDS), *map(str, Path("tests/bench").glob("test_*.py"))})


def files_of_compiled_modules() -> list[str]:
    """Return the test files of the compiled modules (see pyproject.toml), and the property tests of their folders."""
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))
    modules = [
        Path(name) for name in project["tool"]["hatch"]["build"]["targets"]["wheel"]["hooks"]["custom"]["include"]
    ]
    files = {
        path
        for module in modules
        for folder in [Path("tests", *module.parts[2:-1])]
        for path in (folder / f"test_{module.name}", *folder.glob(f"test_{module.stem}_*.py"))
    }
    for folder in {path.parent for path in files}:
        files.update(path for kind in ("properties", "vectors", "interop") for path in folder.glob(f"test_*_{kind}.py"))
    return sorted(str(path) for path in files if path.exists())


def guests() -> list[list[Part]]:
    """Return the lanes with guests: emulated CAN cards, the subpackage for kernel CAN, robots on it.

    Each is a kernel with one processor. An emulated machine computes all the time, a kernel in user mode half of it:
    two of those share a processor.
    """

    def guest(name: str, kind: str, program: str, environment: dict[str, str], *paths: str) -> Part:
        command = ("tools/guest/run_tests", sys.executable, program, *(f"tests/{path}" for path in paths))
        return Part(name, command, {**environment, _KIND: kind}, second_look=command)

    on_vcan = {"CANOPEN_CONTROL_TEST_CHANNEL": "vcan0"}
    emulated = ("hardware", "tools/can_hardware_guest", {"CANOPEN_CONTROL_TIME_SCALE": "10"})
    return [
        [guest("guest: emulated CAN cards", *emulated, "hardware_can")],
        [guest("guest: kernel CAN", "socketcan", "tools/socketcan_guest", on_vcan, "socketcan")],
        [guest("guest: robots on kernel CAN", "socketcan", "tools/socketcan_guest", on_vcan, *ROBOTS_ON_KERNEL_CAN)],
    ]


# ------------------------------------------------------------------------------------------------- running


class Run:
    """One run: starts parts, adopts and ends orphaned processes, and collects the results."""

    def __init__(self) -> None:
        self.results: list[Result] = []
        self.hidden: list[str] = []  # tests that failed in the first run and passed in the second
        self.interrupted = False
        self._begin = time.monotonic()
        self._running: dict[int, tuple[str, float]] = {}  # process id: name of the part, and its start time
        self._named: set[str] = set()  # all started parts of the lanes
        self._starting = 0  # parts whose process may exist already and is not yet in _running
        self._lock = threading.Lock()
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)

    def lanes(self, lanes: Sequence[Sequence[Part]]) -> None:
        """Run all lanes in parallel and return when the last one has ended."""
        self._named |= {part.name for lane in lanes for part in lane}
        threads = [threading.Thread(target=self._lane, args=(lane,)) for lane in lanes if lane]
        for thread in threads:
            thread.start()
        turns = 0
        while any(thread.is_alive() for thread in threads):
            self._reap_adopted()
            if turns % _PROGRESS_TURNS == 0:
                self._show_progress()
            turns += 1
            time.sleep(_TURN_S)
        self._show_progress(clear=True)

    def second_looks(self) -> None:
        """Run failed parts that permit it once more, alone; the second result counts."""
        for result in [candidate for candidate in self.results if candidate.failed and candidate.part.second_look]:
            assert result.part.second_look is not None
            again = replace(result.part, name=f"{result.part.name}, once more", command=result.part.second_look)
            code = self._run(replace(again, second_look=None)).code
            if code in (GOOD, _NO_TESTS):
                self.hidden += result.failed
                self.results.remove(result)
                self.results.append(replace(result, code=GOOD, failed=()))

    def summary(self) -> str:
        """Return the table of parts with their times, and the tests that passed only in the second run."""
        lines = ["== time and CPU"]
        lines += [f"{result.part.name:40} {result.wall:7.1f} s {result.cpu:8.1f} s CPU" for result in self.results]
        lines.append(f"{'all':40} {time.monotonic() - self._begin:7.1f} s {_cpu_of_children():8.1f} s CPU")
        if self.hidden:
            lines.append(f"== failed at first and passed at the second look: {len(self.hidden)}")
            lines += [f"   {test}" for test in self.hidden]
        failed = [result.part.name for result in self.results if result.code != GOOD]
        if failed:
            lines.append(f"== failed: {', '.join(failed)}")
        return "\n".join(lines)

    @property
    def good(self) -> bool:
        """Whether every part that ran has passed."""
        return not self.interrupted and all(result.code == GOOD for result in self.results)

    def end_children(self) -> None:
        """End every process started by this run: SIGINT to each part, then SIGKILL to remaining processes."""
        with self._lock:  # a part whose process is being started is among them then
            running = list(self._running)
        for pid in running:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGINT)
        deadline = time.monotonic() + _GRACE_S
        while self._running and time.monotonic() < deadline:
            self._reap_adopted()
            time.sleep(_TURN_S)
        kill_descendants()

    def _reap_adopted(self) -> None:
        """Reap adopted processes; those of parts are reaped by their lanes, which measure them."""
        with contextlib.suppress(ChildProcessError):
            while ended := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT):
                if ended.si_pid in self._running or self._starting:
                    return
                os.waitpid(ended.si_pid, os.WNOHANG)

    def _lane(self, parts: Sequence[Part]) -> None:
        for part in parts:
            while part.needs in self._named and not self._has_ended(part.needs) and not self.interrupted:
                time.sleep(_TURN_S)
            if self.interrupted:
                return
            if any(result.part.name == part.needs and result.code != GOOD for result in self.results):
                self._report(Result(part, _NOT_RUN, 0.0, 0.0), f"not run: {part.needs!r} has failed")
            else:
                try:
                    self._run(part)
                except ChildProcessError:
                    if not self.interrupted:
                        raise  # else the end of the run has killed and reaped its process

    def _has_ended(self, name: str) -> bool:
        with self._lock:
            return any(result.part.name == name for result in self.results)

    def _run(self, part: Part) -> Result:
        begin = time.monotonic()
        if part.second_look and "pytest" in part.command:
            shutil.rmtree(part.cache / "v", ignore_errors=True)
        with tempfile.TemporaryFile() as output:
            process = self._start(part, output, begin)
            process.returncode = _NOT_RUN  # unless there is a status
            try:
                _, status, usage = os.wait4(process.pid, 0)
            finally:
                del self._running[process.pid]
            code = process.returncode = os.waitstatus_to_exitcode(status)
            if code == _NO_GUEST and _KIND in part.environment and not _is_required(part.environment[_KIND]):
                code = GOOD  # the output names the missing guest
            result = Result(part, code, time.monotonic() - begin, usage.ru_utime + usage.ru_stime)
            if code == _TESTS_FAILED or (code != GOOD and part.second_look == part.command):
                result.failed = _failed_tests(part) or (part.name,)
            output.seek(0)
            self._report(result, output.read().decode("utf-8", "replace"))
        return result

    def _start(self, part: Part, output: IO[bytes], begin: float) -> subprocess.Popen[bytes]:
        with self._lock:
            self._starting += 1
            process = subprocess.Popen(
                part.command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, **part.environment},
                start_new_session=True,
            )
            os.setpriority(os.PRIO_PROCESS, process.pid, part.nice)
            self._running[process.pid] = (part.name, begin)
            self._starting -= 1
        return process

    def _report(self, result: Result, text: str) -> None:
        with self._lock:
            self.results.append(result)
            self._show_progress(clear=True)
            verdict = "" if result.code == GOOD else f" FAILED (exit code {result.code})"
            print(f"== {result.part.name}: {result.wall:.1f} s{verdict}", flush=True)
            if text.strip():
                print(text.rstrip(), flush=True)

    def _show_progress(self, clear: bool = False) -> None:
        if not sys.stdout.isatty():
            return
        now = time.monotonic()
        running = ", ".join(f"{name} {now - begin:.0f} s" for name, begin in list(self._running.values()))
        width = shutil.get_terminal_size().columns - 1
        print("\r\033[K" + ("" if clear else f"running: {running}"[:width]), end="", flush=True)


def _is_required(kind: str) -> bool:
    """Whether CANOPEN_CONTROL_REQUIRE names a kind of tests, or all of them."""
    return not {kind, "all"}.isdisjoint(os.environ.get("CANOPEN_CONTROL_REQUIRE", "").replace(" ", "").split(","))


def _failed_tests(part: Part) -> tuple[str, ...]:
    try:
        return tuple(json.loads((part.cache / "v/cache/lastfailed").read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return ()


def _cpu_of_children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _descendants() -> list[int]:
    parents = _parents()
    found, added = {os.getpid()}, True
    while added:
        more = {pid for pid, parent in parents.items() if parent in found} - found
        found |= more
        added = bool(more)
    return sorted(found - {os.getpid()})


def kill_descendants() -> None:
    """Kill and reap every descendant of this process."""
    while pids := _descendants():
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        _reap()
        time.sleep(_TURN_S)


def _parents() -> dict[int, int]:
    parents = {}
    for entry in os.listdir("/proc"):
        with contextlib.suppress(OSError, ValueError):
            stat = Path("/proc", entry, "stat").read_text(encoding="latin-1") if entry.isdigit() else ""
            if stat:
                parents[int(entry)] = int(stat.rpartition(")")[2].split()[1])
    return parents


def _reap() -> None:
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


# --------------------------------------------------------------------------------------------- Debian packages


def install_debian_packages() -> None:
    """Install the Debian packages for the screens and guests of --rest, as root, or in CI with sudo."""
    missing = [package for program, packages in SCREENS.items() if not shutil.which(program) for package in packages]
    for program, packages in GUESTS.items():
        if subprocess.run([program, "-c"], capture_output=True).returncode:
            missing += packages
    if not missing or not shutil.which("apt-get"):
        return
    sudo = []
    if os.geteuid() != 0:
        if not os.environ.get("CI") or subprocess.run(["sudo", "-n", "true"], capture_output=True).returncode:
            return  # tests that need the packages name the missing ones
        sudo = ["sudo", "-n"]
    print(f"installing {' '.join(missing)} (once)", flush=True)
    subprocess.run([*sudo, "apt-get", "update", "-qq"])
    subprocess.run(
        [*sudo, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "install", "-y", "-qq", "--no-install-recommends",
         *missing], stdout=subprocess.DEVNULL,
    )  # fmt: skip


# ------------------------------------------------------------------------------------------------ arguments


def paths_of(words: Sequence[str]) -> list[str]:
    """Return the test folders and files named by words such as `cia402` and `cli/sdo`; refuse unknown words."""
    paths = []
    for word in words:
        module = Path("tests", word).parent / f"test_{Path(word).name}.py"
        for path in (Path("tests", word), module, Path(word)):
            if path.exists():
                paths.append(str(path))
                break
        else:
            names = " ".join(sorted({path.parts[1] for path in Path("tests").glob("*/**/test_*.py")}))
            raise UsageError(f"there are no tests of {word!r}; subpackages with tests: {names}")
    return paths


def refuse_unwritable_folders() -> None:
    """Refuse to run in folders in which ruff, mypy, pytest and tests cannot write files."""
    for folder in (".", ".pytest_cache", ".mypy_cache", ".ruff_cache", "build"):
        if os.path.exists(folder) and not os.access(folder, os.W_OK | os.X_OK):
            raise UsageError(
                f"{Path(folder).absolute()} is read-only for this user; run the tests in a clone of your own"
            )
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        raise UsageError("no folder for temporary files is writable; set TMPDIR to one") from None


def split(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the words before the first one that begins with `-`, and the rest, which are pytest options."""
    first = next((index for index, word in enumerate(words) if word.startswith("-")), len(words))
    return list(words[:first]), list(words[first:])


def run_default(run: Run) -> None:
    """Run the default parts of ./tools/test; install needed programs first if no test may be skipped."""
    if os.environ.get("CANOPEN_CONTROL_REQUIRE"):
        install_debian_packages()
    run.lanes(default_lanes())


def run_rest(run: Run) -> None:
    """Run what the default run omits, and repeat what fails."""
    install_debian_packages()
    for lanes in rest_steps():
        run.lanes(lanes)
    run.second_looks()


def run_all(run: Run) -> None:
    """Run everything."""
    run_default(run)
    run_rest(run)


def coverage_parts(words: Sequence[str]) -> list[Part]:
    """Return the parts that measure the coverage of the tests of `words`, or of the default run."""
    coverage = (sys.executable, "-m", "coverage")
    subpackages, more = split(words)
    selection = _KEPT_OUT + (" and not alone" if subpackages else " and not rest")
    tests = (*coverage, "run", "-m", "pytest", "-q", "-rs", "-m", selection, *SHARED, *paths_of(subpackages), *more)
    return [
        Part("coverage: tests", tests),
        Part("coverage: combine", (*coverage, "combine", "-q")),
        Part("coverage: read", (*coverage, "json", "-q", "-o", "build/coverage.json")),
        Part(
            "coverage: by subpackage",
            (sys.executable, "tools/subpackage_coverage.py", "build/coverage.json", *subpackages),
        ),
    ]


def run_coverage(run: Run, words: Sequence[str]) -> None:
    """Measure the coverage of the tests, including the processes that they start, unless those are killed."""
    parts = coverage_parts(words)
    Path("build/coverage").mkdir(parents=True, exist_ok=True)
    subprocess.run([sys.executable, "-m", "coverage", "erase"])
    run.lanes([parts])


def run_words(words: Sequence[str]) -> int:
    """Run the tests of subpackages and modules in the foreground, with pytest's own output; return its exit code."""
    subpackages, more = split(words)
    command = [sys.executable, "-m", "pytest", "-q", "-rs", "-m", _KEPT_OUT, *more, *paths_of(subpackages)]
    os.execv(sys.executable, command)


COMMANDS: Final[dict[str, Callable[[Run], None]]] = {"": run_default, "--rest": run_rest, "--all": run_all}


@contextlib.contextmanager
def ended_by_signals(run: Run) -> Iterator[None]:
    """End all children on SIGINT, SIGTERM and SIGHUP, and at the end of the run."""

    def stop(number: int, frame: object) -> None:
        del number, frame
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, stop)
    try:
        yield
    except KeyboardInterrupt:
        run.interrupted = True
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        run.end_children()
        print("interrupted; every process of this run has ended", flush=True)
    finally:
        kill_descendants()


def main(words: Sequence[str]) -> int:
    """Run what the words ask for; return the exit code."""
    first, *others = words or [""]
    os.environ.setdefault("PYTHONHASHSEED", "0")
    try:
        if first in COMMANDS and others:
            raise UsageError(
                f"{first or 'no option'} takes no further words; `./tools/test --help` shows what there is"
            )
        if first.startswith("-") and first not in (*COMMANDS, "--fast", "--coverage"):
            raise UsageError(f"there is no option {first}; `./tools/test --help` shows what there is")
        if first and not first.startswith("-"):
            return run_words(words)
        if first == "--fast":
            os.execv(sys.executable, [sys.executable, "-m", "pytest", "-q", "-rs", "-m",
                                      f"{_KEPT_OUT} and not process and not robot and not rest and not alone",
                                      *DEALT, *others])  # fmt: skip
        paths_of(split(others)[0])
        refuse_unwritable_folders()
        run = Run()
        with ended_by_signals(run):
            if first == "--coverage":
                run_coverage(run, others)
            else:
                COMMANDS[first](run)
    except UsageError as error:
        print(f"tools/test: {error}", file=sys.stderr)
        return USAGE
    if run.interrupted:
        return INTERRUPTED
    print(run.summary(), flush=True)
    return GOOD if run.good else FAILED


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
