import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.host import eventually
from support.robots import copy_robby

from canopen_control.data_files import data_path
from canopen_control.errors import CanopenError
from canopen_control.host.environment import MODULE
from canopen_control.host.files import state_dir
from canopen_control.host.reactor import Reactor
from canopen_control.host.spawn import Child, spawn
from canopen_control.master.event_log import Level
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.runtime.supervisor import (
    _RECORDER,
    MAX_RESTARTS,
    WINDOW_NS,
    Restarts,
    Silence,
    Supervisor,
    hosts_virtual_drives,
)

pytestmark = pytest.mark.process
SECOND = 1_000_000_000
RESTART_NS = SECOND // 50  # between the end of a client and its restart, instead of half a second


@pytest.fixture
def supervisor(monkeypatch):
    monkeypatch.setattr("canopen_control.runtime.supervisor.DELAY_NS", RESTART_NS)
    reactor, events = Reactor(), []
    supervisor = Supervisor("test", reactor, events.append)
    supervisor.reactor, supervisor.events = reactor, events
    yield supervisor
    supervisor.end()
    reactor.close()


def gone(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_the_recorder_finds_what_it_imports_without_the_site_packages():
    done = subprocess.run([*_RECORDER, "--help"], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_child_that_dies_is_reported_with_its_last_words(supervisor):
    supervisor.start_client("talker", ["this_module_does_not_exist"])
    assert supervisor.reactor.run_until(lambda: bool(supervisor.events), 20 * SECOND)
    text = supervisor.events[0].text
    assert "process talker" in text
    assert "exit code 1" in text
    assert "this_module_does_not_exist" in text
    assert supervisor.pids == {}


def test_a_child_that_is_killed_is_reported_with_the_signal(supervisor):
    supervisor.start_client("sleeper", ["asyncio"])
    os.kill(supervisor.pids["sleeper"], signal.SIGKILL)
    assert supervisor.reactor.run_until(lambda: bool(supervisor.events), 20 * SECOND)
    assert "signal 9" in supervisor.events[0].text


def test_a_bridge_that_is_killed_is_started_again_three_times_a_minute(supervisor):
    supervisor.start_client("ros", ["asyncio"], restarts=Restarts())
    pids = []
    for _ in range(4):
        assert supervisor.reactor.run_until(lambda: "ros" in supervisor.pids, 20 * SECOND)
        pids.append(supervisor.pids["ros"])
        os.kill(pids[-1], signal.SIGKILL)
        deaths = len(pids)
        assert supervisor.reactor.run_until(
            lambda deaths=deaths: len([event for event in supervisor.events if event.kind == "restart"]) == deaths,
            20 * SECOND,
        )
    assert len(set(pids)) == 4
    texts = [event.text for event in supervisor.events if event.kind == "restart"]
    assert texts[0] == "process ros: it is restarted (1 of 3 times a minute)"
    assert texts[3] == "process ros: it is not restarted, because it was restarted 3 times within a minute"
    supervisor.reactor.run_for(2 * RESTART_NS)
    assert "ros" not in supervisor.pids


def test_a_recorder_that_is_killed_is_started_again_and_missing_meanwhile(supervisor, monkeypatch):
    sleeper = (sys.executable, "-c", "import time; time.sleep(60)")
    monkeypatch.setattr("canopen_control.runtime.supervisor._RECORDER", sleeper)
    supervisor.start_recorder({}, Restarts())
    first = supervisor.pids["flight"]
    os.kill(first, signal.SIGKILL)
    assert supervisor.reactor.run_until(lambda: bool(supervisor.missing), 20 * SECOND)
    assert "is restarted (1 of 3" in supervisor.missing["flight"]
    assert supervisor.reactor.run_until(lambda: "flight" in supervisor.pids, 20 * SECOND)
    assert supervisor.pids["flight"] != first
    assert supervisor.missing == {}


def test_nothing_is_started_again_while_everything_ends(supervisor):
    supervisor.start_client("ros", ["asyncio"], restarts=Restarts())
    os.kill(supervisor.pids["ros"], signal.SIGKILL)
    assert supervisor.reactor.run_until(lambda: bool(supervisor.events), 20 * SECOND)
    supervisor.end()
    supervisor.reactor.run_for(2 * RESTART_NS)
    assert supervisor.pids == {}


def test_a_client_started_earlier_passes_its_gate_and_restarts_without_one(supervisor, tmp_path, monkeypatch):
    (tmp_path / "at_the_gate.py").write_text(
        "import os\nfrom canopen_control.host.lifeline import gate_fd\n"
        "gate = gate_fd()\nprint(gate is not None and os.read(gate, 1), flush=True)\nraise SystemExit(5)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    prepared = spawn([*MODULE, "at_the_gate"], name="ros", log_dir=state_dir("test"), gated=True)
    supervisor.start_client("ros", ["at_the_gate"], restarts=Restarts(), prepared=prepared)
    assert supervisor.pids == {"ros": prepared.pid}

    def ends():
        return [event.text for event in supervisor.events if event.kind == "process_ended"]

    assert supervisor.reactor.run_until(lambda: len(ends()) == 2, 20 * SECOND)
    assert [text.partition("exit code ")[2] for text in ends()] == [
        "5; its last output: b'\\n'",
        "5; its last output: False",
    ]


def test_a_client_that_ended_at_its_gate_is_reported(supervisor):
    prepared = spawn([*MODULE, "this_module_does_not_exist"], name="ros", log_dir=state_dir("test"), gated=True)
    prepared.wait(60)
    supervisor.start_client("ros", ["asyncio"], prepared=prepared)
    assert supervisor.reactor.run_until(lambda: bool(supervisor.events), 20 * SECOND)
    assert "process ros" in supervisor.events[0].text
    assert "this_module_does_not_exist" in supervisor.events[0].text


def test_ending_leaves_no_child_and_reports_nothing(supervisor):
    supervisor.start_client("one", ["http.server", "--help"])
    supervisor.start_client("two", ["asyncio"])
    pids = list(supervisor.pids.values())
    supervisor.end()
    assert all(gone(pid) for pid in pids)
    assert supervisor.events == []
    supervisor.end()


@pytest.mark.parametrize(
    ("channel", "hosts"),
    [
        ("local:x", True),
        ("memory:x", True),
        ("virtual:x", True),
        ("vcan0", True),
        ("can0", False),
        ("pcan:PCAN_USBBUS1", False),
    ],
)
def test_virtual_drives_are_started_only_where_no_real_one_can_be(channel, hosts):
    assert hosts_virtual_drives(read_robot(find_robot("robby"), can=[channel])) is hosts


def test_a_recorder_that_cannot_be_started_is_a_warning_and_no_more(supervisor, monkeypatch):
    def refuse(*_args, **_options):
        raise CanopenError("cannot start flight: no")

    monkeypatch.setattr("canopen_control.runtime.supervisor.spawn", refuse)
    supervisor.start_recorder({"can": "local:x"})
    assert [(event.kind, event.level) for event in supervisor.events] == [("no_recorder", Level.WARNING)]


def test_where_the_recorder_wrote_after_the_robots_end_is_reported(supervisor, monkeypatch):
    script = "import signal; print('a line', flush=True); print('flight recording: x.zip', flush=True); signal.pause()"
    monkeypatch.setattr("canopen_control.runtime.supervisor._RECORDER", [sys.executable, "-c", script])
    supervisor.start_recorder({})
    child = supervisor._recorder
    assert eventually(lambda: len(child.last_lines()) == 2)
    assert "flight" in supervisor.pids
    supervisor.end()
    assert [(event.kind, event.text) for event in supervisor.events] == [("flight", "flight recording: x.zip")]
    supervisor.end()
    assert len(supervisor.events) == 1


SAYS_READY = (
    "from canopen_control.host.lifeline import report_ready; import signal; "
    "print('on my way', flush=True); {}; report_ready(); signal.pause()"
)


def drives_that(monkeypatch, code):
    """Have the supervisor start two of these in place of drives."""
    monkeypatch.setattr("canopen_control.runtime.supervisor.MODULE", (sys.executable, "-c", code))
    return read_robot(find_robot("robby"), can=["local:nobody"])


def test_the_robot_begins_when_its_drives_are_ready_and_not_before(supervisor, monkeypatch, tmp_path):
    os.mkfifo(tmp_path / "go")
    go = os.open(tmp_path / "go", os.O_RDWR)  # each drive reads one byte
    wait = f"import os; os.read(os.open({str(tmp_path / 'go')!r}, os.O_RDONLY), 1)"
    supervisor.start_drives(drives_that(monkeypatch, SAYS_READY.format(wait)))
    began = []
    supervisor.when_ready(SimpleNamespace(children_ready=lambda: began.append(True), child_failed=pytest.fail))
    assert supervisor.driven == ["left_drive", "right_drive"]
    assert eventually(lambda: all(map(Child.last_lines, supervisor._drives)))
    supervisor.reactor.serve()
    assert began == []
    os.write(go, b"12")
    os.close(go)
    assert supervisor.reactor.run_until(lambda: bool(began), 20 * SECOND)
    assert supervisor.events == []


@pytest.mark.parametrize("plant", [None, "plant.yml"])
def test_drives_are_started_with_their_personality(supervisor, monkeypatch, tmp_path, plant):
    setup = drives_that(monkeypatch, SAYS_READY.format("import sys; assert sys.argv[-2:] == ['--like', 'elmo']"))
    supervisor.start_drives(setup, plant and tmp_path / plant, like="elmo")
    began = []
    supervisor.when_ready(SimpleNamespace(children_ready=lambda: began.append(True), child_failed=pytest.fail))
    assert supervisor.reactor.run_until(lambda: bool(began), 20 * SECOND)


def test_drives_inside_this_process_have_their_personality(supervisor):
    supervisor.start_drives(read_robot(find_robot("robby"), can=["memory:like"]), like="copley")
    assert [host.nodes[0].quirks.active for host, _ in supervisor._hosts] == [["mapping_count_first"]] * 2


@pytest.fixture
def numbered(tmp_path):
    """A robot whose right drive has a revision and a serial number in bus.yml, on a channel."""
    keys = "    revision_number: 5\n    serial_number: 77\n"
    folder = copy_robby(tmp_path, bus={"right_drive:\n": f"right_drive:\n{keys}"})
    return lambda channel: read_robot(find_robot(str(folder)), can=[channel])


@pytest.mark.parametrize(("plant", "node"), [(None, ""), ("plant.yml", "2=")])
def test_drives_are_started_with_the_identity_that_bus_yml_requires(supervisor, monkeypatch, numbered, plant, node):
    started = []
    monkeypatch.setattr(supervisor, "_start_drives", lambda words, *_more: started.extend(words))
    supervisor.start_drives(numbered("local:nobody"), plant and Path(plant))
    required = [f"--object={node}0x1018:03=0x5", f"--object={node}0x1018:04=0x4D"]
    assert [word for word in started if word.startswith("--object")] == required


def test_drives_inside_this_process_have_the_identity_that_bus_yml_requires(supervisor, numbered):
    supervisor.start_drives(numbered("memory:required"))
    identities = [[host.nodes[0].store.number(0x1018, part) for part in (3, 4)] for host, _ in supervisor._hosts]
    assert [5, 77] in identities


def test_the_drives_of_a_world_are_one_process_and_what_it_guessed_is_reported(supervisor, monkeypatch, tmp_path):
    setup = drives_that(monkeypatch, SAYS_READY.format("print('world: a mass'); print('other', flush=True)"))
    supervisor.start_drives(setup, tmp_path / "plant.yml")
    began = []
    supervisor.when_ready(SimpleNamespace(children_ready=lambda: began.append(True), child_failed=pytest.fail))
    assert list(supervisor.pids) == ["drives"]
    assert supervisor.driven == ["left_drive", "right_drive"]
    assert supervisor.reactor.run_until(lambda: bool(began), 20 * SECOND)
    assert [(event.kind, event.text) for event in supervisor.events] == [("physics", "a mass")]
    assert not supervisor.refused


def test_a_world_whose_file_is_wrong_ends_the_run_with_what_it_reported(supervisor, monkeypatch, tmp_path):
    text = "print('canopen-control: plant.yml:3:1: no', flush=True); raise SystemExit(2)"
    supervisor.start_drives(drives_that(monkeypatch, text), tmp_path / "plant.yml")
    failed = []
    supervisor.when_ready(SimpleNamespace(children_ready=lambda: pytest.fail("it began"), child_failed=failed.append))
    assert supervisor.reactor.run_until(lambda: bool(failed), 20 * SECOND)
    assert failed == ["plant.yml:3:1: no"]
    assert supervisor.refused


def test_what_has_nothing_to_wait_for_begins_at_once(supervisor):
    began = []
    supervisor.when_ready(SimpleNamespace(children_ready=lambda: began.append(True), child_failed=pytest.fail))
    assert began == [True]


def test_a_drive_that_is_not_ready_in_time_is_named_with_what_it_reported(supervisor, monkeypatch):
    for name in ("_READY_NS", "_READY_EACH_NS"):
        monkeypatch.setattr(f"canopen_control.runtime.supervisor.{name}", SECOND // 10)
    supervisor.start_drives(drives_that(monkeypatch, SAYS_READY.format("signal.pause()")))
    assert eventually(lambda: all(map(Child.last_lines, supervisor._drives)))
    failed = []
    supervisor.when_ready(SimpleNamespace(children_ready=lambda: pytest.fail("it began"), child_failed=failed.append))
    assert supervisor.reactor.run_until(lambda: bool(failed), 20 * SECOND)
    (text,) = failed
    assert re.match(
        r"process drive-\w+ \(pid \d+\) was not ready within 0\.3 s; its last output: on my way; is the machine", text
    )


def test_a_drive_that_dies_before_it_is_ready_is_reported_and_not_waited_for(supervisor, monkeypatch):
    supervisor.start_drives(drives_that(monkeypatch, "raise SystemExit('no such thing')"))
    began = []
    supervisor.when_ready(
        SimpleNamespace(children_ready=lambda: began.append(len(supervisor.events)), child_failed=pytest.fail)
    )
    assert supervisor.reactor.run_until(lambda: bool(began) and len(supervisor.events) == 2, 20 * SECOND)
    assert all("no such thing" in event.text for event in supervisor.events)


IDLES = [sys.executable, "-c", "import signal; signal.pause()"]


def test_a_recorder_that_does_not_listen_in_time_is_a_warning_and_the_robot_begins(supervisor, monkeypatch):
    monkeypatch.setattr("canopen_control.runtime.supervisor._RECORDER", IDLES)
    monkeypatch.setattr("canopen_control.runtime.supervisor._LISTENING_NS", SECOND // 10)
    supervisor.start_recorder({})
    began = []
    supervisor.when_ready(SimpleNamespace(children_ready=lambda: began.append(True), child_failed=pytest.fail))
    assert began == []
    assert supervisor.reactor.run_until(lambda: bool(began), 20 * SECOND)
    assert [event.kind for event in supervisor.events] == ["no_recorder"]


BEATS = (
    "import time; from canopen_control.host.lifeline import LivenessReport; pulse = LivenessReport()\n"
    "while True: pulse.beat(); time.sleep(0.05)"
)


def test_a_recorder_that_is_stopped_is_reported_and_so_is_that_it_continues(supervisor, monkeypatch):
    check_ns = SECOND // 20
    for name, value in {"_RECORDER": [sys.executable, "-c", BEATS], "_CHECK_NS": check_ns}.items():
        monkeypatch.setattr(f"canopen_control.runtime.supervisor.{name}", value)
    monkeypatch.setattr("canopen_control.runtime.supervisor._SILENCE_NS", SECOND // 2)
    supervisor.start_recorder({})
    began = []
    supervisor.when_ready(SimpleNamespace(children_ready=lambda: began.append(True), child_failed=pytest.fail))
    assert supervisor.reactor.run_until(lambda: bool(began), 20 * SECOND)
    assert supervisor.reactor.run_for(4 * check_ns)
    assert supervisor.events == []
    pid = supervisor.pids["flight"]
    os.kill(pid, signal.SIGSTOP)
    assert supervisor.reactor.run_until(lambda: bool(supervisor.events), 20 * SECOND)
    os.kill(pid, signal.SIGCONT)
    assert supervisor.reactor.run_until(lambda: len(supervisor.events) > 1, 20 * SECOND)
    assert [event.kind for event in supervisor.events] == ["recorder_silent", "recorder_back"]
    assert str(pid) in supervisor.events[0].text
    os.kill(pid, signal.SIGKILL)
    assert supervisor.reactor.run_until(lambda: len(supervisor.events) > 2, 20 * SECOND)
    assert supervisor.events[2].kind == "process_ended"


def test_silence_counts_while_this_process_is_on_time_and_ends_with_an_answer():
    look = SECOND // 4
    silence = Silence(0)
    assert [silence.update(turn * look, None) for turn in range(1, 4)] == [look, 2 * look, 3 * look]
    assert silence.update(10 * SECOND, None) == 3 * look, "this process was held up, and so may the child have been"
    assert silence.update(10 * SECOND + look, None) == 4 * look
    assert silence.update(10 * SECOND + 2 * look, 10 * SECOND + 1) == 0
    assert silence.update(10 * SECOND + 3 * look, 10 * SECOND + 1) == look, "what was heard before is not an answer"


ANSWERS = """
import ctypes, sys, time
from canopen_control.host.lifeline import LivenessReport
pulse = LivenessReport()
for _ in range(5):
    pulse.beat()
    time.sleep(0.05)
open(sys.argv[1], "a").write("answered\\n")
{then}
"""
ANSWER_NS = SECOND // 2
HOLDS_THE_GIL = "ctypes.PyDLL(None).pause()"  # as a thread that waits inside a library for another one with the GIL


@pytest.fixture
def answering(supervisor, monkeypatch, tmp_path):
    """Start a client that answers five times, and then does something else; returns its file, a line for each start."""

    def answering(then, **limits):
        for name, value in {"_ANSWER_NS": ANSWER_NS, "_ANSWER_CHECK_NS": SECOND // 20, **limits}.items():
            monkeypatch.setattr(f"canopen_control.runtime.supervisor.{name}", value)
        (tmp_path / "answering.py").write_text(ANSWERS.format(then=then))
        monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
        supervisor.start_client("answering", ["answering", str(tmp_path / "starts")], answers=True, restarts=Restarts())
        return tmp_path / "starts"

    return answering


def kinds(supervisor):
    return [event.kind for event in supervisor.events]


def test_a_client_that_hangs_with_the_gil_is_killed_reported_and_started_again(supervisor, answering):
    starts = answering(HOLDS_THE_GIL)
    pid = supervisor.pids["answering"]
    assert supervisor.reactor.run_until(
        lambda: starts.exists() and starts.read_text().count("answered") == 2, 30 * SECOND
    )
    assert kinds(supervisor)[:3] == ["client_silent", "process_ended", "restart"]
    assert f"process answering (pid {pid}) has not answered for" in supervisor.events[0].text
    assert "signal 9" in supervisor.events[1].text
    assert gone(pid)


def test_a_client_that_is_stopped_is_killed_and_started_again(supervisor, answering):
    starts = answering("while True: pulse.beat(); time.sleep(0.05)")
    assert supervisor.reactor.run_until(starts.exists, 30 * SECOND)
    assert supervisor.reactor.run_for(3 * ANSWER_NS // 2)  # longer than a client may be silent
    assert supervisor.events == []
    os.kill(supervisor.pids["answering"], signal.SIGSTOP)
    assert supervisor.reactor.run_until(lambda: starts.read_text().count("answered") == 2, 30 * SECOND)
    assert kinds(supervisor) == ["client_silent", "process_ended", "restart"]


def test_a_client_that_never_answers_is_killed_too(supervisor, answering):
    answering("", _FIRST_ANSWER_NS=SECOND // 2)
    os.kill(supervisor.pids["answering"], signal.SIGSTOP)
    assert supervisor.reactor.run_until(lambda: len(supervisor.events) == 3, 30 * SECOND)
    assert kinds(supervisor) == ["client_silent", "process_ended", "restart"]


def test_a_client_that_has_much_to_do_has_more_time(supervisor, answering):
    starts = answering("while True: pass", _BUSY_FACTOR=4)
    assert supervisor.reactor.run_until(starts.exists, 30 * SECOND)
    begin = supervisor.reactor.now()
    assert supervisor.reactor.run_until(lambda: bool(supervisor.events), 60 * SECOND)
    assert supervisor.reactor.now() - begin > 4 * ANSWER_NS * 0.8
    assert kinds(supervisor)[0] == "client_silent"


def test_a_client_that_ends_by_itself_is_not_called_silent(supervisor, answering):
    answering("sys.exit(3)")
    assert supervisor.reactor.run_until(lambda: len(supervisor.events) >= 2, 30 * SECOND)
    assert kinds(supervisor)[:2] == ["process_ended", "restart"]


def test_three_times_a_minute_and_not_once_more():
    restarts = Restarts()
    text = [restarts.died(number * 1_000_000_000) for number in range(MAX_RESTARTS)]
    assert text[0] == "it is restarted (1 of 3 times a minute)"
    assert text[-1] == "it is restarted (3 of 3 times a minute)"
    assert not restarts.given_up
    assert restarts.died(5_000_000_000).startswith("it is not restarted")
    assert restarts.given_up


def test_a_process_that_ends_rarely_is_always_restarted():
    restarts = Restarts()
    for number in range(50):
        assert restarts.died(number * (WINDOW_NS // 2)).startswith("it is restarted")
    assert not restarts.given_up


def test_the_command_that_starts_a_drive_again_is_valid_in_every_folder(tmp_path, monkeypatch):
    shutil.copytree(data_path("config", "robby"), tmp_path / "my robby")
    shutil.copy(data_path("eds", "TMCM-1270.eds"), tmp_path / "my robby")
    monkeypatch.chdir(tmp_path)
    reactor = Reactor()
    supervisor = Supervisor("test", reactor, print)
    monkeypatch.setattr(supervisor, "_start", partial(_idle, supervisor))
    try:
        supervisor.start_drives(read_robot(find_robot("my robby"), can=["local:a"]))
        _, command = supervisor._drive_commands["drive-left_drive"]
    finally:
        supervisor.end()
        reactor.close()
    words = shlex.split(command)
    assert words[words.index("--eds") + 1] == str(tmp_path / "my robby" / "TMCM-1270.eds")


@pytest.mark.parametrize(("like", "word"), [("elmo", "elmo"), ("mine.yaml", None)])
def test_a_drive_that_is_killed_is_reported_with_the_command_that_starts_it_again(monkeypatch, tmp_path, like, word):
    """Until its node is back, which needs no further advice."""
    reactor, events = Reactor(), []
    nodes = {name: SimpleNamespace(restart_command="") for name in ("left_drive", "right_drive")}
    supervisor = Supervisor("test", reactor, events.append, nodes=nodes)
    monkeypatch.setattr(supervisor, "_start", partial(_idle, supervisor))
    try:
        monkeypatch.chdir(tmp_path)
        supervisor.start_drives(read_robot(find_robot("robby"), can=["local:a"]), like=like)
        os.kill(supervisor.pids["drive-left_drive"], signal.SIGKILL)
        assert reactor.run_until(lambda: bool(events), 20 * SECOND)
        command = nodes["left_drive"].restart_command
        words = shlex.split(command)
        assert words[:2] == ["canopen-control", "drive"]
        assert words[words.index("--node-id") + 1] == "3"
        assert words[words.index("--can") + 1] == "local:a"
        assert words[words.index("--like") + 1] == (word or str(tmp_path / like))
        assert os.path.isabs(words[words.index("--eds") + 1])
        assert nodes["right_drive"].restart_command == ""
        assert events[0].text.endswith(f"was ended by signal 9; start it again: {command}")
        assert supervisor.missing["drive-left_drive"].endswith(command)
        supervisor.node_ready("right_drive")
        assert supervisor.missing
        supervisor.node_ready("left_drive")
        assert (supervisor.missing, nodes["left_drive"].restart_command) == ({}, "")
    finally:
        supervisor.end()
        reactor.close()


def _idle(supervisor, _argv, name, _main, **_how):
    """Start a process that does nothing in place of a drive."""
    return supervisor._supervised(spawn(IDLES, name=name, log_dir=state_dir("test")))
