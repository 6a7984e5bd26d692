from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.host import SECOND_NS, eventually, open_descriptors, python, runs

from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host import spawn as spawn_module
from canopen_control.host.environment import LIFELINE, READY
from canopen_control.host.files import state_dir as logs
from canopen_control.host.reactor import Reactor
from canopen_control.host.spawn import Child, end_children, spawn, spawn_detached
from canopen_control.host.timer import ManualClock

pytestmark = pytest.mark.process

IMPORTS = "from canopen_control.host.lifeline import *; from canopen_control.host.spawn import *"
SLEEP = python("import time; time.sleep(60)")
#: waits for its lifeline to break, as every child of ours does
FAITHFUL = python("""
import select, sys
from canopen_control.host.lifeline import lifeline_fd
print("here", flush=True)
select.select([lifeline_fd()], [], [])
print("parent gone")
""")


@pytest.fixture
def children(run_folder):
    """Start children that do not outlive the test."""
    started: list[Child] = []

    def start(argv, **options):
        started.append(spawn(argv, **{"name": "child", **options}))
        return started[-1]

    yield start
    for child in started:
        child.unwatch()
        child.kill()
        child.wait(60)


@pytest.fixture
def real():
    with Reactor() as loop:
        raised = []
        loop.on_error = raised.append
        yield loop
        assert raised == []


def exit_of(child, loop):
    observed = []
    child.watch(loop, lambda returncode, last_lines: observed.append((returncode, last_lines)))
    assert loop.run_until(lambda: bool(observed), timeout_ns=20 * SECOND_NS)
    return observed[0]


# -- the end of a child


def test_the_end_of_a_child_arrives_with_its_status_and_last_lines(children, real):
    child = children(python("import sys; print('one'); print('two', file=sys.stderr); sys.exit(3)"))
    assert exit_of(child, real) == (3, ["one", "two"])
    assert child.returncode == 3
    assert not runs(child.pid)
    assert not Path(f"/proc/{child.pid}").exists()  # no zombie either


