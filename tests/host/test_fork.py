"""Forks start like new interpreters, except that modules are already imported."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.host import eventually, runs

from canopen_control.host import fork as fork_module
from canopen_control.host.fork import can_fork

pytestmark = [pytest.mark.process, pytest.mark.skipif(sys.platform != "linux", reason="forks are for Linux")]

#: what a child is: its parent imports it before the fork, with LOADED
CHILD = """
import atexit, gc, json, os, random, select, signal, sys, time
from canopen_control.host.lifeline import lifeline_fd
LOADED = []

def main(arguments):
    if arguments[0] == "report":
        print(json.dumps({
            "loaded": LOADED, "argv": sys.argv, "pid": os.getpid(), "session": os.getsid(0), "parent": os.getppid(),
            "input": sys.stdin.read(), "descriptors": sorted(map(int, os.listdir("/proc/self/fd"))),
            "lifeline": lifeline_fd(), "environment": dict(os.environ), "random": random.random(),
            "collector": [gc.isenabled(), *gc.get_threshold()], "frozen": gc.get_freeze_count() > 0,
            "caught": [int(number) for number in signal.valid_signals() if callable(signal.getsignal(number))],
            "mask": sorted(signal.pthread_sigmask(signal.SIG_BLOCK, [])), "wakeup": signal.set_wakeup_fd(-1),
            "command": open("/proc/self/cmdline").read(), "shown": open("/proc/self/environ").read().split(chr(0)),
            "name": open("/proc/self/comm").read().strip(), "unbuffered": sys.stdout.write_through,
        }))
    elif arguments[0] == "wait":
        print("here")
        select.select([lifeline_fd()], [], [])
        print("parent gone")
    elif arguments[0] == "leave":
        atexit.register(print, "own exit function")
        sys.exit(eval(arguments[1]))
    return 7
"""
PARENT = """
import atexit, gc, json, os, random, signal, sys, threading, time
from pathlib import Path
import fork_child
from canopen_control.host import fork, spawn
fork_child.LOADED.append("by the parent")
logs = Path(sys.argv[1])

def start(*arguments, name="child", **options):
    argv = options.pop("argv", [sys.executable, "-c", "1 / 0"])
    return spawn.spawn(argv, name=name, log_dir=logs, main=("fork_child", arguments), **options)
"""


@pytest.fixture
def parent(run_folder, tmp_path, monkeypatch):
    """Run a program that starts forks; return its process."""
    (tmp_path / "fork_child.py").write_text(CHILD)
    monkeypatch.setenv("PYTHONPATH", f"{os.environ['PYTHONPATH']}:{tmp_path}")
    started = []

    def run(code, stderr=None):
        program = [sys.executable, "-S", "-c", PARENT + code, str(tmp_path)]
        started.append(subprocess.Popen(program, stdout=subprocess.PIPE, stderr=stderr, text=True))
        return started[-1]

    yield run
    for process in started:
        process.kill()
        process.communicate()


def said(tmp_path, name="child"):
    """Return the lines of a child."""
    log = tmp_path / f"{name}.log"
    return [] if not log.exists() else log.read_text().splitlines()[1:]


SETTINGS = """
gc.disable(); gc.set_threshold(5, 6, 7)
atexit.register(print, "exit function of the parent", flush=True)
other, both = os.open("/dev/null", os.O_RDONLY), os.pipe()
os.set_blocking(both[1], False)
signal.set_wakeup_fd(both[1], warn_on_full_buffer=False)
for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
    signal.signal(number, lambda *_: None)
