import pytest
from support.mockrobot import running
from support.processes import Stage


@pytest.fixture
def mock_robot(private_folders, request):
    with running(real_time=request.node.get_closest_marker("process") is not None) as robot:
        yield robot


@pytest.fixture
def stage(private_folders):
    stage = Stage(private_folders, private_folders)
    yield stage
    stage.end()
