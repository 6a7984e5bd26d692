import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.mutants import MUTANTS

from canopen_control.runtime.robot_files import find_robot

pytest_plugins = ["pytester"]
EXAMPLES = Path(__file__).parents[2] / "docs" / "examples" / "robot_tests" / "test_robby.py"


def run(pytester, *words):
    """Run pytest in the folder of the test, whose ini file keeps those of folders above out."""
    if not (pytester.path / "tox.ini").exists():
        pytester.makeini("[pytest]\n")
    return pytester.runpytest_inprocess("-p", "canopen_control.testing.fixtures", "-p", "no:cacheprovider", *words)


@pytest.mark.rest
def test_the_tests_of_the_guide_pass(pytester):
    shutil.copy(EXAMPLES, pytester.path)
    pytester.makeini("[pytest]\ncanopen_robot = robby\n")
    run(pytester).assert_outcomes(passed=11)


def test_without_a_robot_it_reports_what_is_missing(pytester):
    pytester.makepyfile("def test_it(robot):\n    pass\n")
    result = run(pytester)
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*needs a robot: set canopen_robot = FOLDER*"])


def test_a_folder_next_to_the_ini_file_is_found(pytester):
    shutil.copytree(find_robot("robby").controllers.parent, pytester.path / "mine")
    pytester.makeini("[pytest]\ncanopen_robot = mine\n")
    pytester.makepyfile("""
def test_it(robot, drives, bus, clock):
    assert robot.simulated.setup.name == "mine"
    assert (drives, bus, clock) == (robot.drives, robot.bus, robot.clock)
""")
    run(pytester).assert_outcomes(passed=1)


@pytest.mark.rest
@pytest.mark.sources
@pytest.mark.parametrize(("mark", "failed"), [("", 1), (", breaches=True", 0)])
def test_a_breach_fails_a_test_unless_it_is_left_to_it(pytester, monkeypatch, mark, failed):
    MUTANTS["reset_chains_into_enable"](monkeypatch)
    pytester.makepyfile(
        f"""
import pytest

@pytest.mark.canopen_robot("robby"{mark})
def test_it(robot, drives):
    drives[3].fault("drive_fault", seconds=0.5)
    robot.run(1.0)
    robot.reset_faults()
    robot.run(1.0)
"""
    )
    result = run(pytester)
    result.assert_outcomes(passed=1, errors=failed)
    assert ("enable_unasked" in result.stdout.str()) is bool(failed)


@pytest.mark.process
def test_a_run_without_a_robot_imports_no_robot():
    code = "import sys, canopen_control.testing.fixtures; print('canopen_control.runtime' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
