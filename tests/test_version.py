"""The version is defined in one place, and names the running build."""

import importlib.machinery
import importlib.util
import re
import tomllib
from pathlib import Path

import pytest

import canopen_control
from canopen_control import frame
from canopen_control.version import COMPILED, PURE, __version__, build

ROOT = Path(__file__).parents[1]
RELEASE = __version__.partition(".dev")[0]
CHANGELOG = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_package_shows_its_version():
    assert re.fullmatch(r"\d+\.\d+\.\d+\S*", __version__)
    assert canopen_control.__version__ is __version__


def test_the_wheel_takes_it_from_there():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" not in project["project"]
    assert project["project"]["dynamic"] == ["version"]
    assert ROOT / project["tool"]["hatch"]["version"]["path"] == ROOT / "canopen_control" / "version.py"


def test_the_ros_package_has_the_version_without_its_dev_suffix():
    """Package format 3 (REP 149) allows three numbers and nothing else."""
    text = (ROOT / "canopen_control" / "ros" / "share" / "package.xml").read_text(encoding="utf-8")
    assert re.findall(r"<version>(.*)</version>", text) == [RELEASE]


def test_the_changelog_begins_with_this_version():
    """A released version has a date; one in development is `Unreleased`."""
    newest, *older = re.findall(r"^## (.*)$", CHANGELOG, re.MULTILINE)
    date = r"\d{4}-\d{2}-\d{2}"
    assert re.fullmatch(rf"{re.escape(RELEASE)} - {date if __version__ == RELEASE else 'Unreleased'}", newest)
    assert [line for line in older if not re.fullmatch(rf"\d+\.\d+\.\d+ - {date}", line)] == []


def test_a_change_is_one_short_line_below_a_heading_of_keep_a_changelog():
    kinds = re.findall(r"^### (.*)$", CHANGELOG, re.MULTILINE)
    assert set(kinds) <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    changes = CHANGELOG[CHANGELOG.index("\n## ") :].splitlines()
    assert [line for line in changes if len(line) >= 120 or (line and not line.startswith(("## ", "### ", "- ")))] == []


@pytest.mark.parametrize("link", sorted(set(re.findall(r"\]\((docs/[^)#]+)", CHANGELOG))))
def test_the_changelog_links_to_pages_that_exist(link):
    assert (ROOT / link).is_file()


def test_the_build_is_that_of_the_modules_that_are_loaded():
    assert build() == (PURE if frame.__file__.endswith(".py") else COMPILED)


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("frame.py", PURE),
        (f"frame{importlib.machinery.EXTENSION_SUFFIXES[0]}", COMPILED),
        (f"frame{importlib.machinery.EXTENSION_SUFFIXES[-1]}", COMPILED),
    ],
)
def test_an_extension_module_is_a_compiled_build(monkeypatch, file, text):
    spec = importlib.machinery.ModuleSpec(
        "canopen_control.frame", None, origin=f"/site-packages/canopen_control/{file}"
    )
    monkeypatch.setattr(importlib.util, "find_spec", {"canopen_control.frame": spec}.get)
    assert build() == text
