"""A robot in simulated time that serves its API, and a client of it."""

import pytest
from support.apiclient import Client
from support.robots import Bench

from canopen_control.runtime.api import ApiServer


@pytest.fixture
def robby():
    bench = Bench("api")
    bench.api = ApiServer(bench.robot)
    bench.start()
    yield bench
    bench.api.close()
    bench.close()


@pytest.fixture
def client(robby):
    client = Client(robby)
    yield client
    client.close()
