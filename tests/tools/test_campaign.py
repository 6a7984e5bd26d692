"""`tools/campaign` as a process: output, exit codes, and detection of violations."""

import json
import os
import re
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
from campaigner.script import make_script

from canopen_control.bus.channel import open_port
from canopen_control.frame import CanFrame, pack_records

ROOT = Path(__file__).parents[2]
TOOL = (sys.executable, "-P", "-m", "campaigner")  # what tools/campaign runs when the package is installed
QUIET = "1 stream left=8 right=-8 how=socket ends=close seconds=1.5\n4 stop latch=yes\n4.6 recover\n"


@pytest.fixture(autouse=True)
def tools(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "tools"))


def campaign(*words):
    return subprocess.run([*TOOL, *words], capture_output=True, text=True, timeout=100)


@pytest.fixture
def quiet(tmp_path):
    path = tmp_path / "quiet.txt"
    path.write_text(QUIET)
    return str(path)


def test_the_list_of_a_seed_is_printed_and_nothing_is_done():
    done = campaign("--list", "--seed", "3", "--for", "1m")
    assert done.returncode == 0
    assert done.stdout.splitlines() == [str(action) for action in make_script(3, 60)]


@pytest.mark.parametrize(
    "words",
    [["--for", "soon"], ["--for", "-1s"], ["--replay", "/none/at/all"], ["--seed", "x"], ["--replay", __file__]],
)
def test_what_cannot_be_done_is_a_usage_error_of_one_sentence(words):
    done = campaign(*words)
    assert done.returncode == 2
    assert "tools/campaign: error: " in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.embedded
def test_motion_that_is_not_requested_is_reported_with_how_to_play_it_again(tmp_path, monkeypatch):
    script = tmp_path / "script.txt"
    script.write_text("1 recover\n")
    words = [*TOOL, "--replay", str(script), "--for", "5s", "--json"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        reported = process.stderr.readline()
        folder = re.search(r"folder (\S+)", reported)[1]
        monkeypatch.setenv("XDG_RUNTIME_DIR", f"{folder}/run")
        assert any("recover" in line for line in process.stderr)
        turn(time.monotonic() + 2.0)
        out, _ = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
    result = json.loads(out)
    assert process.returncode == 1
    breach = result["breaches"][0]
    assert breach["rule"] == "target"
    assert "node 2 (right_drive): its target velocity is 3.93 rad/s" in breach["text"]
    lines = Path(breach["file"]).read_text().splitlines()
    assert lines[1] == f"# all of it: tools/campaign --replay {script} --for 5s"
    assert any(line.endswith(" 302#00000000E8030000") for line in lines)
    assert os.listdir(f"{folder}/output")


def turn(until):
    """Be a master that nobody asked for."""
    port = open_port("local:campaign", label="foreigner")
    frames = [CanFrame(0x202, struct.pack("<Hb", 0x0F, 3)), CanFrame(0x302, struct.pack("<ii", 0, 1000))]
    while time.monotonic() < until:
        port.send(pack_records(frames))
        time.sleep(0.01)
    port.close()
