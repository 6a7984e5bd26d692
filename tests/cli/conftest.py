import os
import sys

import pytest
from support.mockrobot import running
from support.processes import Stage
from support.terminal import typed


@pytest.fixture
def mock_robot(private_folders, request):
    with running(real_time=request.node.get_closest_marker("process") is not None) as robot:
        yield robot


@pytest.fixture
def stage(private_folders):
    stage = Stage(private_folders, private_folders)
    yield stage
    stage.end()


@pytest.fixture
def terminal(monkeypatch):
    with typed(monkeypatch) as master:
        yield master


@pytest.fixture
def no_terminal(monkeypatch):
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        yield
