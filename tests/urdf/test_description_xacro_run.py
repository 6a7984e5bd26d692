from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.host import eventually

from canopen_control.errors import RobotConfigError
from canopen_control.urdf.description import XacroLimits, XacroRun

pytestmark = pytest.mark.process

HEAD = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="r">'


def write(folder, text: str, name: str = "r.urdf.xacro"):
    path = folder / name
    path.write_text(f"{HEAD}{text}</robot>", encoding="utf-8")
    return path


def run_xacro(path, mappings, limits=None):
    with XacroRun(path, mappings, limits) as run:
        return run.result()


def test_arguments_macros_and_includes_work(tmp_path):
    write(tmp_path, '<xacro:macro name="m" params="n"><link name="${n}_${2 * 3}"/></xacro:macro>', "m.xacro")
    path = write(
        tmp_path, '<xacro:arg name="who" default="left"/><xacro:include filename="m.xacro"/><xacro:m n="$(arg who)"/>'
    )
    assert '<link name="left_6"/>' in run_xacro(path, {})
    assert '<link name="right_6"/>' in run_xacro(path, {"who": "right"})


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('<link name="${unknown}"/>', "unknown"),
        ('<xacro:include filename="none.xacro"/>', "none.xacro"),
        ("<xacro:nothing/>", "nothing"),
        ('<link name="${1 / 0}"/>', "division by zero"),
        ("<link>", "mismatched tag"),
        ('<link name="$(find no_such_package_here)"/>', "no_such_package_here"),
        ('<link name="$(arg missing)"/>', "missing"),
    ],
)
def test_whatever_xacro_refuses_is_one_error_with_the_file(tmp_path, text, expected):
    path = write(tmp_path, text)
    with pytest.raises(RobotConfigError, match=expected) as caught:
        run_xacro(path, {})
    assert str(caught.value).startswith(f"{path}: xacro: ")


SMALL = XacroLimits(processor_s=1, wall_s=30, memory=256 << 20)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('<link name="${9**9**9}"/>', "xacro took more than 1 s of processor time; look for an endless power"),
        ('<link name="${[n for n in range(10**12) if n == -1]}"/>', "more than 1 s of processor time"),
        ('<link name="${list(range(10**12))}"/>', "it needs too much memory"),
        ('<link name="${str(0) * 2**40}"/>', "it needs too much memory"),
        ('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>', "it nests endlessly; a macro or an include"),
        ('<xacro:include filename="r.urdf.xacro"/>', "it nests endlessly|more than 1 s|too much memory"),
    ],
)
def test_what_never_ends_or_takes_all_memory_is_a_sentence(tmp_path, text, expected):
    path = write(tmp_path, text)
    with pytest.raises(RobotConfigError, match=expected) as caught:
        run_xacro(path, {}, SMALL)
    assert str(caught.value).startswith(f"{path}: xacro")
    assert len(str(caught.value)) < 1000


def test_what_waits_for_ever_is_ended_by_the_clock(tmp_path):
    os.mkfifo(tmp_path / "silent.xacro")
    path = write(tmp_path, '<xacro:include filename="silent.xacro"/>')
    with pytest.raises(RobotConfigError, match=r"xacro took more than 1 s; look for"):
        run_xacro(path, {}, XacroLimits(wall_s=1))


def test_a_run_that_is_not_awaited_leaves_no_process(tmp_path):
    with XacroRun(write(tmp_path, '<link name="${9**9**9}"/>'), {}) as run:
        process = run._process
        assert process.poll() is None
    # SIGKILL, or before it the end of the pipe that the child watches: SIGIO, in its first instructions an exit
    assert process.returncode in (-signal.SIGKILL, -signal.SIGIO, 1)


FORKED = "from canopen_control.host.fork import allow_forks; allow_forks()"


def test_a_fork_gives_what_a_new_interpreter_gives(tmp_path):
    texts = {
        "good": '<link name="${2 * 3}"/>',
        "wrong": '<link name="${1 / 0}"/>',
        "large": '<link name="${list(range(10**12))}"/>',
        "endless": '<link name="${9**9**9}"/>',
    }
    for name, text in texts.items():
        write(tmp_path, text, f"{name}.xacro")
    script = f"""
import sys
from pathlib import Path
from canopen_control.errors import RobotConfigError
from canopen_control.urdf.description import XacroLimits, XacroRun
exec(sys.argv[1])
for name in {list(texts)}:
    with XacroRun(Path(name + ".xacro"), {{"unused?": "1"}}, XacroLimits(1, 30, 512 << 20)) as run:
        try:
            print(run.result())
        except RobotConfigError as error:
            print(error)
    print(type(run._process).__name__)
"""

    def lines(preparation):
        command = [sys.executable, "-P", "-c", script, preparation]
        return subprocess.check_output(command, text=True, cwd=tmp_path).splitlines()

    forked = lines(FORKED)
    assert forked.count("ForkedProcess") == len(texts)
    assert [line.replace("ForkedProcess", "Popen") for line in forked] == lines("")
    assert any("more than 1 s of processor time" in line for line in forked)


@pytest.mark.parametrize("preparation", ["", FORKED], ids=["interpreter", "fork"])
def test_it_does_not_outlive_its_parent(tmp_path, preparation):
    path = write(tmp_path, '<link name="${9**9**9}"/>')
    script = f"""
import os, signal, sys, time
from pathlib import Path
from canopen_control.urdf.description import XacroRun
{preparation}
run = XacroRun(Path({str(path)!r}), {{}})
print(run._process.pid, flush=True)
while int(Path(f"/proc/{{run._process.pid}}/stat").read_text().rpartition(")")[2].split()[11]) < 50:
    time.sleep(0.01)  # after half a second of processor time it is in the middle of it
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL
    assert eventually(lambda: not Path(f"/proc/{done.stdout.strip()}").exists())
