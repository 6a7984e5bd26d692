"""Tests on CAN cards, can0 and can1 wired to each other: those of the emulated machine."""

import contextlib

import pytest
from support.guest import GUEST, RawListener, scaled_robby


def pytest_collection_modifyitems(items):
    if GUEST == "hardware":
        return
    for item in items:
        if item.get_closest_marker("hardware") is not None:
            how = "tools/can_hardware_guest .venv/bin/python -m pytest tests/hardware_can"
            item.add_marker(pytest.mark.skip(reason=f"runs in the emulated machine only: {how}"))


@pytest.fixture
def robby(tmp_path):
    """Return the folder of a robot with times as this machine needs them."""
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
