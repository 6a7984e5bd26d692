import ast
import importlib
import subprocess
import sys
from pathlib import Path

import code_mutants
import pytest
from code_mutants import BY_NAME, MUTANTS, Change, mutated

from canopen_control.cli import main as cli

ROOT = Path(__file__).parents[1]
CODE = """
class Thing:
    def verb(self):
        '''Says it.'''
        for each in self.all:
            each.stop(now)  # at once
        return self.value + 1

def other():
    return self.value + 1
"""


def changed(function, old, new):
    return ast.unparse(mutated(Change("x", function, old, new), CODE))


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_each_mutant_still_applies(mutant):
    before = ast.unparse(ast.parse(mutant.change.path.read_text(encoding="utf-8")))
    after = ast.unparse(mutated(mutant.change))
    assert after != before
    compile(after, mutant.name, "exec")


def test_there_are_as_many_as_the_list_has_and_most_are_shown_by_simulations():
    assert len(MUTANTS) == len(BY_NAME) == 33
    assert [mutant.name for mutant in MUTANTS if not mutant.runs] == ["recorder_does_not_count"]
    for mutant in MUTANTS:
        assert mutant.change.subpackage in ("bus", "cia301", "cia402", "controllers", "hardware", "master", "runtime")
        assert mutant.tests.startswith(f"{mutant.change.subpackage}/")
        assert (ROOT / "tests" / f"{mutant.tests}.py").exists()


def test_code_is_replaced_however_it_is_formatted():
    assert "range(3)" in changed("Thing.verb", "for each in (self.all): each.stop( now )", "for each in range(3): pass")
    assert changed("Thing.verb", "self.value+1", "0").count("return 0") == 1
    assert "'''Says it.'''" in changed("Thing.verb", "", "return 1").replace('"""', "'''")


def test_what_was_put_there_is_not_replaced_again():
    assert changed("Thing.verb", "each.stop(now)", "if now:\n    each.stop(now)").count("each.stop(now)") == 1


@pytest.mark.parametrize(
    ("function", "old"), [("Thing.noun", "1"), ("Thing.verb", "self.value + 2"), ("", "self.value + 1")]
)
def test_code_that_is_not_there_once_is_an_error(function, old):
    with pytest.raises(LookupError):
        changed(function, old, "0")


def test_a_module_that_is_there_already_cannot_be_changed():
    importlib.import_module("canopen_control.controllers.update_loop")
    with pytest.raises(RuntimeError, match="imported before"):
        code_mutants.apply(BY_NAME["old_command_counts"])


@pytest.mark.process
def test_a_command_runs_with_the_mutant():
    code = "from code_mutants import *; apply(BY_NAME['limits_in_velocity_modes'])\n"
    code += "from canopen_control.hardware.axis import AxisObjectLimits\n"
    code += "limits = AxisObjectLimits(); limits.velocity = 1.0; print(limits.of_velocity(5))"
    reported = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT / "tools", capture_output=True, text=True, check=True
    )
    assert reported.stdout == "5\n"


@pytest.mark.rest
@pytest.mark.parametrize(
    "command", sorted({run for mutant in MUTANTS for run in mutant.runs if run.startswith("simulate")})
)
def test_what_shows_mutants_breaks_no_rule_without_one(command, monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    assert cli.main(command.split()) == 0, capsys.readouterr().out


@pytest.mark.process
@pytest.mark.rest
@pytest.mark.parametrize(
    "name", ["wide_object_a_byte_off", "first_end_takes_the_second", "goes_on_after_cancel", "stop_forgets_nothing"]
)
def test_rules_about_goals_clients_and_wide_objects_detect_their_mutant(name):
    assert code_mutants.measure([name], tests=False, seeds=True) == 0
