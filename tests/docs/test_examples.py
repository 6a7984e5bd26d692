"""The programs in docs/examples run with the documented output, are short and typed, and use only public names."""

import ast
import importlib
import re
import subprocess
import sys

import pytest
from support.documents import EXAMPLES, README, ROOT, code_blocks, run_python

TMCM = ROOT / "eds" / "TMCM-1270.eds"
#: program -> its arguments, and what it prints, line by line
RUNS = {
    "turn_wheels": (
        [],
        [r"left_wheel_joint: [12]\d\.\d+ rad, (9\.[5-9]|10\.[0-4])\d* rad/s", r"right_wheel_joint: .*"],
    ),
    "objects": (
        [],
        [
            r"device name: TMCM-1270",
            r"vendor id: 646",
            r"profile acceleration: 16000 -> 8000",
            r"refused: .*abort 0x06020000.*",
            r"not asked: .*did you mean 0x6041:00 Statusword.*",
        ],
    ),
    "stop_and_release": (
        [],
        [r"stopped: \[0\.0, 0\.0\]", r"latched: .*STOP is latched.*", r"released: .*axis enable.*", "enabled: running"],
    ),
    "drive_restarts": ([], [r"(cycle_missed: .*\n)*restarted: .*", r"(\w+: .*\n)*ready again: True"]),
    "square": ([], [r"travelled 0\.([78]\d|9[0-2]) m, turned [67]\.\d+ rad, ends 0\.[01]\d m from its start"]),
    "state_stream": ([], [r"running 0\.00 0\.00", *[r"running \d\.\d\d \d\.\d\d"] * 8, r"running (4|5)\.\d\d .*"]),
    "frames": (
        [],
        [*[rf"heartbeats of node {n}: ([5-9]|1\d)" for n in (1, 2, 3)], *[rf"node {n}: .*, enabled" for n in (2, 3)]],
    ),
    "python_can_listener": ([], [r"[0-9A-F]{3}( .*)?"] * 5),
    "canopen_package": ([], ["left_drive is OPERATIONAL"]),
    "two_axes": ([], [r"pan: 0\.50\d rad", r"tilt: -0\.50\d rad"]),
    "eds_issues": (
        [TMCM, 5],
        [
            r".*TMCM-1270: 243 entries",
            r"0x1000:00 Device type: UNSIGNED32, .*",
            *[rf"0x{index}:00 .*" for index in ("6041", "6060", "60FF")],
        ],
    ),
}
#: what is not a program on its own -> where it is run
ELSEWHERE = {
    "attach": "below, with a robot that runs",
    "bare_socket": "below, with a robot that runs",
    "verb_where": "test_verb_howto.py",
    "dance": "test_controller_howto.py",
    "udp_can": "test_adapter_howto.py",
}
#: the modules that programs may import from
PUBLIC = (
    "canopen_control",
    "canopen_control.errors",
    "canopen_control.rpc.messages.robot",
    "canopen_control.rpc.messages.state",
)
#: tests of a robot that stand there as examples run in tests/testing
PROGRAMS = sorted(path for path in EXAMPLES.rglob("*.py") if not path.name.startswith("test_"))


def code_of(path):
    """Return a program without its docstring, as the README shows it."""
    return re.sub(r'\A""".*?"""\n\n', "", path.read_text(encoding="utf-8"), flags=re.DOTALL)


def test_every_program_is_run():
    assert {path.stem for path in PROGRAMS} == {*RUNS, *ELSEWHERE}


@pytest.mark.process
@pytest.mark.parametrize("name", RUNS)
def test_a_program_prints_what_it_reports(stage, name):
    arguments, expected = RUNS[name]
    python = run_python(EXAMPLES / f"{name}.py", *arguments, folder=stage.place)
    assert re.fullmatch("\n".join(f"(?:{item})" for item in expected), python.strip()), python


@pytest.mark.process
def test_a_program_drives_a_robot_that_runs(stage):
    robot = stage.robby("robby", "--no-flight-recorder")
    moved, objects, *events = run_python(EXAMPLES / "attach.py", folder=stage.place).splitlines()
    speed, state = moved.split()
    assert float(speed) > 3.0
    assert state == "OPERATIONAL"
    assert int(objects.split()[0]) & 0x6F == 0x27
    assert "info robby_base_controller is active" in events
    assert "warning stop was commanded" in events
    bare = run_python(EXAMPLES / "bare_socket.py", folder=stage.place)
    assert re.fullmatch(r"protocol \d+\nleft_wheel_joint \d.*\nright_wheel_joint \d.*\n", bare)
    assert robot.running


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.stem)
def test_a_program_is_short_and_imports_only_what_is_public(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 40
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("canopen_control"):
            assert node.module in PUBLIC, node.module
            module = importlib.import_module(node.module)
            public = getattr(module, "__all__", [name for name in vars(module) if not name.startswith("_")])
            assert {alias.name for alias in node.names} <= set(public)


def test_the_readme_shows_programs_of_the_examples():
    shown = code_blocks(README, "python")
    assert len(shown) == 3
    known = {code_of(path) for path in PROGRAMS}
    of_robots = (EXAMPLES / "robot_tests" / "test_robby.py").read_text(encoding="utf-8")
    assert [code for code in shown if code not in known and code not in of_robots] == []


@pytest.mark.process
def test_the_programs_pass_strict_mypy(tmp_path):
    """As they do for a user: the package is typed, and what the examples import is exported."""
    pytest.importorskip("mypy")
    cache = ROOT / ".mypy_cache" / "examples"  # apart from that of the package: the options are others
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", f"--cache-dir={cache}", *map(str, PROGRAMS)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=110,
    )
    assert done.stdout.startswith("Success"), done.stdout + done.stderr
