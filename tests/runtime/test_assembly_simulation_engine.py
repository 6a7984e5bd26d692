import dataclasses
import sys

import pytest
from support.robots import setup_of

from canopen_control.errors import ConfigError
from canopen_control.hardware.plugins import Kind
from canopen_control.hardware.simulation import PHYSICS_PLUGIN
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.plugin_robot import SimulatedRobot
from canopen_control.runtime.assembly import simulation_engine

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


def world(tmp_path, text, name="hall.yml"):
    path = tmp_path / name
    path.write_text(text)
    return dataclasses.replace(setup(), world=path)


def test_a_robot_of_a_simulation_plugin_is_held_up_by_what_stands_in_its_world(tmp_path):
    hall = (
        '<sdf version="1.9"><world name="w"><model name="wall"><static>true</static><pose>0.5 0 0.25 0 0 0</pose>'
        '<link name="l"><collision name="c"><geometry><box><size>0.1 2 0.5</size></box></geometry></collision></link>'
        "</model></world></sdf>"
    )
    free = simulation_engine(setup(), KINDS, lambda *_: None)
    held = simulation_engine(world(tmp_path, hall, "hall.sdf"), KINDS, lambda *_: None)
    for engine in (free, held):
        for _ in range(150):
            for wheel in ("left_wheel_joint", "right_wheel_joint"):
                engine.motor(wheel).follow("velocity", 5.0, 0.02)
            engine.step(0.02)
    ways = [float(engine.data.body("base_link").xpos[0]) for engine in (free, held)]
    assert ways[0] > 1.0
    assert 0.1 < ways[1] < 0.45


def test_a_world_that_cannot_be_is_an_error_whatever_the_plugin(tmp_path):
    with pytest.raises(PhysicsError, match="cannot be read"):
        simulation_engine(dataclasses.replace(setup(), world=tmp_path / "none.sdf"), KINDS, pytest.fail)
    with pytest.raises(ConfigError, match="canopen-control run --world"):
        simulation_engine(world(tmp_path, "robots: [{name: a, robot: robby}]\n"), KINDS, pytest.fail)
    with pytest.raises(ConfigError, match=r"hall\.yml:1:9: no drive moves a joint 'x'"):
        simulation_engine(world(tmp_path, "steps: [{at: 1s, block: x}]\n"), KINDS, lambda *_: None)
