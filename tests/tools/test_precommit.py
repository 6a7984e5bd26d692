"""The hooks before a commit: their programs exist, and are those of tools/test."""

import importlib.util
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
CONFIG = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())
HOOKS = [hook for repo in CONFIG["repos"] for hook in repo["hooks"]]


def test_all_hooks_are_of_this_checkout():
    assert [repo["repo"] for repo in CONFIG["repos"]] == ["local"]
    assert {"ruff-check", "ruff-format", "mypy", "layers"} == {hook["id"] for hook in HOOKS}


@pytest.mark.parametrize("hook", HOOKS, ids=lambda hook: hook["id"])
def test_a_hook_runs_a_tool_and_files_that_there_are(hook):
    python, dash_m, module, *words = hook["entry"].split()
    assert (python, dash_m, hook["language"]) == (".venv/bin/python", "-m", "system")
    assert importlib.util.find_spec(module) is not None
    for word in words:
        assert not word.startswith("tests/") or (ROOT / word).is_file()
