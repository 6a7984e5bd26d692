from __future__ import annotations

import contextlib
import errno
import os
import pathlib
import socket
import stat
import struct
import subprocess
import tempfile
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.host import python

from canopen_control.errors import CanopenError, ConfigError, DiskFull
from canopen_control.host import sockets
from canopen_control.host.sockets import (
    SocketInUse,
    check_name,
    close_listener,
    connect,
    drive_name,
    list_sockets,
    listen,
    lock,
    peer_pid,
    runtime_dir,
    same_user,
    socket_path,
)

STRANGER = 54321  # a user id that does not exist here


def give_away(path, monkeypatch):
    """Let `path` belong to another user: root gives it away, everybody else takes himself for another one."""
    if os.getuid() == 0:
        os.chown(path, STRANGER, STRANGER)
    else:
        monkeypatch.setattr(os, "getuid", lambda: STRANGER)


def mode_of(path):
    return stat.S_IMODE(os.lstat(path).st_mode)


def make_stale(path):
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))


@pytest.fixture
def temp(tmp_path, monkeypatch):
    """A temporary folder of its own, as everybody's is: sticky and open to all."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    folder.chmod(0o1777)
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


# -- the folder


def test_it_is_below_the_runtime_folder_and_ours_alone(run_folder):
    old = os.umask(0)
    try:
        assert runtime_dir() == run_folder / "canopen_control"
    finally:
        os.umask(old)
    assert mode_of(runtime_dir()) == 0o700


@pytest.mark.parametrize("value", [None, "", "relative/folder", "/does/not/exist"])
def test_without_a_usable_runtime_folder_it_is_below_the_temporary_one(monkeypatch, temp, value):
    if value is None:
        monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    else:
        monkeypatch.setenv("XDG_RUNTIME_DIR", value)
    assert runtime_dir() == temp / f"canopen_control-{os.getuid()}"
    assert mode_of(runtime_dir()) == 0o700


def test_a_runtime_folder_of_another_user_is_refused(run_folder, monkeypatch):
    give_away(run_folder, monkeypatch)
    with pytest.raises(ConfigError, match="set XDG_RUNTIME_DIR to a folder that you own, or unset it"):
        runtime_dir()


def test_a_folder_of_another_user_in_the_temporary_one_is_refused(monkeypatch, temp):
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    folder = runtime_dir()
    give_away(folder, monkeypatch)
    with pytest.raises(ConfigError, match=r"belongs to user id \d+"):
        sockets.private_folder(folder)


def test_a_symbolic_link_is_refused_wherever_it_leads(run_folder, tmp_path):
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    (run_folder / "canopen_control").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ConfigError, match="it is a symbolic link; remove it"):
        runtime_dir()
    (tmp_path / "elsewhere").rmdir()
    with pytest.raises(ConfigError, match="it is a symbolic link; remove it"):
        runtime_dir()
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize("mode", [0o755, 0o770, 0o701, 0o1777])
def test_a_folder_that_others_may_enter_is_refused(run_folder, mode):
    runtime_dir().chmod(mode)
    with pytest.raises(ConfigError, match=f"mode {mode:04o}.*chmod 700 on it"):
        runtime_dir()
    assert mode_of(run_folder / "canopen_control") == mode  # and not repaired, since a program may use it


def test_a_file_in_its_place_is_refused(run_folder):
    (run_folder / "canopen_control").write_text("")
    with pytest.raises(ConfigError, match="not a folder"):
        runtime_dir()


def test_a_parent_in_which_anybody_can_swap_it_is_refused(run_folder):
    run_folder.chmod(0o777)
    with pytest.raises(ConfigError, match="no sticky bit"):
        runtime_dir()
    run_folder.chmod(0o1777)
    runtime_dir()


def test_a_runtime_folder_that_is_a_link_to_a_good_one_is_fine(monkeypatch, run_folder, tmp_path_factory):
    link = tmp_path_factory.mktemp("l") / "link"  # short, because it is part of a socket's path
    link.symlink_to(run_folder)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(link))
    path = socket_path("bus", "b")
    listener = listen(path)
    assert (run_folder / path.relative_to(link)).is_socket()
    close_listener(listener)


def test_a_folder_that_cannot_be_made_is_a_sentence(run_folder, monkeypatch):
    def refuse(*_args, **_options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(sockets.Path, "mkdir", refuse)
    with pytest.raises(ConfigError, match=r"cannot create .*: Permission denied; set XDG_RUNTIME_DIR"):
        runtime_dir()


# -- names and paths


@given(st.text(max_size=40))
def test_a_name_is_short_and_plain(name):
    allowed = set("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-")
    if 1 <= len(name) <= 32 and set(name) <= allowed:
        assert check_name(name) == name
    else:
        with pytest.raises(ConfigError, match="is not a valid name"):
            check_name(name)


@pytest.mark.parametrize("name", ["", "..", "a/b", "a b", "a.b", "x" * 33, "ä", "a\n", "a\0b"])
def test_what_could_lead_out_of_the_folder_is_not_a_name(run_folder, name):
    with pytest.raises(ConfigError, match="is not a valid name"):
        socket_path("bus", name)


@pytest.fixture
def too_long(tmp_path, monkeypatch, request):
    """A runtime folder too long for a socket's address, and what it leaves in /tmp taken away."""
    folder = tmp_path / ("x" * 90)
    folder.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    yield folder
    with_short = sockets._short_folder(folder / "canopen_control")
    for file in with_short.iterdir():
        file.unlink()
    with_short.rmdir()


