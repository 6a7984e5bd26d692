"""One story for all tests of reports: making it takes a second, reading it nothing."""

import copy

import pytest
from support.flightstory import record


@pytest.fixture(scope="session")
def _recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("story")
    folder.chmod(0o700)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        return {"lost": record(), "calm": record(seconds=1, power_off_after=None)}


@pytest.fixture
def lost_drive(_recorded):
    """Robby, whose left drive loses power after two of four seconds while the wheels turn."""
    return copy.deepcopy(_recorded["lost"])


@pytest.fixture
def calm_run(_recorded):
    """A second of robby in which nothing goes wrong."""
    return copy.deepcopy(_recorded["calm"])
