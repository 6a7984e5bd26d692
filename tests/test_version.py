"""The version stands in one place."""

import re
import tomllib
from pathlib import Path

import canopen_control
from canopen_control.version import __version__

ROOT = Path(__file__).parents[1]


def test_the_package_shows_its_version():
    assert re.fullmatch(r"\d+\.\d+\.\d+\S*", __version__)
    assert canopen_control.__version__ is __version__


def test_the_wheel_takes_it_from_there():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" not in project["project"]
    assert project["project"]["dynamic"] == ["version"]
    assert ROOT / project["tool"]["hatch"]["version"]["path"] == ROOT / "canopen_control" / "version.py"


def test_ros_is_told_the_same():
    text = (ROOT / "canopen_control" / "ros" / "share" / "package.xml").read_text(encoding="utf-8")
    assert re.findall(r"<version>(.*)</version>", text) == [__version__]