def test_a_runtime_folder_too_long_for_an_address_falls_back_to_a_short_path(too_long):
    path = socket_path("robot", "robby")
    assert len(os.fsencode(path)) <= 100
    assert mode_of(path.parent) == mode_of(path.parent.parent) == 0o700
    listener = listen(path)
    with connect(path):
        assert list_sockets("robot") == ["robby"]
    close_listener(listener)
    assert list_sockets("robot") == []


@pytest.mark.parametrize(
    ("channel", "node_id", "name"),
    [
        ("local:robby", 3, "robby-3"),
        ("vcan0", 127, "vcan0-127"),
        ("memory:a.b/c", 1, "a_b_c-1"),
        ("local:" + "x" * 32, 5, "x" * 31 + "-5"),
    ],
)
def test_the_socket_of_a_virtual_drive_is_named_after_bus_and_node(channel, node_id, name):
    assert drive_name(channel, node_id) == name
    assert socket_path("drive", name).name == f"drive-{name}.sock"


# -- listening


def test_a_socket_is_for_its_user_alone_whatever_the_umask(run_folder):
    path = socket_path("bus", "b")
    old = os.umask(0)
    try:
        listener = listen(path)
        assert os.umask(0) == 0
    finally:
        os.umask(old)
    assert mode_of(path) & 0o077 == 0
    assert not listener.getblocking()
    close_listener(listener)


def test_a_stale_socket_is_replaced(run_folder):
    path = socket_path("bus", "b")
    make_stale(path)
    with pytest.raises(ConnectionRefusedError):
        connect(path)
    listener = listen(path)
    connect(path).close()
    close_listener(listener)
    assert not path.exists()


def test_a_living_one_is_not(run_folder):
    path = socket_path("bus", "b")
    listener = listen(path)
    with pytest.raises(SocketInUse, match=f"bus-b is in use by process {os.getpid()}") as caught:
        listen(path)
    assert caught.value.pid == os.getpid()
    connect(path).close()
    close_listener(listener)


def test_one_that_is_too_busy_to_accept_is_alive(run_folder, monkeypatch):
    monkeypatch.setattr(sockets, "_PROBE_S", 0.01)
    path = socket_path("bus", "b")
    listener = listen(path, backlog=0)
    waiting = [connect(path)]
    with pytest.raises(SocketInUse):
        listen(path)
    assert list_sockets("bus") == ["b"]
    for sock in waiting:
        sock.close()
    close_listener(listener)


def test_a_file_in_the_sockets_place_is_not_removed(run_folder):
    path = socket_path("bus", "b")
    path.write_text("precious")
    with pytest.raises(ConfigError, match="is not a socket; remove it"):
        listen(path)
    assert path.read_text() == "precious"
    assert list_sockets("bus") == []


def test_a_listener_that_cannot_be_bound_leaves_nothing(run_folder, monkeypatch):
    def refuse(_sock, _path, _advice):
        raise OSError("no room")

    monkeypatch.setattr(sockets, "_bind_private", refuse)
    with pytest.raises(OSError, match="no room"):
        listen(socket_path("bus", "b"))
    assert list_sockets("bus") == []


