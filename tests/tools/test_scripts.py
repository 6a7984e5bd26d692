"""The shell scripts of tools/: --help prints the description and installs nothing."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.mark.parametrize("script", ["demo", "test", "bench", "compile"])
def test_help_reports_what_it_does_and_installs_nothing(tmp_path, script):
    copied = tmp_path / "tools"
    copied.mkdir()
    for name in (script, "environment"):
        shutil.copy(TOOLS / name, copied / name)
    done = subprocess.run([copied / script, "--help"], capture_output=True, text=True, timeout=60, check=True)
    assert len(done.stdout.splitlines()) >= 3
    assert "#" not in done.stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tools"]


@pytest.fixture
def checkout(tmp_path):
    """Return a checkout with blanks in its path whose pip is a stand-in that says what its text is, and fails."""
    root = tmp_path / "a check out"
    (root / "tools").mkdir(parents=True)
    (root / ".venv" / "bin").mkdir(parents=True)
    (root / "pyproject.toml").write_text("")
    for name in ("test", "environment"):
        shutil.copy(TOOLS / name, root / "tools" / name)

    def checkout(words):
        python = root / ".venv" / "bin" / "python"
        python.write_text(f"#!/bin/sh\ncat <<'END'\n{words}\nEND\nexit 1\n")
        python.chmod(0o755)
        return subprocess.run([root / "tools" / "test"], capture_output=True, text=True, timeout=60)

    return checkout


def test_a_package_that_cannot_be_found_is_named_in_one_sentence(checkout):
    done = checkout(
        "WARNING: Retrying after connection broken by 'NewConnectionError'\n"
        "ERROR: Could not find a version that satisfies the requirement msgspec>=0.19 (from canopen-control)\n"
        "ERROR: No matching distribution found for msgspec>=0.19"
    )
    assert done.returncode == 2
    assert done.stderr == ("pip could not find the package msgspec>=0.19; check the network, or set PIP_INDEX_URL\n")


def test_another_failure_of_the_installation_shows_what_pip_reported(checkout):
    done = checkout("ERROR: Disk quota exceeded")
    assert done.returncode == 2
    assert "Disk quota exceeded" in done.stderr
    assert done.stderr.endswith("the installation failed; see the lines above\n")


def test_an_old_python_is_refused_in_a_sentence(tmp_path):
    (tmp_path / "tools").mkdir()
    for name in ("test", "environment"):
        shutil.copy(TOOLS / name, tmp_path / "tools" / name)
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in ("bash", "dirname", "uname", "sed", "cksum"):
        (programs / name).symlink_to(shutil.which(name))
    for name in ("python3", "python3.11", "python3.12", "python3.13"):
        (programs / name).write_text("#!/bin/sh\nexit 1\n")  # as `sys.exit(sys.version_info < (3, 11))` ends there
        (programs / name).chmod(0o755)
    done = subprocess.run(
        [shutil.which("bash"), tmp_path / "tools" / "test"],
        env={"PATH": str(programs)}, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 2
    assert (
        done.stderr == "Python 3.11 or newer is required, but none was found; set CANOPEN_CONTROL_PYTHON to its path.\n"
    )
