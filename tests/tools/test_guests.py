"""The launchers of the guests: messages without a guest, exit codes, limits and files."""

import ctypes
import errno
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.guest import scaled_robby

ROOT = Path(__file__).parents[2]
UML, EMULATED = "socketcan_guest", "can_hardware_guest"


def launch(tool, *words, path=None, cwd=None, **variables):
    environment = {**os.environ, **variables} | ({} if path is None else {"PATH": path})
    words = [shutil.which("bash"), str(ROOT / "tools" / tool), *map(str, words)]
    return subprocess.run(words, capture_output=True, text=True, env=environment, cwd=cwd, timeout=100)


@pytest.fixture
def bare(tmp_path):
    """Return a PATH with nothing but what any system has."""
    for name in ("dirname", "uname", "basename", "grep", "sed", "head", "cat"):
        (tmp_path / name).symlink_to(shutil.which(name))
    return str(tmp_path)


@pytest.mark.parametrize(
    ("tool", "package"), [(UML, "user-mode-linux"), (EMULATED, "qemu-system-x86")], ids=["uml", "qemu"]
)
def test_without_the_packages_it_suggests_what_to_type(tool, package, bare):
    done = launch(tool, "true", path=bare)
    if "needs Linux on x86_64" not in done.stderr:
        assert "not installed: " in done.stderr
        assert "run: sudo apt-get install" in done.stderr
        amx = "amx_tile" in Path("/proc/cpuinfo").read_text(encoding="utf-8")  # user-mode Linux cannot run there
        emulated = amx or os.environ.get("CANOPEN_CONTROL_VCAN_GUEST") == "qemu"
        assert ("qemu-system-x86" if emulated else package) in done.stderr
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)


@pytest.fixture
def guest(tmp_path):
    """Return what runs a command in user-mode Linux."""
    there = launch(UML, "-c")
    if there.returncode:
        pytest.skip(there.stderr.strip())
    return lambda *words, **options: launch(UML, *words, **options)


def test_words_exit_code_variables_and_place_go_in_and_out_unchanged(guest, tmp_path):
    words = ["two words", "it's", "$HOME", "", "*"]
    script = 'for word in "$@"; do echo "[$word]"; done; pwd; echo "$MINE"; cat /sys/class/net/vcan0/flags; exit 7'
    done = guest("-e", "MINE=a 'b'", "sh", "-c", script, "sh", *words, cwd=tmp_path)
    assert done.returncode == 7, done.stderr
    lines = done.stdout.splitlines()
    assert lines[:-1] == [*(f"[{word}]" for word in words), str(tmp_path), "a 'b'"]
    assert int(lines[-1], 16) & 1, "vcan0 is up"


def test_a_command_without_end_is_ended_and_named(guest):
    done = guest("-t", "8", "sleep", "1000")
    assert done.returncode == 124
    assert "the command did not end within 8 s" in done.stderr


def test_the_command_of_the_docs_for_this_guest_runs(guest, tmp_path):
    page = (ROOT / "docs" / "guide" / "hardware.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"^ {4}(tools/socketcan_guest .*?)  +#", page, re.MULTILINE)
    words = [
        str(Path(sys.executable).parent / word[10:]) if word.startswith(".venv/bin/") else word for word in line.split()
    ]
    scale = guest("sh", "-c", "echo ${CANOPEN_CONTROL_TIME_SCALE:-1}").stdout
    scaled_robby(tmp_path, float(scale))  # an emulated PC is slower than the heartbeats of robby
    words[words.index("robby")] = "./robby"
    done = guest(*words[1:], cwd=tmp_path)
    assert done.returncode == 0, done
    assert "robby runs" in done.stdout


class _Vector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


_TRACEME, _CONT, _GETREGSET, _SETREGSET, _XSTATE = 0, 7, 0x4204, 0x4205, 0x202


@pytest.fixture
def stopped():
    """Return the process id of a child that is traced and stopped."""
    libc = ctypes.CDLL(None)
    child = os.fork()
    if child == 0:
        libc.ptrace(_TRACEME, 0, None, None)
        os.kill(os.getpid(), signal.SIGSTOP)
        os._exit(0)
    os.waitpid(child, 0)
    yield child
    libc.ptrace(_CONT, child, None, None)
    os.waitpid(child, 0)


def test_a_part_of_the_extended_registers_is_set_with_the_preloaded_library(tmp_path, stopped):
    if not shutil.which("cc"):
        pytest.skip("no C compiler")
    path = tmp_path / "xstate.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-Werror", "-o", path, ROOT / "tools/guest/xstate.c"], check=True)
    libc, library = ctypes.CDLL(None, use_errno=True), ctypes.CDLL(str(path), use_errno=True)

    def registers(library, request, buffer, length):
        vector = _Vector(ctypes.addressof(buffer), length)
        code = library.ptrace(request, stopped, ctypes.c_void_p(_XSTATE), ctypes.byref(vector))
        return vector.length if code == 0 else errno.errorcode[ctypes.get_errno()]

    before, after = ctypes.create_string_buffer(1 << 15), ctypes.create_string_buffer(1 << 15)
    length = registers(libc, _GETREGSET, before, len(before))
    part = length - 64
    assert registers(libc, _SETREGSET, before, part) == "EFAULT", "the kernel takes all registers or none"
    assert registers(library, _SETREGSET, before, part) == part
    assert registers(libc, _GETREGSET, after, len(after)) == length
    assert after.raw == before.raw
