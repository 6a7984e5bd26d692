import pytest

from canopen_control.rpc.quick_verbs import state_name


@pytest.mark.parametrize(
    ("state", "name"), [(None, "-"), ("OPERATION_ENABLED", "OPERATION ENABLED"), ("PRE_OPERATIONAL", "PRE OPERATIONAL")]
)
def test_a_state_is_written_as_in_the_standard(state, name):
    assert state_name(state) == name
