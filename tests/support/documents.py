"""The documents that users read: README, CONTRIBUTING and the pages of docs, and the examples that they show."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from support.processes import go_first

if TYPE_CHECKING:
    from types import ModuleType

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
EXAMPLES = DOCS / "examples"
README = ROOT / "README.md"
BUILT = ("_build", "generated", "examples")


def pages() -> list[Path]:
    """Return the documents that people write, README first."""
    own = [path for path in sorted(DOCS.rglob("*.md")) if path.relative_to(DOCS).parts[0] not in BUILT]
    return [README, ROOT / "CONTRIBUTING.md", *own]


def code_blocks(path: Path, language: str) -> list[str]:
    """Return the fenced blocks of a language in a page."""
    return re.findall(rf"```{language}\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)


def run_python(*words: object, folder: Path, seconds: float = 60, **environment: str) -> str:
    """Run `python WORDS` as a user does; returns what it prints, and fails if it complains."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    arguments = [sys.executable, *map(str, words)]
    with subprocess.Popen(arguments, cwd=folder, env={**os.environ, **environment}, **pipes) as process:
        go_first(process.pid)
        text, complaint = process.communicate(timeout=seconds)
    assert (process.returncode, complaint) == (0, ""), (text, complaint)
    return text


def install(site: Path, example: str) -> tuple[str, str, str]:
    """Install the package of an example as pip would; returns group, name and target of its entry point."""
    source = EXAMPLES / example
    text = (source / "pyproject.toml").read_text(encoding="utf-8")
    match = re.search(r'entry-points\."(.*?)"\]\n"?([\w/]+)"? = "(.*)"', text)
    assert match is not None
    group, name, target = match.groups()
    module = target.partition(":")[0]
    info = site / f"{module}-1.0.dist-info"
    info.mkdir(parents=True)
    (site / f"{module}.py").write_bytes((source / f"{module}.py").read_bytes())
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{group}]\n{name} = {target}\n")
    return group, name, target


def load(path: Path) -> ModuleType:
    """Import a file that is in no package."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
