"""Fixtures shared by several test modules of the hardware."""

import pytest
from support import makers
from support.servos import start_servos


@pytest.fixture
def servo(tmp_path, request):
    """Return a function that starts two servo drives: its controller, and keys of bus.yml that choose modes."""
    benches = []

    def start(controller, modes="", **how):
        name = f"modes{abs(hash(request.node.nodeid)) % 10**8}"
        benches.append(start_servos(tmp_path, name, controller, modes, **how))
        return benches[-1]

    yield start
    for bench in benches:
        bench.close()


@pytest.fixture
def robot(tmp_path):
    """Return a function that makes a running robot of makers' drives by its modes and more keys of bus.yml."""
    robots = []

    def make(*modes, **options):
        robots.append(makers.robot(tmp_path, *modes, **options))
        return robots[-1]

    yield make
    for item in robots:
        item.close()