def full(*_args, **_options):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("owner", [(socket.socket, "bind"), (sockets.os, "open")], ids=["socket", "lock"])
def test_without_space_it_names_the_file_system(run_folder, monkeypatch, owner):
    path = socket_path("bus", "b")
    monkeypatch.setattr(*owner, full)
    text = (
        rf"cannot create {path}.*: No space left on device; nothing was started; free some space on the file system of"
    )
    with pytest.raises(DiskFull, match=text):
        listen(path)


def test_a_folder_without_space_names_the_file_system(temp, monkeypatch):
    monkeypatch.setattr(pathlib.Path, "mkdir", full)
    with pytest.raises(DiskFull, match=r"cannot create .*/canopen_control.*; free some space on the file system of /"):
        runtime_dir()


def test_a_claim_holds_without_space_for_the_process_id(tmp_path, monkeypatch):
    path = tmp_path / "master.lock"
    with monkeypatch.context() as patched:
        patched.setattr(sockets.os, "write", full)
        held = sockets.claim(path)
    with pytest.raises(SocketInUse) as caught:
        sockets.claim(path)
    assert caught.value.pid == 0
    os.close(held)


def test_closing_twice_does_not_remove_a_successor(run_folder):
    path = socket_path("bus", "b")
    first = listen(path)
    close_listener(first)
    second = listen(path)
    close_listener(first)
    assert path.is_socket()
    connect(path).close()
    close_listener(second)


