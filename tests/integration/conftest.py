"""Fixtures for tests of whole processes, on `local:` buses or on that of a kernel; all processes end with the test."""

import contextlib
import os
from pathlib import Path

import pytest
from support.browser import browser
from support.channel import CHANNEL
from support.processes import DriveProbe
from support.robotview import RobotView

PICTURES = Path(os.environ.get("CANOPEN_CONTROL_ARTEFACTS") or Path(__file__).parents[2] / "build" / "pictures")


def pytest_collection_modifyitems(config, items):
    if not CHANNEL:
        return
    left = [item for item in items if item.get_closest_marker("embedded") is not None]
    config.hook.pytest_deselected(items=left)
    items[:] = [item for item in items if item not in left]


@pytest.fixture
def probe():
    """Return what opens the control socket of a drive: bus name, node-ID."""
    with contextlib.ExitStack() as stack:

        def open_probe(bus, node_id):
            probe = DriveProbe(bus, node_id)
            stack.callback(probe.close)
            return probe

        yield open_probe


@pytest.fixture(scope="module")
def chromium():
    with browser() as running:
        yield running


@pytest.fixture
def show(stage, chromium):
    """Return what starts robby with its page: name of the robot, options of `run`."""
    shows = []

    def show(name, *options, **how):
        shows.append(RobotView(stage, chromium, name, *options, **how))
        return shows[-1]

    yield show
    for item in shows:
        item.witness.close()
    for context in list(chromium.contexts):
        context.close()


@pytest.fixture
def keep(record_property):
    """Return what takes a picture that is kept: page, name."""

    def keep(page, name):
        path = page.picture(PICTURES / f"{name}.png")
        record_property("picture", str(path))
        print(f"picture: {path}")

    return keep
