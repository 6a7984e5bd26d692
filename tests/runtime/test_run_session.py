import os
import sys

import pytest
from support.busalone import write_drives, write_io
from support.observers import Observer

from canopen_control.errors import CanopenError, ConfigError, RobotConfigError
from canopen_control.host import sockets
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import claim, runtime_dir
from canopen_control.runtime import run_session
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.run_session import RunOptions, RunSession
from canopen_control.runtime.setup import read_robot

pytestmark = pytest.mark.robot

LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="scheduling policies are Linux's")


def setup(name, channel):
    return read_robot(find_robot("robby"), name=name, can=[channel])


def test_a_channel_has_one_master_on_this_host():
    first = RunSession(setup("one", "memory:busy"), RunOptions(drives=False))
    with pytest.raises(RobotConfigError, match=rf"memory:busy is busy: process {os.getpid()} .*shutdown --name one\)"):
        RunSession(setup("two", "memory:busy"), RunOptions(drives=False))
    first.close()
    RunSession(setup("two", "memory:busy"), RunOptions(drives=False)).close()


@pytest.mark.parametrize("ends", [True, False])
def test_a_run_that_is_about_to_end_is_awaited(monkeypatch, ends):
    """Its socket is closed before its child processes end, and the lock is released last."""
    held = claim(runtime_dir() / "master-memory_ending.lock")
    os.truncate(held, 0)
    os.pwrite(held, b"4194305\n", 0)  # a process without a socket
    monkeypatch.setattr(run_session, "_ENDING_S", 0.02)
    if ends:
        monkeypatch.setattr(sockets.time, "sleep", lambda _seconds: os.close(held))
        RunSession(setup("next", "memory:ending"), RunOptions(drives=False)).close()
        return
    with pytest.raises(RobotConfigError, match="memory:ending is busy: process 4194305"):
        RunSession(setup("next", "memory:ending"), RunOptions(drives=False))
    os.close(held)


def test_a_lock_through_a_link_is_a_sentence(tmp_path):
    link = runtime_dir() / "master-memory_linked.lock"
    link.symlink_to(tmp_path / "victim")
    with pytest.raises(ConfigError, match=r"_linked\.lock cannot be a lock: it is a symbolic link; remove it"):
        RunSession(setup("linked", "memory:linked"), RunOptions(drives=False))
    link.unlink()
    assert not (tmp_path / "victim").exists()


def test_a_name_has_one_robot():
    first = RunSession(setup("same", "memory:a"), RunOptions(drives=False))
    with pytest.raises(CanopenError, match="same"):
        RunSession(setup("same", "memory:b"), RunOptions(drives=False))
    first.close()


def test_a_second_run_of_a_robot_is_refused_by_its_name_since_another_channel_would_not_help():
    first = RunSession(setup("again", "memory:again"), RunOptions(drives=False))
    with pytest.raises(RobotConfigError, match=r"a robot named again runs already .*shutdown --name again.*with --as"):
        RunSession(setup("again", "memory:again"), RunOptions(drives=False))
    first.close()


def test_a_channel_that_is_busy_leaves_no_socket():
    first = RunSession(setup("one", "memory:kept"), RunOptions(drives=False))
    with pytest.raises(RobotConfigError, match="memory:kept is busy"):
        RunSession(setup("two", "memory:kept"), RunOptions(drives=False))
    assert [path.name for path in runtime_dir().glob("robot-*.sock")] == ["robot-one.sock"]
    first.close()


def test_closing_leaves_no_socket_and_twice_is_once():
    session = RunSession(setup("gone", "memory:c"), RunOptions(drives=False))
    assert list(runtime_dir().glob("robot-*.sock"))
    session.close()
    session.close()
    assert list(runtime_dir().glob("robot-*.sock")) == []


def test_the_duration_counts_from_running_on():
    reactor = Reactor()
    session = RunSession(setup("timed", "memory:d"), RunOptions(duration=0.2), reactor=reactor)
    try:
        assert session.run() is None
        assert session.robot.pacer.count * 0.02 > 0.2
    finally:
        session.close()


def latched(name, duration):
    session = RunSession(setup(name, f"memory:{name}"), RunOptions(duration=duration))
    session.robot.latch.hold("canopen-control stop", 0)
    return session


