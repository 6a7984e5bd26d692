"""Kinds of tests: what a machine lacks is skipped with its reason, unless CANOPEN_CONTROL_REQUIRE says it must run.

CANOPEN_CONTROL_REQUIRE names kinds (`ros,wheel`) or is `all`: then any skip at all is a failure.
"""

import importlib.util
import os
import shutil
import signal
import subprocess
import sys

import pytest

REQUIRED = {word for word in os.environ.get("CANOPEN_CONTROL_REQUIRE", "").replace(" ", "").split(",") if word}


if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Tests that run in the background of a shell inherit this, and so would every program they interrupt.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def missing_ros():
    """Ask another interpreter: the ROS packages change the environment of the one that imports them."""
    environment = {key: value for key, value in os.environ.items() if key != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    probe = [sys.executable, "-c", "import rclpy, std_msgs.msg, sensor_msgs.msg"]
    present = importlib.util.find_spec("rclpy") is not None
    if present and subprocess.run(probe, env=environment, capture_output=True).returncode == 0:
        return None
    return "rclpy is not installed: pip install canopen-control[ros], or source a ROS 2 installation"


def missing_wheel_tools():
    return (
        None
        if importlib.util.find_spec("hatchling")
        else "hatchling is not installed: pip install canopen-control[dev]"
    )


def missing_socketcan():
    return (
        None
        if os.path.exists("/sys/class/net/vcan0")
        else "no vcan0: ip link add vcan0 type vcan; ip link set vcan0 up"
    )


def missing_tmux():
    return None if shutil.which("tmux") else "tmux is not installed: apt install tmux"


def missing_browser():
    for module in ("viser", "playwright"):
        if importlib.util.find_spec(module) is None:
            return f"{module} is not installed: pip install canopen-control[dev]"
    from support.browser import CHROMIUM

    return None if os.access(CHROMIUM, os.X_OK) else f"no {CHROMIUM}: apt-get install chromium, or set CHROMIUM"


MISSING = {
    "ros": missing_ros,
    "wheel": missing_wheel_tools,
    "browser": missing_browser,
    "socketcan": missing_socketcan,
    "tmux": missing_tmux,
}


def pytest_collection_modifyitems(items):
    reasons = {}
    for item in items:
        for kind, missing in MISSING.items():
            if item.get_closest_marker(kind) is None:
                continue
            if kind not in reasons:
                reasons[kind] = missing()
            if reasons[kind] is not None:
                item.add_marker(pytest.mark.skip(reason=reasons[kind]))


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    outcome = yield
    report = outcome.get_result()
    if report.skipped and not hasattr(report, "wasxfail") and must_run(item):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        report.outcome = "failed"
        report.longrepr = f"required by CANOPEN_CONTROL_REQUIRE, but skipped: {reason}"


def must_run(item):
    return "all" in REQUIRED or any(item.get_closest_marker(kind) is not None for kind in REQUIRED)


@pytest.fixture(autouse=True)
def private_folders(tmp_path_factory, monkeypatch):
    """Keep sockets and logs of a test apart from everybody else's; the path is short because sockets need it."""
    folder = tmp_path_factory.mktemp("run")
    folder.chmod(0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "state"))
    return folder
