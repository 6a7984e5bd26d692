from __future__ import annotations

import importlib.machinery
import importlib.metadata
import importlib.util

import pytest

from canopen_control.errors import ConfigError
from canopen_control.ros import available


def pretend(monkeypatch, folder, *, wheels=False):
    """Let rclpy be what is in `folder`; None is nowhere."""
    spec = None
    if folder is not None:
        spec = importlib.machinery.ModuleSpec("rclpy", None, is_package=True)
        spec.submodule_search_locations = [str(folder)]
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: spec)

    class Wheel:
        def locate_file(self, name):
            return folder.parent / name

    def distribution(name):
        if not wheels:
            raise importlib.metadata.PackageNotFoundError(name)
        return Wheel()

    monkeypatch.setattr(importlib.metadata, "distribution", distribution)


@pytest.fixture
def rclpy(tmp_path):
    folder = tmp_path / "rclpy"
    folder.mkdir()
    (folder / f"_rclpy_pybind11{importlib.machinery.EXTENSION_SUFFIXES[0]}").touch()
    return folder


def test_without_rclpy_one_sentence_says_how_to_get_it(monkeypatch):
    pretend(monkeypatch, None)
    with pytest.raises(ConfigError, match=r"no rclpy in this Python; pip install \"canopen-control\[ros\]\""):
        available.require_ros({})


def test_an_rclpy_of_another_python_is_told_by_its_folder(monkeypatch, tmp_path):
    folder = tmp_path / "rclpy"
    folder.mkdir()
    (folder / "_rclpy_pybind11.cpython-27-vax.so").touch()
    pretend(monkeypatch, folder)
    with pytest.raises(ConfigError, match=f"the rclpy in {folder} is made for another Python"):
        available.require_ros({})


@pytest.mark.parametrize("rmw", [None, "", "rmw_fastrtps_cpp"])
def test_the_middleware_of_the_wheels_is_taken(monkeypatch, rclpy, rmw):
    pretend(monkeypatch, rclpy, wheels=True)
    available.require_ros({} if rmw is None else {"RMW_IMPLEMENTATION": rmw})


def test_a_foreign_middleware_is_refused_before_rclpy_ends_the_process(monkeypatch, rclpy):
    pretend(monkeypatch, rclpy, wheels=True)
    with pytest.raises(ConfigError, match=r"RMW_IMPLEMENTATION is rmw_cyclonedds_cpp, .* unset it"):
        available.require_ros({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"})


def test_a_sourced_ros_may_have_any_middleware(monkeypatch, rclpy):
    pretend(monkeypatch, rclpy, wheels=False)
    available.require_ros({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"})
    assert not available.from_wheels()


def test_wheels_beside_a_sourced_ros_do_not_count_when_the_sourced_one_is_found_first(monkeypatch, rclpy, tmp_path):
    pretend(monkeypatch, rclpy, wheels=True)
    assert available.from_wheels()
    monkeypatch.setattr(
        importlib.metadata.distribution("ros-rclpy").__class__,
        "locate_file",
        lambda self, name: tmp_path / "site" / name,
    )
    assert not available.from_wheels()


@pytest.mark.ros
def test_the_installed_rclpy_is_found_without_importing_it():
    import sys

    available.require_ros({})
    assert "rclpy" not in sys.modules
