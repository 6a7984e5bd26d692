"""Kinds of tests: tests that this machine cannot run are skipped with the reason, unless CANOPEN_CONTROL_REQUIRE
forbids it.

CANOPEN_CONTROL_REQUIRE names kinds (`ros,wheel`) or is `all`: then any skip at all is a failure.

`process` is every test that starts one, or needs a bus, ROS or a browser: whole folders and kinds by the tables here,
the others by their own mark. A run without them (-m "not process", tools/test --fast) fails a test that starts a
process and has no mark, so that the mark stays true.

`rest` is every test that tools/test leaves to tools/test --rest: what measures time (`alone`, `timed`), what needs a
wheel, a kernel with CAN or a card, and what takes long: the tests that say so themselves, and whole files
(tools/run_tests.py).

`robot` is every test with a whole robot, a device on a bus, or a screen in it, even if all is in this process and in
simulated time: known by the benches of tests/support that its file takes. `tools/test --fast` leaves them out.
"""

import asyncio
import functools
import gc
import importlib.util
import inspect
import itertools
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from run_tests import REST_FILES, REST_KINDS
from support.properties import load_profile

load_profile()

REQUIRED = {word for word in os.environ.get("CANOPEN_CONTROL_REQUIRE", "").replace(" ", "").split(",") if word}


