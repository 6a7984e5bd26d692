import msgspec
import pytest

from canopen_control.rpc.messages.robot import ROBOT
from canopen_control.rpc.messages.simulation import MAX_STEPS, SIMULATION_METHODS, StepSimulation


def test_what_moves_nothing_by_itself_is_asked_of_the_robots_socket():
    assert {name for name, _, _ in SIMULATION_METHODS} <= set(ROBOT.methods)


@pytest.mark.parametrize("steps", [0, -1, MAX_STEPS + 1, 1.5, "2"])
def test_a_number_of_steps_that_is_none_is_refused(steps):
    with pytest.raises(msgspec.ValidationError, match="steps"):
        msgspec.convert({"steps": steps}, StepSimulation)
