from __future__ import annotations

import pytest

pytestmark = pytest.mark.ros
SIMULATION = {"seconds": 1.5, "paused": True, "period": 0.02}
METHODS = {"set_pause": "pause_simulation", "step_simulation": "step_simulation", "reset_world": "reset_simulation"}


@pytest.fixture
def call(fresh, maker):
    fresh.robot.more = {"sim_time": 1.5, "sim_epoch": 1_700_000_000.0}
    fresh.robot.answers.update(dict.fromkeys(METHODS.values(), SIMULATION))

    def call(service, kind, **data):
        of = f"mujoco_ros2_control_msgs/srv/{kind}"
        return maker.order("call", service=service, of=of, data=data)["response"]

    return call


@pytest.mark.parametrize(
    ("service", "kind", "data", "asked"),
    [
        ("set_pause", "SetPause", {"paused": True}, {"paused": True}),
        ("step_simulation", "StepSimulation", {"steps": 7}, {"steps": 7}),
        ("reset_world", "ResetWorld", {"keyframe": "home"}, {"keyframe": "home"}),
    ],
)
def test_the_services_of_mujocos_plugin_ask_the_robot(fresh, call, service, kind, data, asked):
    answer = call(f"/ros2_control_node/{service}", kind, **data)
    assert answer == {"success": True, "message": "paused at 1.5 s; a step is a cycle of 20 ms"}
    assert fresh.robot.commands(METHODS[service])[-1] == asked


def test_what_the_robot_refuses_and_steps_that_are_none_are_told(fresh, call):
    fresh.robot.refusals["step_simulation"] = {"kind": "ControlError", "message": "the simulation is not paused"}
    assert call("/mujoco_ros2_control_node/step_simulation", "StepSimulation", steps=1) == {
        "success": False,
        "message": "the simulation is not paused",
    }
    fresh.robot.refusals.clear()
    answer = call("/mujoco_ros2_control_node/step_simulation", "StepSimulation", steps=0)
    assert answer == {"success": False, "message": "steps is 0; it is a number of cycles from 1 to 1000000"}
    assert fresh.robot.commands("step_simulation")[-1] == {"steps": 1}