if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Tests run in the background of a shell inherit this, and so would each program that they interrupt.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def missing_ros():
    """Ask another interpreter: the ROS packages change the environment of the one that imports them."""
    environment = {key: value for key, value in os.environ.items() if key != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    probe = [sys.executable, "-c", "import rclpy, std_msgs.msg, sensor_msgs.msg"]
    present = importlib.util.find_spec("rclpy") is not None
    if present and subprocess.run(probe, env=environment, capture_output=True).returncode == 0:
        return None
    return "rclpy is not installed: pip install canopen-control[ros], or source a ROS 2 installation"


def missing_wheel_tools():
    return (
        None
        if importlib.util.find_spec("hatchling")
        else "hatchling is not installed: pip install canopen-control[dev]"
    )


def missing_socketcan():
    return (
        None
        if os.path.exists("/sys/class/net/vcan0")
        else "no vcan0: ip link add vcan0 type vcan; ip link set vcan0 up"
    )


def missing_tmux():
    return None if shutil.which("tmux") else "tmux is not installed: apt install tmux"


def missing_browser():
    for module in ("nicegui", "playwright"):
        if importlib.util.find_spec(module) is None:
            return f"{module} is not installed: pip install canopen-control[dev]"
    from support.browser import CHROMIUM

    return None if os.access(CHROMIUM, os.X_OK) else f"no {CHROMIUM}: apt-get install chromium, or set CHROMIUM"


MISSING = {
    "ros": missing_ros,
    "wheel": missing_wheel_tools,
    "browser": missing_browser,
    "socketcan": missing_socketcan,
    "tmux": missing_tmux,
}


FOLDERS = itertools.count()
#: Folders with tests of whole processes.
WHOLE = ("bench", "integration", "socketcan", "hardware_can", "tools")
#: Kinds whose files tools/test finds by their mark. `process` has many: MORE.
FOUND_BY_MARK = ("alone", "timed", "rest")
#: Subpackages of user interfaces and of whole robots.
ROBOT_SUBPACKAGES = ("faults", "monitor", "view")
#: Benches of tests/support that contain a bus or the sockets of a robot.
ROBOT_BENCHES = frozenset(
    f"support.{name}"
    for name in ("apiclient", "arm6", "faultbench", "liverobot", "mockrobot", "onbus", "pages", "robots",
                 "trajectory_player")
)  # fmt: skip
#: Fixtures of subpackages that contain such a robot.
ROBOTS = frozenset({"mock_robot", "robby", "lost_drive", "calm_run"})
#: Fixtures that need more than this process.
MORE = (*MISSING, "hardware", "process")


@pytest.hookimpl(tryfirst=True)  # before -m evaluates the marks
def pytest_collection_modifyitems(items):
    tests = Path(__file__).parent
    for item in items:
        subpackage = item.path.relative_to(tests).parts[0] if item.path.is_relative_to(tests) else ""
        if subpackage in WHOLE or any(item.get_closest_marker(kind) is not None for kind in MORE):
            item.add_marker("process")
            if subpackage not in WHOLE and not any(says(item.path, f"mark.{kind}") for kind in MORE):
                raise pytest.UsageError(
                    f"{item.nodeid} needs processes: write a mark that says so in its file, tools/test looks there"
                )
        for kind in FOUND_BY_MARK:
            if item.get_closest_marker(kind) is not None and not says(item.path, f"mark.{kind}"):
                raise pytest.UsageError(
                    f"{item.nodeid} is marked {kind}: write the mark in its file, tools/test looks there"
                )
        name = item.path.relative_to(tests).as_posix() if subpackage else ""
        if subpackage == "bench" or name in REST_FILES or any(item.get_closest_marker(kind) for kind in REST_KINDS):
            item.add_marker("rest")
        if subpackage in ROBOT_SUBPACKAGES or takes_a_robot(item.module) or not ROBOTS.isdisjoint(item.fixturenames):
            item.add_marker("robot")


@functools.cache
def says(path, words):
    return words in path.read_text(encoding="utf-8")


@functools.cache
def takes_a_robot(module):
    return any(getattr(var, "__module__", None) in ROBOT_BENCHES for var in vars(module).values())


@pytest.fixture(autouse=True)
def xacro_here(request, monkeypatch):
    """Let tests that start no process read robots all the same: the real xacro, in this process and without limits."""
    if request.node.get_closest_marker("process") is None:
        from support.xacro_here import XacroHere

        from canopen_control.urdf import description

        monkeypatch.setattr(description, "XacroRun", XacroHere)


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem):
    """Run a test that is a coroutine, on an event loop of its own."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    asyncio.run(pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}))
    return True


class Watchman:
    """Names the tests that start processes in a run that is to have none; Python tells it of each."""

    EVENTS = frozenset({"subprocess.Popen", "os.posix_spawn", "os.fork", "os.forkpty"})
    # ctypes searches for a library once per process; matplotlib searches for fonts once per machine
    OF_LIBRARIES = frozenset({"/sbin/ldconfig", "fc-list"})

    def __init__(self):
        self.started = []
        sys.addaudithook(self._hear)

    def _hear(self, event, arguments):
        if event in self.EVENTS:
            started = str(arguments[0]) if arguments else event
            if started not in self.OF_LIBRARIES:
                self.started.append(started)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item):
        self.started.clear()
        result = yield
        if self.started:
            pytest.fail(f"it starts {self.started[0]} and has no mark: pytest.mark.process", pytrace=False)
        return result


def pytest_configure(config):
    if "not process" in config.option.markexpr:
        config.pluginmanager.register(Watchman(), "watchman")


def pytest_collection_finish(session):
    skip_what_is_missing(session.items)  # only for selected tests: the search for ROS takes a second
    Seen.put_aside()


class Seen:
    """Keeps what is there before a test out of every look for garbage: of ten thousand tests that takes half a second.

    A robot that has run in this process ends with `gc.unfreeze`, which brings all of it back: what is there is put
    aside once more after such a test, and only after some of them garbage is looked for in all of it.
    """

    LOOKED_AFTER = 200
    back = False
    brought_back = 0
    file = ""
    unfreeze = staticmethod(gc.unfreeze)

    @classmethod
    def put_aside(cls):
        if cls.brought_back % cls.LOOKED_AFTER == 0:
            gc.collect()
        gc.freeze()
        cls.back = False

    @classmethod
    def bring_back(cls):
        cls.unfreeze()
        cls.back = True
        cls.brought_back += 1


gc.unfreeze = Seen.bring_back


def pytest_runtest_logstart(location):
    if location[0] != Seen.file:  # all modules that this file's first test uses have been imported by now
        Seen.file = location[0]
        gc.freeze()


def pytest_runtest_logfinish():
    if Seen.back:
        Seen.put_aside()


def skip_what_is_missing(items):
    reasons = {}
    for item in items:
        for kind, missing in MISSING.items():
            if item.get_closest_marker(kind) is None:
                continue
            if kind not in reasons:
                reasons[kind] = missing()
            if reasons[kind] is not None:
                item.add_marker(pytest.mark.skip(reason=reasons[kind]))


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    outcome = yield
    report = outcome.get_result()
    if report.skipped and not hasattr(report, "wasxfail") and must_run(item):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        report.outcome = "failed"
        report.longrepr = f"required by CANOPEN_CONTROL_REQUIRE, but skipped: {reason}"


def must_run(item):
    return "all" in REQUIRED or any(item.get_closest_marker(kind) is not None for kind in REQUIRED)


@pytest.fixture(autouse=True)
def private_folders(tmp_path_factory, monkeypatch):
    """Keep sockets and logs of a test apart from everybody else's; the path is short because sockets need it.

    Counted here, for pytest looks at all folders of before to number the next.
    """
    folder = tmp_path_factory.getbasetemp() / f"r{next(FOLDERS)}"
    folder.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "state"))
    return folder


@pytest.fixture
def stage(private_folders, tmp_path):
    """Return where processes are started; afterwards all are ended, and none may be left."""
    from support.processes import Stage

    stage = Stage(private_folders, tmp_path)
    yield stage
    stage.end()


@pytest.fixture
def reactor():
    """Return a reactor on a manual clock; a callback that raises fails the test."""
    from canopen_control.host.reactor import Reactor
    from canopen_control.host.timer import ManualClock

    with Reactor(ManualClock()) as loop:
        raised = []
        loop.on_error = raised.append
        yield loop
        assert raised == []


@pytest.fixture
def run_folder(tmp_path, monkeypatch):
    """Return the runtime folder of a test, in its own folder."""
    from support.host import use_private_folders

    return use_private_folders(monkeypatch, tmp_path)
