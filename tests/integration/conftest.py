"""Tests of whole processes, on `local:` buses or on that of a kernel: what starts here ends here."""

import contextlib

import pytest
from support.channel import CHANNEL
from support.processes import DriveProbe, Stage


def pytest_collection_modifyitems(config, items):
    if not CHANNEL:
        return
    left = [item for item in items if item.get_closest_marker("embedded") is not None]
    config.hook.pytest_deselected(items=left)
    items[:] = [item for item in items if item not in left]


@pytest.fixture
def stage(private_folders, tmp_path):
    """Return where processes are started; afterwards all are ended, and none may be left."""
    stage = Stage(private_folders, tmp_path)
    yield stage
    stage.end()


@pytest.fixture
def probe():
    """Return what opens the control socket of a drive: bus name, node id."""
    with contextlib.ExitStack() as stack:

        def open_probe(bus, node_id):
            probe = DriveProbe(bus, node_id)
            stack.callback(probe.close)
            return probe

        yield open_probe
