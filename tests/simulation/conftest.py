import pytest
from support.simulated import Played


@pytest.fixture
def played():
    created = Played()
    yield created
    created.close()
