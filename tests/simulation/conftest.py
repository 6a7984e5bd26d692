import pytest
from support.simulated import Played


@pytest.fixture
def played():
    made = Played()
    yield made
    made.close()
