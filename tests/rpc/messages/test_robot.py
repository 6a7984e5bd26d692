import msgspec
import pytest

from canopen_control.rpc.messages.declare import Effect
from canopen_control.rpc.messages.robot import NODE_METHODS, ROBOT, CommandController, SdoRead, Subscribe
from canopen_control.rpc.wire import convert


def test_its_methods_are_the_robots():
    for name, effect, request in NODE_METHODS:
        assert (ROBOT.of(request).name, ROBOT.of(request).effect) == (name, effect)


@pytest.mark.parametrize("params", [{"index": 0x10000}, {"subindex": 256}, {"timeout": 61}, {"timeout": 0}])
def test_what_is_out_of_range_is_not_a_request_of_nodes(params):
    with pytest.raises(ValueError, match=r"at `\$\."):
        convert({"node": "a", "index": 0x1000} | params, SdoRead)


def test_a_node_may_be_named_by_its_id():
    assert convert({"node": 3, "index": 0x1000}, SdoRead).node == 3


@pytest.mark.parametrize("method", ROBOT.methods.values(), ids=lambda each: each.name)
def test_every_method_reports_what_it_does_and_declares_its_answer(method):
    assert method.text.endswith((".", ").")), method.name
    assert msgspec.inspect.type_info(method.answer)
    assert msgspec.inspect.type_info(method.request).forbid_unknown_fields


def test_what_may_move_is_marked():
    moving = {name for name, method in ROBOT.methods.items() if method.effect is Effect.MOVES}
    trajectories = {"follow_trajectory", "send_trajectory", "set_trajectory", "scale_trajectory"}
    grippers = {"move_gripper", "send_gripper"}
    commands = {"command", "command_by_name", "twist", "set_measured_states"}
    assert moving == {*commands, *trajectories, *grippers, "axis", "nmt", "sdo_write"}
    stopping = {name for name, method in ROBOT.methods.items() if method.effect is Effect.STOPS}
    assert stopping == {"stop", "shutdown", "cancel_trajectory", "cancel_gripper"}


@pytest.mark.parametrize(
    ("kind", "params"),
    [
        (Subscribe, {"state_rate": 0}),
        (Subscribe, {"state_rate": 1001}),
        (CommandController, {"controller": "c", "values": [None]}),
    ],
)
def test_what_is_out_of_range_is_not_a_request(kind, params):
    with pytest.raises(ValueError, match=r"at `\$\."):
        convert(params, kind)
