import pytest

from canopen_control.rpc.messages.robot import NODE_METHODS, ROBOT, SdoRead
from canopen_control.rpc.wire import convert


def test_its_methods_are_the_robots():
    for name, effect, request in NODE_METHODS:
        assert (ROBOT.of(request).name, ROBOT.of(request).effect) == (name, effect)


@pytest.mark.parametrize("params", [{"index": 0x10000}, {"subindex": 256}, {"timeout": 61}, {"timeout": 0}])
def test_what_is_out_of_range_is_no_request(params):
    with pytest.raises(ValueError, match=r"at `\$\."):
        convert({"node": "a", "index": 0x1000} | params, SdoRead)


def test_a_node_may_be_named_by_its_id():
    assert convert({"node": 3, "index": 0x1000}, SdoRead).node == 3