def test_of_many_threads_that_start_at_once_one_serves(run_folder):
    path = socket_path("bus", "b")
    make_stale(path)
    barrier = threading.Barrier(8)
    served, refused = [], []

    def start():
        barrier.wait()
        try:
            served.append(listen(path))
        except SocketInUse:
            refused.append(1)

    threads = [threading.Thread(target=start) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (len(served), len(refused)) == (1, 7)
    connect(path).close()
    close_listener(served[0])


@pytest.mark.process
def test_of_many_processes_that_start_at_once_one_serves(run_folder):
    path = socket_path("bus", "b")
    make_stale(path)
    code = f"""
import sys
from pathlib import Path
from canopen_control.host.sockets import SocketInUse, close_listener, listen
sys.stdin.readline()
try:
    listener = listen(Path({str(path)!r}))
except SocketInUse:
    print("refused", flush=True)
else:
    print("serves", flush=True)
    sys.stdin.readline()
    close_listener(listener)
"""
    options = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    starters = [subprocess.Popen(python(code), **options) for _ in range(6)]
    try:
        for starter in starters:
            starter.stdin.write("\n")
            starter.stdin.flush()
        text = sorted(starter.stdout.readline().strip() for starter in starters)
        assert text == ["refused"] * 5 + ["serves"]
    finally:
        for starter in starters:
            starter.communicate("\n", timeout=60)
    assert not path.exists()


# -- locks


def test_a_lock_has_one_holder_and_reports_the_process_that_came_second(run_folder):
    path = socket_path("bus", "b")
    with lock(path), pytest.raises(CanopenError, match=r"holds .*bus-b\.sock\.lock for too long"), lock(path, 0.01):
        pytest.fail("two holders")
    with lock(path, 0):
        pass


@pytest.mark.process
def test_a_holder_that_dies_frees_the_lock(run_folder):
    path = socket_path("bus", "b")
    code = f"""
import os
from pathlib import Path
from canopen_control.host.sockets import lock
with lock(Path({str(path)!r})):
    print("held", flush=True)
    os.read(0, 1)
"""
    with subprocess.Popen(python(code), stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(CanopenError), lock(path, 0.01):
            pass
        holder.kill()
        with lock(path, 10):
            pass


def test_a_lock_through_a_link_is_refused(run_folder, tmp_path):
    path = socket_path("bus", "b")
    path.with_name("bus-b.sock.lock").symlink_to(tmp_path / "victim")
    with pytest.raises(ConfigError, match=r"b\.sock\.lock cannot be a lock: it is a symbolic link; remove"), lock(path):
        pass
    assert not (tmp_path / "victim").exists()


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_a_lock_that_is_not_a_file_is_refused(run_folder, make):
    path = socket_path("bus", "b")
    make(path.with_name("bus-b.sock.lock"))
    with pytest.raises(ConfigError, match=r"cannot be a lock: .*; remove it, and try again"), lock(path):
        pass


# -- running robots


def test_only_the_living_of_a_kind_are_listed(run_folder):
    listeners = [listen(socket_path(kind, name)) for kind, name in (("bus", "b"), ("bus", "a-1"), ("busctl", "c"))]
    make_stale(socket_path("bus", "dead"))
    assert list_sockets("bus") == ["a-1", "b"]
    assert list_sockets("busctl") == ["c"]
    assert list_sockets("robot") == []
    for listener in listeners:
        close_listener(listener)


def test_both_ends_receive_the_credentials_of_the_other(run_folder):
    path = socket_path("bus", "b")
    listener = listen(path)
    with connect(path) as ours:
        theirs, _ = listener.accept()
        with theirs:
            assert same_user(ours)
            assert same_user(theirs)
            assert peer_pid(ours) == peer_pid(theirs) == os.getpid()
    close_listener(listener)


def test_the_server_of_another_user_is_not_talked_to(run_folder, monkeypatch):
    path = socket_path("bus", "b")
    listener = listen(path)
    monkeypatch.setattr(sockets, "_peer", lambda sock: (1, os.getuid() + 1))
    with pytest.raises(CanopenError, match="another user"):
        connect(path)
    close_listener(listener)


@pytest.mark.process
def test_the_kernel_reports_another_user_apart(monkeypatch):
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX) as listener:
        listener.settimeout(60)
        listener.bind(f"{folder}/open.sock")
        listener.listen()
        os.chmod(folder, 0o755)
        os.chmod(f"{folder}/open.sock", 0o777)
        stranger = os.fork()
        if not stranger:
            with contextlib.suppress(BaseException):
                if os.getuid() == 0:
                    os.setuid(STRANGER)
                peer = socket.socket(socket.AF_UNIX)
                peer.connect(f"{folder}/open.sock")
                peer.recv(1)
            os._exit(0)
        try:
            theirs, _ = listener.accept()
            with theirs:
                if os.getuid() != 0:
                    monkeypatch.setattr(os, "getuid", lambda: STRANGER)
                assert not same_user(theirs)
                assert peer_pid(theirs) == stranger
        finally:
            os.waitpid(stranger, 0)


def test_a_peer_whose_user_is_unknown_is_refused():
    with socket.socket() as unconnected:
        unconnected.close()
        assert not same_user(unconnected)
        assert peer_pid(unconnected) == 0


def test_on_a_bsd_the_user_is_known_and_the_process_is_not(monkeypatch):
    class Bsd:
        def getsockopt(self, level, option, size):
            assert (level, option, size) == (0, 1, 76)
            return struct.pack("=Iih16i", 0, os.getuid(), 0, *range(16)).ljust(76, b"\0")

    monkeypatch.setattr(sockets, "_LINUX", False)
    assert same_user(Bsd())
    assert peer_pid(Bsd()) == 0


def test_one_process_at_a_time_has_a_claim_and_a_second_one_gets_its_id(tmp_path):
    path = tmp_path / "bridge-robby-0.lock"
    held = sockets.claim(path)
    with pytest.raises(sockets.SocketInUse, match=f"is in use by process {os.getpid()}") as raised:
        sockets.claim(path)
    assert raised.value.pid == os.getpid()
    os.close(held)
    os.close(sockets.claim(path))


def test_a_claim_waits_for_a_holder_that_is_ending(tmp_path):
    path = tmp_path / "bridge-robby-0.lock"
    held = sockets.claim(path)
    with pytest.raises(sockets.SocketInUse):
        sockets.claim(path)
    ending = threading.Timer(0.02, os.close, (held,))
    ending.start()
    os.close(sockets.claim(path, 10.0))
    assert ending.finished.is_set()
    ending.join()


def test_a_claim_whose_holder_is_not_known_has_the_number_0(tmp_path):
    path = tmp_path / "bridge-robby-0.lock"
    held = sockets.claim(path)
    os.truncate(held, 0)
    with pytest.raises(sockets.SocketInUse) as raised:
        sockets.claim(path)
    assert raised.value.pid == 0
    os.close(held)


def test_a_connecting_client_waits_for_the_queue_up_to_its_timeout(run_folder):
    path = run_folder / "full.sock"
    with contextlib.ExitStack() as stack:
        server = listen(path, backlog=0)
        stack.callback(close_listener, server)
        stack.enter_context(connect(path))
        with pytest.raises(BlockingIOError):
            connect(path, 0.05)
        late = threading.Timer(0.1, lambda: stack.enter_context(server.accept()[0]))
        late.start()
        client = stack.enter_context(connect(path, 10.0))
        late.join()
        assert client.gettimeout() == 10.0