random.seed(3)
os.environ["SETTING"] = "kept"
fork.allow_forks()
print("buffered", end="")
first = start("report", name="first"); second = start("report", name="second")
assert [each.wait() for each in (first, second)] == [7, 7]
os.write(1, json.dumps([os.getpid(), first.pid, random.random()]).encode())
"""


def test_a_fork_begins_as_a_new_interpreter_and_needs_no_import(parent, tmp_path):
    process = parent(SETTINGS)
    out, _ = process.communicate(timeout=60)
    assert out.count("buffered") == out.count("exit function") == 1
    parent_pid, pid, parents_random = json.loads(out[out.index("[") : out.index("]") + 1])
    first, second = (json.loads(said(tmp_path, name)[0]) for name in ("first", "second"))
    assert first["loaded"] == ["by the parent"]
    assert first["argv"] == ["fork_child", "report"]
    assert (first["pid"], first["session"], first["parent"]) == (pid, pid, parent_pid)
    assert first["input"] == ""
    listing = 1
    assert len(first["descriptors"]) == 4 + listing
    assert set(first["descriptors"]) >= {0, 1, 2, first["lifeline"]}
    assert len(second["descriptors"]) == 4 + listing
    assert first["environment"]["SETTING"] == "kept"
    assert first["environment"]["PYTHONUNBUFFERED"] == "1"
    assert first["unbuffered"]
    assert len({parents_random, first["random"], second["random"]}) == 3
    assert first["collector"] == [True, 700, 10, 10]
    assert first["frozen"]
    assert (first["caught"], first["mask"], first["wakeup"]) == ([signal.SIGINT], [], -1)


def test_a_fork_holds_neither_a_socket_nor_a_lock_of_its_parent(parent, tmp_path):
    code = """
from canopen_control.host import sockets
path = sockets.socket_path("robot", "parent")
listener = sockets.listen(path)
client = sockets.connect(path)
served, _ = listener.accept()
lock = sockets.claim(logs / "lock")
fork.allow_forks()
child = start("wait")
while child.last_lines() != ["here"]:
    time.sleep(0.01)
listener.close(); served.close(); os.close(lock)
try:
    sockets.connect(path)
except ConnectionRefusedError:
    print("refused")
os.close(sockets.claim(logs / "lock"))
print("claimed")
client.settimeout(20)
print(client.recv(1), child.poll())
child.kill()
"""
    out, _ = parent(code).communicate(timeout=60)
    assert out.splitlines() == ["refused", "claimed", "b'' None"]


@pytest.mark.parametrize("soft", [0, 4096])
def test_limits_and_the_handler_of_crashes_are_those_of_the_parent(parent, tmp_path, soft):
    code = f"""
import faulthandler, resource
hard = resource.getrlimit(resource.RLIMIT_CORE)[1]
resource.setrlimit(resource.RLIMIT_CORE, ({soft} if hard < 0 or hard >= {soft} else hard, hard))
faulthandler.enable()

def crash(arguments):
    print(resource.getrlimit(resource.RLIMIT_CORE) == tuple(json.loads(arguments[0])), faulthandler.is_enabled())
    resource.setrlimit(resource.RLIMIT_CORE, (0, hard))
    os.kill(os.getpid(), signal.SIGSEGV)

fork_child.main = crash
fork.allow_forks()
print(start(json.dumps(resource.getrlimit(resource.RLIMIT_CORE))).wait())
"""
    out, err = parent(code, stderr=subprocess.PIPE).communicate(timeout=60)
    assert (out, err) == (f"{-signal.SIGSEGV}\n", "")
    assert said(tmp_path)[:2] == ["True True", "Fatal Python error: Segmentation fault"]


def test_a_fork_neither_repeats_the_numbers_of_its_parent_nor_those_of_another_fork(parent, tmp_path):
    code = """
import secrets, uuid

def draw(arguments):
    print(json.dumps([random.random(), secrets.token_hex(4), uuid.uuid4().hex, random.Random(5).random()]))

