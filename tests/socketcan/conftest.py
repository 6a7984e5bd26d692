"""Tests on the CAN of a real kernel: they take interfaces up and down, and run in the guest only."""

import contextlib
import subprocess

import pytest
from support.guest import GUEST, RawListener, ip, scaled_robby
from support.processes import TIMEOUT_S


def pytest_collection_modifyitems(items):
    if GUEST:
        return
    for item in items:
        if item.get_closest_marker("socketcan") is not None:
            how = "tools/socketcan_guest .venv/bin/python -m pytest tests/socketcan"
            item.add_marker(pytest.mark.skip(reason=f"runs in the guest kernel only: {how}"))


@pytest.fixture
def vcan(request):
    """Return a vcan of this test alone, which is up."""
    name = f"vcan{100 + abs(hash(request.node.name)) % 900}"
    ip("link", "add", "dev", name, "type", "vcan")
    ip("link", "set", name, "up")
    yield name
    subprocess.run(["ip", "link", "del", name], capture_output=True)


@pytest.fixture
def robby(tmp_path):
    """Return the folder of a robby with times as this machine needs them."""
    return scaled_robby(tmp_path)


@pytest.fixture
def listen():
    """Return what opens an independent listener: interface, identifiers."""
    with contextlib.ExitStack() as stack:

        def open_listener(interface, *identifiers):
            listener = RawListener(interface, identifiers)
            stack.callback(listener.close)
            return listener

        yield open_listener


@pytest.fixture
def tool():
    """Return what starts one of the can-utils; it is ended with the test."""
    with contextlib.ExitStack() as stack:

        def start(*words):
            process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
            stack.callback(end, process)
            return process

        yield start


def end(process):
    if process.poll() is None:
        process.terminate()
    process.communicate(timeout=TIMEOUT_S)
