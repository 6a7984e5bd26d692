import pytest
from support.mockrobot import running


@pytest.fixture
def mock_robot(private_folders):
    with running() as robot:
        yield robot