fork_child.main = draw
random.seed(3)
fork.allow_forks()
[start(name=name).wait() for name in "ab"]
draw([])
"""
    out, _ = parent(code).communicate(timeout=60)
    drawn = [json.loads(out), *(json.loads(said(tmp_path, name)[0]) for name in "ab")]
    assert all(len({*numbers}) == 3 for numbers in list(zip(*drawn, strict=True))[:3])
    assert len({seeded for *_, seeded in drawn}) == 1


def test_ps_shows_the_command_line_and_the_environment_of_the_child(parent, tmp_path):
    parent(SETTINGS).communicate(timeout=60)
    report = json.loads(said(tmp_path, "first")[0])
    assert report["command"].rstrip("\0").split("\0") == [sys.executable, "-c", "1 / 0"]
    assert "SETTING=kept" in report["shown"]
    assert f"CANOPEN_CONTROL_LIFELINE={report['lifeline']}" in report["shown"]
    assert report["name"] == Path(sys.executable).name[:15]


def test_a_command_line_longer_than_that_of_the_parent_is_one_string(parent, tmp_path, monkeypatch):
    monkeypatch.setenv("LONGEST", "y" * 5000)
    parent("fork.allow_forks(); start('report', argv=['python', '-m', 'x' * 2500]).wait()").communicate(timeout=60)
    report = json.loads(said(tmp_path)[0])
    assert report["command"] == f"python -m {'x' * 2500}\0"
    assert "_ROS_WHEELS_BOOTSTRAP_COMPLETE=1" in report["shown"]
    assert not any(variable.startswith("LONGEST=") for variable in report["shown"])


@pytest.mark.parametrize(
    ("value", "code", "words"),
    [
        ("3", 3, []),
        ("None", 0, []),
        ("'a reason'", 1, ["a reason"]),
        ("1 / 0", 1, ["ZeroDivisionError: division by zero"]),
    ],
)
def test_its_exit_code_is_that_of_its_main_and_its_exit_functions_run(parent, tmp_path, value, code, words):
    out, _ = parent(f"fork.allow_forks(); print(start('leave', {value!r}).wait())").communicate(timeout=60)
    assert out == f"{code}\n"
    lines = said(tmp_path)
    assert lines[-1] == "own exit function"
    assert lines[-2:-1] == words


def test_each_is_killed_alone_and_its_end_arrives(parent):
    code = """
from canopen_control.host.reactor import Reactor
fork.allow_forks()
with Reactor() as loop:
    one, other = start("wait", name="one"), start("wait", name="other")
    seen = []
    one.watch(loop, lambda *end: seen.append(end))
    while one.last_lines() != ["here"]:
        time.sleep(0.01)
    one.kill()
    assert loop.run_until(lambda: bool(seen), 20_000_000_000)
    print(seen, one.returncode, other.wait(0.01), Path(f"/proc/{one.pid}").exists())
    other.terminate()
    print(other.wait(20), other.poll())
    other.terminate()
"""
    out, _ = parent(code).communicate(timeout=60)
    assert out.splitlines() == ["[(-9, ['here'])] -9 None False", "-15 -15"]


def test_the_lifeline_breaks_when_the_parent_is_killed(parent, tmp_path):
    code = "fork.allow_forks(); print(*[start('wait', name=name).pid for name in 'ab'], flush=True); time.sleep(60)"
    process = parent(code)
    pids = [int(word) for word in process.stdout.readline().split()]
    assert eventually(lambda: all(said(tmp_path, name) == ["here"] for name in "ab"))
    process.kill()
    assert eventually(lambda: all(said(tmp_path, name) == ["here", "parent gone"] for name in "ab"))
    assert eventually(lambda: not any(map(runs, pids)))


def test_a_detached_fork_is_not_a_child_of_its_starter(parent, tmp_path):
    code = """
from canopen_control.host.lifeline import report_ready

def serve(arguments):
    print(os.getpid(), os.getppid(), os.getsid(0))
    report_ready()
    time.sleep(60)

fork_child.main = serve
fork.allow_forks()
spawn.spawn_detached([sys.executable, "-c", "1 / 0"], 20, name="hub", log_dir=logs, main=("fork_child", ["x"]))
print(os.getpid(), os.getsid(0))
"""
    out, _ = parent(code).communicate(timeout=60)
    starter, starters_session = map(int, out.split())
    pid, _, session = map(int, said(tmp_path, "hub")[0].split())
    try:
        assert runs(pid)
        assert int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1]) != starter
        assert session not in (pid, starters_session)
    finally:
        os.kill(pid, signal.SIGKILL)


def test_nothing_is_forked_unless_that_is_allowed_and_while_there_are_threads(parent, tmp_path):
    code = """
print(fork.can_fork(), start("report", name="spawned").wait())
fork.allow_forks()
over = threading.Event()
thread = threading.Thread(target=over.wait)
thread.start()
print(fork.can_fork(), start("report", name="beside").wait())
over.set()
thread.join()
while len(os.listdir("/proc/self/task")) > 1:  # the kernel may list a joined thread for a moment
    time.sleep(0.001)
print(fork.can_fork(), start("report", name="forked").wait())
"""
    out, _ = parent(code).communicate(timeout=60)
    assert out.splitlines() == ["False 1", "False 1", "True 7"]
    assert said(tmp_path, "beside")[-1] == "ZeroDivisionError: division by zero"


def test_this_process_allows_none():
    assert not fork_module._allowed
    assert not can_fork()
