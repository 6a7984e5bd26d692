"""Robby on a floor in simulated time, as calibrations drive it."""

import pytest
from support.floor import BenchClient, FloorBench

from canopen_control.calibration.base_link import BaseLink


@pytest.fixture
def floor(tmp_path):
    created = []

    def make(name, **wrong):
        bench = FloorBench(tmp_path, name, **wrong)
        created.append(bench)
        bench.start()
        bench.hurry()
        client = BenchClient(bench)
        return bench, client, BaseLink(client)

    yield make
    for item in created:
        item.close()
