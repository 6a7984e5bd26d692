import dataclasses
import sys

import pytest
from support.robots import setup_of

from canopen_control.errors import ConfigError
from canopen_control.hardware.plugins import Kind
from canopen_control.hardware.simulation import PHYSICS_PLUGIN
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.plugin_robot import SimulatedRobot
from canopen_control.runtime.simulation_engine import simulation_engine

KINDS = [Kind.SIMULATION]


def setup(simulate=True, plugin=None, **parameters):
    found = dataclasses.replace(setup_of("diffbot_sim", "memory:simulation-engine"), simulate=simulate)
    tag = dataclasses.replace(found.description.hardware[0], parameters=parameters)
    if plugin is not None:
        tag = dataclasses.replace(tag, plugin=plugin)
    return dataclasses.replace(found, description=dataclasses.replace(found.description, hardware=(tag,)))


def test_gazebos_plugin_runs_in_physics_and_tells_what_was_guessed():
    events = []
    engine = simulation_engine(setup(), KINDS, lambda *event: events.append(event))
    assert isinstance(engine, SimulatedRobot)
    assert engine.motor("left_wheel_joint") is not None
    assert {kind for kind, _ in events} == {"physics"}
    assert any("left_wheel_joint, right_wheel_joint" in text for _, text in events)


def test_where_nobody_asks_for_it_simple_motors_stay():
    assert simulation_engine(setup(simulate=False), KINDS, pytest.fail) is None


def test_without_mujoco_gazebos_plugin_has_simple_motors_and_mujocos_is_an_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    events = []
    assert simulation_engine(setup(), KINDS, lambda *event: events.append(event)) is None
    assert events[0][1].startswith("simple motors move diffbot_sim, since there is no physics: physics needs MuJoCo")
    with pytest.raises(ConfigError, match=r"pip install 'canopen-control\[physics\]'"):
        simulation_engine(setup(plugin=PHYSICS_PLUGIN), KINDS, pytest.fail)


def test_a_scene_that_is_not_there_is_told_by_mujocos_plugin():
    with pytest.raises(PhysicsError, match=r"scene\.xml: MuJoCo cannot read it"):
        simulation_engine(setup(plugin=PHYSICS_PLUGIN, mujoco_model="scene.xml"), KINDS, pytest.fail)