def test_the_duration_counts_from_the_boot_on_while_stop_is_latched_and_a_run_that_did_nothing_has_failed():
    session = latched("waits", 0.2)
    try:
        assert session.run() == (
            "waits did not start within 0.2 s: STOP is latched (by canopen-control stop); "
            "start the robot without --for, then: canopen-control stop --release"
        )
    finally:
        session.close()


def test_a_stop_that_is_released_in_time_leaves_a_run_that_ends_well():
    session = latched("freed", 1.0)
    booted = Observer(booted=lambda: session.reactor.call_soon(lambda: session.robot.latch.release("a test", 0)))
    session.robot.observers.append(booted)
    try:
        assert session.run() is None
        assert session.robot.has_run
    finally:
        session.close()


def test_the_page_is_a_client_that_is_started_when_the_boot_is_over(monkeypatch):
    started = []
    session = RunSession(setup("page", "memory:page"), RunOptions(drives=False, view=True, teleop=True))

    def start_client(name, arguments, **how):
        assert how["restarts"] is not None  # a page that is killed is restarted
        started.append((name, arguments))

    monkeypatch.setattr(session.supervisor, "start_client", start_client)
    session.start()
    assert started == []
    assert session.reactor.run_until(lambda: bool(started), 3_000_000_000)
    assert started == [("view", ["canopen_control", "view", "--name", "page", "--teleop"])]
    session.close()


@pytest.mark.process
@LINUX
def test_a_processor_of_its_own_is_the_robots_and_not_its_childrens(monkeypatch):
    everywhere = os.sched_getaffinity(0)
    one = min(everywhere)
    session = RunSession(setup("pinned", "memory:pin"), RunOptions(cpu=one))
    started = []
    monkeypatch.setattr(
        session.supervisor, "start_drives", lambda _setup, _plant, like: started.append(os.sched_getaffinity(0))
    )
    try:
        session.start()
        assert started == [everywhere]
        assert os.sched_getaffinity(0) == {one}
        assert [event.text for event in session.robot.events.recent if event.kind == "realtime"] == [
            f"runs on processor {one}"
        ]
        session.supervisor.start_client("later", ["platform"])
        assert os.sched_getaffinity(session.supervisor.pids["later"]) == everywhere
    finally:
        session.close()
    assert os.sched_getaffinity(0) == everywhere


@LINUX
def test_what_is_refused_ends_the_run_before_there_is_anything_of_it():
    with pytest.raises(RobotConfigError, match="--cpu 4000"):
        RunSession(setup("refused", "memory:refused"), RunOptions(cpu=4000))
    assert list(runtime_dir().glob("robot-*.sock")) == []


def test_what_ends_it_before_it_began_ends_it():
    session = RunSession(setup("early", "memory:early"), RunOptions(drives=False))
    session.robot.join()
    session.reactor.call_soon(lambda: session.robot.shutdown("a test"))
    session.reactor.run()
    assert [event.text for event in session.robot.events.take()][-1] == "early was stopped before it started"
    session.robot.start()
    assert not session.robot.pacer.running
    session.close()


@pytest.mark.sources
def test_a_robot_whose_drives_are_ready_boots_when_it_has_received_them(monkeypatch):
    session = RunSession(setup("heard", "memory:heard"), RunOptions(drives=False))
    received = []
    monkeypatch.setattr(session.robot, "has_heard", lambda _names: bool(received))
    session.start()
    session.reactor.run_for(50_000_000)
    assert not session.robot.pacer.running
    received.append(True)
    assert session.reactor.run_until(lambda: session.robot.pacer.running, 3_000_000_000)
    session.close()


@pytest.mark.parametrize(("write", "nodes", "message"), [(write_drives, 2, True), (write_io, 1, False)])
def test_a_demo_of_a_bus_without_controllers_moves_nothing_and_reports_how(tmp_path, write, nodes, message):
    result = read_robot(find_robot(str(write(tmp_path))), name="alone", can=["memory:alone"])
    session = RunSession(result, RunOptions(duration=0.3, motion=True), reactor=Reactor())
    events = []
    session.robot.observers.append(Observer(event=events.append))
    try:
        assert session.run() is None
        assert len(session.robot.nodes) == nodes
        assert session.robot.commander is None
        assert any(event.kind == "demo" and "axis enable" in event.text for event in events) is message
    finally:
        session.close()