def test_the_end_is_reported_once_and_leaves_no_descriptor(children, real):
    before = open_descriptors()
    observed = []
    child = children(python(""))
    child.watch(real, lambda *end: observed.append(end))
    assert real.run_until(lambda: bool(observed), timeout_ns=20 * SECOND_NS)
    real.run_for(SECOND_NS // 50)
    assert observed == [(0, [])]
    assert open_descriptors() == before


def test_without_a_pidfd_the_end_is_seen_too(children, real, monkeypatch):
    monkeypatch.setattr(spawn_module, "_pidfd_open", lambda pid: -1)
    assert exit_of(children(python("import sys; sys.exit(4)")), real) == (4, [])


def test_a_child_that_ended_before_it_was_watched_is_reported_from_the_loop(children, real):
    child = children(python("print('bye')"))
    assert child.wait(60) == 0
    observed = []
    child.watch(real, lambda *end: observed.append(end))
    assert observed == []
    assert real.run_until(lambda: bool(observed), timeout_ns=SECOND_NS)
    assert observed == [(0, ["bye"])]


def test_a_child_no_longer_watched_is_not_reported(children, real):
    child, reported = children(python("")), []
    child.watch(real, lambda *end: reported.append(end))
    child.unwatch()
    child.unwatch()
    assert child.wait(60) == 0
    real.run_for(SECOND_NS // 50)
    assert reported == []


def test_a_kernel_without_pidfd_is_asked_at_intervals(monkeypatch):
    def refuse(pid):
        raise OSError("no pidfd")

    monkeypatch.setattr(os, "pidfd_open", refuse)
    assert spawn_module._pidfd_open(os.getpid()) == -1
    monkeypatch.setattr(sys, "platform", "darwin")
    assert spawn_module._pidfd_open(os.getpid()) == -1


def test_terminate_asks_and_kill_does_not(children):
    child = children(python("import signal, time; signal.signal(15, 1); print('deaf', flush=True); time.sleep(60)"))
    assert eventually(lambda: child.last_lines() == ["deaf"])
    child.terminate()
    assert child.wait(0.05) is None
    child.kill()
    assert child.wait(60) == -signal.SIGKILL
    child.kill()
    child.terminate()
    other = children(SLEEP)
    other.terminate()
    assert other.wait(60) == -signal.SIGTERM


def test_children_that_do_not_end_on_request_are_killed_without_an_event(children, real, tmp_path):
    deaf = "import signal, time; signal.signal(15, signal.SIG_IGN); open({!r}, 'w'); time.sleep(60)"
    both = [children(python(deaf.format(str(tmp_path / "deaf")))), children(SLEEP, name="sleep")]
    reports = []
    for child in both:
        child.watch(real, lambda *_: reports.append("ended"))
    assert eventually((tmp_path / "deaf").exists)
    end_children(both, real, 0.2)
    assert [child.returncode for child in both] == [-signal.SIGKILL, -signal.SIGTERM]
    real.run_for(1_000_000)
    assert reports == []


def test_kill_ends_the_childs_own_children_too(children):
    child = children(["/bin/sh", "-c", "sleep 60 & echo $!; wait"])
    assert eventually(lambda: bool(child.last_lines()))
    grandchild = int(child.last_lines()[0])
    assert runs(grandchild)
    child.kill()
    child.wait(60)
    assert eventually(lambda: not runs(grandchild))


# -- what a child is given


REPORT = python(f"""
import json, os, sys
print(json.dumps({{
    "environment": dict(os.environ), "session": os.getsid(0), "pid": os.getpid(), "stdin": os.read(0, 10).decode(),
    "descriptors": sorted(int(fd) for fd in os.listdir("/proc/self/fd")),
    "lifeline": os.environ[{LIFELINE!r}],
}}))
""")


def report_of(child):
    assert child.wait(60) == 0
    return json.loads(child.last_lines(1)[0])


def test_a_child_has_a_session_of_its_own_and_nothing_to_read(children):
    report = report_of(children(REPORT))
    assert report["session"] == report["pid"]
    assert report["stdin"] == ""


def test_a_child_inherits_its_lifeline_and_no_other_descriptor(children):
    others = [children(SLEEP) for _ in range(3)]  # each of them has one that must not be kept open by the next
    report = report_of(children(REPORT))
    lifeline = int(report["lifeline"])
    listing = 1  # the folder of descriptors itself, while it is read
    assert set(report["descriptors"]) >= {0, 1, 2, lifeline}
    assert len(report["descriptors"]) == 4 + listing
    assert all(other.poll() is None for other in others)


def test_a_child_gets_a_clean_environment(children, monkeypatch):
    wheels = f"{sys.prefix}/lib/python3.11/site-packages/ros_rclpy.libs"
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{wheels}:{sys.prefix}/lib")
    monkeypatch.setenv("SOME_SETTING", "kept")
    monkeypatch.setenv(READY, "1")
    for ros in (False, True):
        environment = report_of(children(REPORT, ros=ros))["environment"]
        assert "LD_LIBRARY_PATH" not in environment
        assert READY not in environment
        assert environment["PYTHONUNBUFFERED"] == "1"
        assert environment["SOME_SETTING"] == "kept"
        assert environment.get("_ROS_WHEELS_BOOTSTRAP_COMPLETE") == (None if ros else "1")


def test_the_log_is_where_it_was_asked_for_and_else_in_the_state_folder(children, tmp_path):
    first = children(python("print('x')"), name="drive-3", log_dir=tmp_path / "mine")
    assert first.log_path == tmp_path / "mine" / "drive-3.log"
    second = children(python("print('x')"), name="drive-3")
    assert second.log_path == logs() / "drive-3.log"
    for child in (first, second):
        child.wait(60)
        assert child.log_path.read_text().endswith("\nx\n")


def test_a_log_that_grows_is_rotated_while_the_child_is_watched(children):
    with Reactor(ManualClock()) as loop:
        child = children(python("import os; os.write(1, b'x' * 50_000); import time; time.sleep(60)"))
        child.watch(loop, lambda *_: None)
        assert eventually(lambda: child.log_path.stat().st_size > 50_000, 30)  # Python starts first
        child._log._limit = 10_000  # only now: what is too long when it begins to be watched is rotated at once
        loop.run_for(4 * SECOND_NS)
        assert child.log_path.stat().st_size > 50_000
        loop.run_for(2 * SECOND_NS)
        child._log._busy.join(60)
        assert child.log_path.stat().st_size < 1000
        child.unwatch()


def test_what_cannot_be_started_is_a_sentence_and_leaves_no_descriptor(run_folder, tmp_path):
    before = open_descriptors()
    with pytest.raises(CanopenError, match=r"cannot start hub .*nonsense.*: No such file"):
        spawn(["/does/not/exist/nonsense"], name="hub")
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot write the log"):
        spawn(SLEEP, name="hub", log_dir=tmp_path / "file")
    assert open_descriptors() == before


# -- the lifeline


def test_the_lifeline_breaks_when_it_is_cut(children, real):
    child = children(FAITHFUL)
    assert eventually(lambda: child.last_lines() == ["here"])
    child.cut_lifeline()
    child.cut_lifeline()
    assert exit_of(child, real) == (0, ["here", "parent gone"])


def test_the_lifeline_breaks_when_the_parent_is_killed(run_folder, tmp_path):
    code = f"""
import time
from pathlib import Path
from canopen_control.host.spawn import spawn
for name in ("a", "b"):
    child = spawn({FAITHFUL!r}, name=name, log_dir=Path({str(tmp_path)!r}))
    print(child.pid, flush=True)
time.sleep(60)
"""
    with subprocess.Popen(python(code), stdout=subprocess.PIPE, text=True) as parent:
        pids = [int(parent.stdout.readline()) for _ in range(2)]
        try:
            assert eventually(lambda: all("here" in (tmp_path / f"{name}.log").read_text() for name in "ab"))
            assert all(map(runs, pids))
            parent.kill()
            assert eventually(lambda: not any(map(runs, pids)))
            assert all((tmp_path / f"{name}.log").read_text().endswith("parent gone\n") for name in "ab")
        finally:
            for pid in filter(runs, pids):
                os.kill(pid, signal.SIGKILL)


# -- detached


def detached(code):
    return python(f"{IMPORTS}\nimport os, sys, time\n{code}")


def test_a_detached_process_has_no_parent_and_outlives_its_starter(run_folder, tmp_path):
    service = detached(f"""
with open({str(tmp_path / "pid")!r}, "w") as file:
    print(os.getpid(), file=file)
report_ready()
time.sleep(60)
""")
    starter = python(f"{IMPORTS}; spawn_detached({service!r}, 20)")
    subprocess.run(starter, check=True, timeout=60)
    pid = int((tmp_path / "pid").read_text())
    try:
        assert runs(pid)
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        parent, session = int(fields[1]), int(fields[3])
        assert parent != os.getpid()
        assert session not in (0, os.getsid(0))
    finally:
        os.kill(pid, signal.SIGKILL)
    assert eventually(lambda: not runs(pid))


def test_it_returns_when_the_service_is_ready_and_not_before(run_folder, tmp_path):
    mark = tmp_path / "mark"
    before = open_descriptors()
    spawn_detached(detached(f"time.sleep(0.05); open({str(mark)!r}, 'w').close(); report_ready()"), 20)
    assert mark.exists()
    assert open_descriptors() == before


def test_a_service_that_dies_before_it_is_ready_is_quoted(run_folder):
    with pytest.raises(CanopenError, match=r"hub could not be started: it ended at once; .*ZeroDivisionError"):
        spawn_detached(detached("1 / 0"), 20, name="hub")
    with pytest.raises(CanopenError, match=r"hub could not be started: it ended at once; .*not found"):
        spawn_detached(["/does/not/exist"], 20, name="hub")


def test_a_service_that_takes_too_long_is_ended(run_folder, tmp_path):
    mark = tmp_path / "pid"
    service = detached(f"""
with open({str(mark)!r}, "w") as file:
    print(os.getpid(), file=file)
time.sleep(60)
""")
    started = time.monotonic()
    with pytest.raises(CanopenError, match=r"hub was not ready within 0\.4 s and was ended; its log is .*hub\.log"):
        spawn_detached(service, 0.4, name="hub")
    assert time.monotonic() - started < 30
    if mark.exists():  # else it did not even get that far
        assert eventually(lambda: not runs(int(mark.read_text())))


@pytest.mark.ros
@pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="rclpy is not installed")
def test_a_child_finds_its_ros_although_another_environments_paths_leaked_into_ours(children, monkeypatch):
    monkeypatch.setenv("LD_LIBRARY_PATH", "/another/venv/lib:/another/venv/lib/python3.12/site-packages/ros_rclpy.libs")
    child = children([sys.executable, "-c", "import rclpy; print('found')"], ros=True)
    assert child.wait(60) == 0
    assert child.last_lines() == ["found"]


def test_a_child_that_reports_that_it_is_ready_is_waited_for_without_blocking(children, real):
    events_seen = []
    child = children(
        python("import time; from canopen_control.host.lifeline import report_ready; report_ready(); time.sleep(60)"),
        reports=True,
    )
    child.watch_ready(real, lambda: events_seen.append(child.poll()))
    assert real.run_until(lambda: bool(events_seen), 20 * SECOND_NS)
    assert events_seen == [None]
    real.run_for(SECOND_NS // 20)
    assert len(events_seen) == 1
    child.unwatch_ready(real)


def test_a_child_that_is_never_ready_is_left_running_and_its_pipe_closed(children, real):
    before = open_descriptors()
    child = children(SLEEP, reports=True)
    child.watch_ready(real, lambda: pytest.fail("it has said nothing"))
    real.run_for(SECOND_NS // 20)
    child.unwatch_ready(real)
    child.unwatch_ready(real)
    child.kill()
    child.wait(60)
    child.cut_lifeline()
    assert open_descriptors() == before


GATED = python("""
import os
from canopen_control.host.lifeline import gate_fd
print("prepared", flush=True)
print(os.read(gate_fd(), 1), flush=True)
""")


@pytest.mark.parametrize(("pass_by", "read"), [(Child.open_gate, "b'\\n'"), (Child.cut_lifeline, "b''")])
def test_a_child_waits_at_its_gate_until_it_is_opened_or_never_will_be(children, pass_by, read):
    before = open_descriptors()
    child = children(GATED, gated=True)
    assert eventually(lambda: child.last_lines() == ["prepared"])
    assert child.poll() is None
    pass_by(child)
    child.open_gate()
    assert child.wait(60) == 0
    assert child.last_lines() == ["prepared", read]
    assert open_descriptors() == before


def test_a_gate_does_not_open_after_the_child_has_ended(children):
    child = children(python("pass"), gated=True)
    assert child.wait(60) == 0
    child.open_gate()
