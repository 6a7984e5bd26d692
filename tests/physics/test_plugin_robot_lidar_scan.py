"""Rays of a lidar in a scene: a wall 3 m ahead, a box to the left, nothing behind."""

import math

import mujoco
import pytest

from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.plugin_robot import LidarScanner, LidarSettings

SCENE = """<mujoco><worldbody>
  <geom name="wall" type="box" size="0.1 5 5" pos="3.1 0 0"/><geom type="box" size="0.5 0.5 5" pos="0 2.5 0"/>
  <body name="base"><freejoint/><geom type="sphere" size="0.2" mass="1"/><site name="laser" pos="0.5 0 0"/></body>
</worldbody></mujoco>"""


def scanner(frame="base", turned=0.0, low=-math.pi / 2, **more):
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    data.qpos[3:7] = [math.cos(turned / 2), 0.0, 0.0, math.sin(turned / 2)]
    mujoco.mj_forward(model, data)
    given = {"range_min": 0.1, "range_max": 10.0, "noise": 0.0, "seed": 0} | more
    settings = LidarSettings(
        "lidar", frame, "/scan", low, math.pi, math.pi / 2, rate=10.0, place="robot.urdf:7:5", **given
    )
    return LidarScanner(model, data, settings)


def test_each_ray_tells_how_far_it_reaches_and_minus_one_for_nothing():
    scan = scanner().scan(2.5)
    assert scan.ranges == pytest.approx([-1.0, 3.0, 2.0, -1.0])
    assert (scan.seconds, scan.topic, scan.frame_id, scan.scan_time) == (2.5, "/scan", "base", 0.1)


def test_it_turns_with_its_link_and_a_site_of_a_scene_is_a_frame_too():
    assert scanner(turned=math.pi / 2).scan(0.0).ranges == pytest.approx([3.0, 2.0, -1.0, -1.0])
    assert scanner("laser").scan(0.0).ranges == pytest.approx([-1.0, 2.5, -1.0, -1.0])


def test_what_is_out_of_range_is_not_seen():
    assert scanner(range_min=2.5).scan(0.0).ranges == pytest.approx([-1.0, 3.0, -1.0, -1.0])
    assert scanner(range_max=2.5).scan(0.0).ranges == pytest.approx([-1.0, -1.0, 2.0, -1.0])


def test_noise_is_that_of_a_seed_and_begins_anew():
    lidar = scanner(noise=0.05, seed=1)
    first, second = lidar.scan(0.0).ranges, lidar.scan(0.0).ranges
    assert first[1] != second[1] != 3.0
    assert first[0] == -1.0
    lidar.begin()
    assert lidar.scan(0.0).ranges == first != scanner(noise=0.05, seed=2).scan(0.0).ranges


def test_a_frame_that_is_not_there_is_told():
    with pytest.raises(PhysicsError, match=r"robot\.urdf:7:5: sensor lidar: no link 'bse' for its frame_name, did you"):
        scanner("bse")
