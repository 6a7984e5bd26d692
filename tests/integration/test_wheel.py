"""The wheel, installed into a separate environment and run from an empty folder, without the checkout."""

import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = [pytest.mark.wheel, pytest.mark.timeout(900)]


def run(*command, cwd):
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    run(
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "-w",
        str(folder),
        str(ROOT),
        cwd=folder,
    )
    (path,) = folder.glob("*.whl")
    return path


def test_the_wheel_carries_the_eds_files_and_the_robots_and_nothing_of_the_tests(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert "canopen_control/data/eds/TMCM-1270.eds" in names
    assert "canopen_control/data/config/robby/bus.yml" in names
    assert "canopen_control/py.typed" in names
    assert "canopen_control_bench/command.py" in names
    assert not [name for name in names if name.startswith(("tests", "tools")) or name.endswith(".pyc")]


def test_the_installed_wheel_runs_robby_from_an_empty_folder(wheel, tmp_path):
    environment, empty = tmp_path / "env", tmp_path / "empty"
    empty.mkdir()
    venv.create(environment, with_pip=True)
    python = str(environment / "bin" / "python")
    run(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", str(wheel), cwd=empty)
    program = str(environment / "bin" / "canopen-control")
    text = run(program, "run", "robby", "--for", "2", cwd=empty)
    assert "node 3 (left_drive): operational" in text
    assert "robby has stopped, its drives are disabled" in text
    assert "two drives: CPU, lateness" in run(program, "bench", "--help", cwd=empty)
    assert list(empty.iterdir()) == []
    where = run(python, "-c", "import canopen_control; print(canopen_control.__file__)", cwd=empty)
    assert str(ROOT / "canopen_control") not in where
