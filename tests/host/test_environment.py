from __future__ import annotations

import json
import subprocess
import sys

import pytest

from canopen_control.host.environment import (
    GATE,
    LIFELINE,
    MODULE,
    READY,
    clean_environment,
    has_ros_libraries,
    lean_python,
)

GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
PREFIX = sys.prefix
WHEELS = [f"{PREFIX}/lib/python3.11/site-packages/ros_{name}.libs" for name in ("rclpy", "rcl_interfaces")]


def clean(ros=False, **variables):
    return clean_environment(ros=ros, base=variables)


def test_what_the_user_has_set_stays():
    assert clean(HOME="/home/me", ROS_DOMAIN_ID="7") == {
        "HOME": "/home/me",
        "ROS_DOMAIN_ID": "7",
        "PYTHONUNBUFFERED": "1",
        GUARD: "1",
    }


def test_a_child_that_needs_ros_may_bootstrap_it_and_another_starts_fast():
    assert GUARD not in clean(ros=True, **{GUARD: "1"})
    assert clean(ros=False)[GUARD] == "1"


def test_the_wheels_paths_do_not_leak():
    leaked = ":".join([WHEELS[0], f"{PREFIX}/lib", WHEELS[1]])
    for ros in (True, False):
        assert "LD_LIBRARY_PATH" not in clean(ros=ros, LD_LIBRARY_PATH=leaked)


def test_the_paths_of_the_user_and_of_a_sourced_ros_stay_in_their_order():
    path = ":".join(["/opt/ros/jazzy/lib", WHEELS[0], f"{PREFIX}/lib/", "/home/me/lib", WHEELS[1] + "/"])
    assert clean(LD_LIBRARY_PATH=path)["LD_LIBRARY_PATH"] == "/opt/ros/jazzy/lib:/home/me/lib"


@pytest.mark.parametrize("path", [f"{PREFIX}/lib", "/usr/lib:/x/ros_things.libs", "/a::/b"])
def test_a_path_without_wheels_is_left_alone(path):
    assert clean(LD_LIBRARY_PATH=path)["LD_LIBRARY_PATH"] == path


def test_the_pipes_of_this_process_are_not_named_to_the_child():
    environment = clean(**{LIFELINE: "5", READY: "6"})
    assert LIFELINE not in environment
    assert READY not in environment


@pytest.mark.process
def test_a_module_is_started_without_the_files_of_the_folder_it_is_started_in(tmp_path):
    (tmp_path / "json.py").write_text("raise ValueError('not the json of Python')")
    started = subprocess.run([*MODULE, "json.tool"], input="[1]", cwd=tmp_path, capture_output=True, text=True)
    assert json.loads(started.stdout) == [1], started.stderr


@pytest.mark.process
def test_a_lean_python_finds_the_package_and_msgspec_and_has_loaded_neither_site_nor_more():
    *python, code = lean_python("canopen_control.rpc.wire")
    reported = "import canopen_control.rpc.wire, json, sys; print(json.dumps([*sys.modules]))"
    done = subprocess.run(
        [*python, code.replace("from canopen_control.rpc.wire import main; sys.exit(main())", reported)],
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = set(json.loads(done.stdout))
    assert {"canopen_control.rpc.wire", "msgspec"} <= loaded
    assert "site" not in loaded


def test_a_fork_keeps_the_paths_with_which_its_libraries_were_loaded():
    path = ":".join([WHEELS[0], f"{PREFIX}/lib"])
    kept = clean_environment(
        ros=True, base={"LD_LIBRARY_PATH": path, GUARD: "1", LIFELINE: "5", GATE: "7"}, forked=True
    )
    assert kept == {"LD_LIBRARY_PATH": path, GUARD: "1", "PYTHONUNBUFFERED": "1"}
    assert "LD_LIBRARY_PATH" not in clean_environment(ros=False, base={"LD_LIBRARY_PATH": path}, forked=True)


@pytest.mark.parametrize(
    ("guard", "path", "result"),
    [
        ("1", f"{PREFIX}/lib", False),
        ("1", "/other/venv/lib/python3.12/site-packages/ros_rclpy.libs", False),
        ("1", f"/mine:{WHEELS[0]}/", True),
        (None, "/opt/ros/jazzy/lib", True),
    ],
)
def test_a_fork_can_import_rclpy_where_this_process_has_its_libraries(monkeypatch, guard, path, result):
    monkeypatch.setenv("LD_LIBRARY_PATH", path)
    monkeypatch.delenv(GUARD, raising=False)
    if guard is not None:
        monkeypatch.setenv(GUARD, guard)
    assert has_ros_libraries() is result
