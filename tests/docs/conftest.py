"""What the pages of docs show is run as a user runs it."""

import pytest
from support.processes import Stage


@pytest.fixture
def stage(private_folders, tmp_path):
    """Return where processes are started; afterwards all are ended, and none may be left."""
    stage = Stage(private_folders, tmp_path)
    yield stage
    stage.end()
