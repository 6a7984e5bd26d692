import itertools
import subprocess
import sys
import time
from pathlib import Path

import mujoco
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.physicsbench import MS, ROBBY, pendulum, robby
from support.properties import examples

from canopen_control.errors import ConfigError
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.physics_world import patches_of, shapes_of
from canopen_control.physics.scene_file import Patch
from canopen_control.virtual.shaft import ShaftWorld
from canopen_control.virtual.trajectory import ramp_to

MODEL = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="0 0 1"/>
  <geom name="wall" type="box" size="1 0.025 0.25" pos="2 0 0.25" euler="0 0 90"/>
  <geom name="robot's" type="box" size="1 1 1" contype="2" conaffinity="1"/>
  <geom name="ball" type="sphere" size="1"/>
  <body name="parcel" pos="0 0 5">
    <freejoint/>
    <geom name="parcel" type="box" size="0.1 0.2 0.3" mass="1" contype="3"/>
  </body>
</worldbody></mujoco>
"""


def test_boxes_of_the_world_are_reported_with_where_they_are_now():
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    wall, parcel = shapes_of(model, data)
    assert (wall.name, wall.kind, wall.moves) == ("wall", "box", False)
    assert (wall.size, wall.position) == ((2.0, 0.05, 0.5), (2.0, 0.0, 0.25))
    assert wall.rotation == pytest.approx((0.7071, 0.0, 0.0, 0.7071), abs=1e-3)
    assert (parcel.name, parcel.moves, parcel.size) == ("parcel", True, (0.2, 0.4, 0.6))
    mujoco.mj_step(model, data, 300)
    assert shapes_of(model, data)[1].position[2] < parcel.position[2] == 5.0


def test_another_robot_is_drawn_by_its_shapes_and_a_mesh_of_it_by_its_bounds():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><asset><mesh name="m" vertex="0 0 0  1 0 0  0 2 0  0 0 3"/></asset><worldbody>
        <geom name="mine/a" type="box" size="1 1 1" contype="2"/>
        <geom name="other/a" type="cylinder" size="0.5 1" contype="4"/>
        <geom name="other/b" type="sphere" size="0.5" contype="4"/>
        <geom name="other/c" type="ellipsoid" size="0.1 0.2 0.3" contype="4"/>
        <geom name="other/d" type="mesh" mesh="m" contype="4"/></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert shapes_of(model, data) == ()
    a, b, c, d = shapes_of(model, data, "mine/")
    assert (a.kind, a.size, a.robot) == ("cylinder", (1.0, 1.0, 2.0), "other")
    assert (b.kind, b.size) == ("ellipsoid", (1.0, 1.0, 1.0))
    assert (c.kind, c.size) == ("ellipsoid", (0.2, 0.4, 0.6))
    assert d.kind == "box"
    assert sorted(d.size) == pytest.approx([1.0, 2.0, 3.0], rel=0.3)  # along axes of the mesh's own
    x, y, z = d.position
    assert (0 < x < 1, 0 < y < 2, 0 < z < 3) == (True, True, True)


def test_a_patch_is_flat_and_reports_its_grip():
    (patch,) = patches_of([Patch((1.0, 2.0), (1.0, 3.0), 0.1, 180.0)])
    assert (patch.kind, patch.size[:2], patch.position, patch.grip) == ("patch", (1.0, 3.0), (1.0, 2.0, 0.0), 0.1)
    assert patch.rotation == pytest.approx((0.0, 0.0, 0.0, 1.0))


RADIUS = 0.035


def cruise(now, mover):
    return ramp_to(now, *mover.state(now), 800.0, 9000.0, 9000.0)


def driven(folder, **look):
    """Return robby after a drive with a curve, looked at in some rhythm; each wheel has a timer of its own."""
    axes = robby(folder)
    axes.enable()
    for node, after in ((3, 137_000_001), (2, 301_500_000)):
        mover = axes[node]
        mover.at("turn", axes.now + after, lambda now, mover=mover: mover.run(cruise(now, mover), now))
    for node, speed in ((3, 4.0), (2, 4.0), (3, 1.0), (2, 6.0)):
        axes.cruise(node, speed)
        axes.go(0.2, **look)
    return axes


def test_a_robot_inside_something_solid_is_refused_and_nothing_is_written(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    box = "<geometry><box><size>1e9 1e9 1e9</size></box></geometry>"
    model = f"<model name='m'><static>true</static><link name='l'><collision name='c'>{box}</collision></link></model>"
    (tmp_path / "hall.sdf").write_text(f"<sdf version='1.9'><world name='hall'>{model}</world></sdf>")
    with pytest.raises(ConfigError, match="unstable from the start: a robot starts inside something solid"):
        robby(tmp_path, ROBBY + f"world: {tmp_path / 'hall.sdf'}\n")
    assert len(caplog.records) == 1
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_a_base_drives_as_far_as_its_wheels_turn(tmp_path):
    axes = robby(tmp_path)
    axes.enable()
    for node in (3, 2):
        axes.cruise(node, 0.2 / RADIUS, ramp=10.0)
    axes.go(4.0)
    base = axes.world.describe().base
    turned = axes[2].plant.position / axes[2].plant._scale
    assert turned == pytest.approx(4.0 * 0.2 / RADIUS, rel=0.08)
    assert base.x == pytest.approx(turned * RADIUS, rel=5e-4)
    assert abs(base.y) < 1e-9
    assert base.time_ns == axes.now


def test_counts_go_backwards_where_a_motor_is_mounted_mirrored(tmp_path):
    axes = robby(tmp_path)
    axes.enable()
    axes.cruise(3, 2.0)
    axes.cruise(2, 2.0)
    axes.go(0.5)
    assert axes[3].plant.position < -50 < 50 < axes[2].plant.position


@pytest.fixture(scope="module")
def collected(tmp_path_factory):
    return driven(tmp_path_factory.mktemp("told")).digest()


@settings(max_examples=examples(6), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    every=st.integers(300_000, 200 * MS),
    nodes=st.sampled_from([[(3, 0), (2, 0)], [(2, 0), (3, 0)], [(2, 0)], [(3, 0)]]),
)
def test_the_result_does_not_depend_on_the_rate_of_reading(tmp_path, collected, every, nodes):
    axes = driven(tmp_path, every=every, nodes=nodes)
    axes[2].advance(axes.now)
    assert axes.digest() == collected


@pytest.mark.process
def test_another_process_comes_to_the_same_bits(tmp_path):
    script = (
        "import sys; from pathlib import Path; sys.path[:0] = [sys.argv[2], sys.argv[2] + '/physics']\n"
        "from test_physics_world import driven; print(driven(Path(sys.argv[1])).digest())"
    )
    tests = str(Path(__file__).parents[1])
    done = subprocess.run([sys.executable, "-c", script, tmp_path, tests], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == driven(tmp_path).digest(), done.stderr


def test_it_sleeps_at_rest_and_wakes_with_an_order(tmp_path):
    axes = robby(tmp_path)
    axes.enable()
    axes.cruise(2, 3.0)
    axes.go(0.5)
    axes.cruise(2, 0.0)
    axes.go(3.0)
    assert axes.world.asleep
    assert axes.world.period_ns > 20 * MS
    steps, began = axes.world.steps, time.process_time()
    axes.go(60.0)
    assert axes.world.steps == steps
    assert time.process_time() - began < 0.5  # 60 s of two axes at 50 Hz, also on a busy machine
    axes.cruise(3, 1.0)
    axes.go(0.5)
    assert axes.world.steps > steps
    assert axes[3].plant.position < -50


def test_a_joint_without_power_is_held_by_its_brake_and_falls_without_one(tmp_path):
    held, free = pendulum(tmp_path), pendulum(tmp_path, brake="false")
    held.go(2.0)
    free.go(2.0)
    assert abs(held[5].plant.position) < 100  # a thousandth of a rad
    assert abs(free[5].plant.position) > 50_000


def test_power_off_wakes_a_sleeping_arm_whose_brake_is_none(tmp_path):
    axes = pendulum(tmp_path, brake="false")
    axes.enable()
    axes.go(4.0)
    assert axes.world.asleep
    place = axes[5].plant.position
    axes[5].power(False, axes.now)
    axes.go(0.5)
    assert axes[5].plant.position - place > 20_000


def test_what_a_drive_allows_its_motor_bounds_the_torque(tmp_path):
    axes = pendulum(tmp_path, rated_torque=10.0)
    axes[5].torque_limit = 300.0  # its weight needs 589
    axes.enable()
    axes.go(1.0)
    assert axes[5].plant.torque == pytest.approx(-300.0)
    assert axes[5].owner.errors[-1][1] < -10_000


def test_a_blocked_wheel_builds_up_torque_and_following_error_and_heat_is_judged(tmp_path):
    axes = robby(tmp_path)
    axes.enable()
    for node in (3, 2):
        axes.cruise(node, 3.0)
    axes.go(1.0)
    axes[2].plant.stalled = True
    axes.go(1.0)
    assert axes[2].plant.torque == pytest.approx(2000.0)  # all it has
    assert axes[2].owner.errors[-1][1] > 500
    assert abs(axes[2].plant.velocity) < 20
    times = [now for now, _ in axes[2].owner.loads]
    assert {after - before for before, after in itertools.pairwise(times)} == {10 * MS}


@pytest.mark.parametrize(("name", "value"), [("external", 400.0), ("friction", 900.0)])
def test_what_acts_on_a_joint_from_outside_is_carried_by_its_drive(tmp_path, name, value):
    axes = robby(tmp_path)
    axes.enable()
    for node in (3, 2):
        axes.cruise(node, 3.0)
    axes.go(1.0)
    before = axes[2].plant.torque
    setattr(axes[2].plant, name, value)
    axes.go(1.0)
    assert getattr(axes[2].plant, name) == value
    assert abs(axes[2].plant.torque - before) > 250


def test_with_little_grip_wheels_spin(tmp_path):
    text = ROBBY.replace("axes:", "floor: {{friction: 0.05, caster_friction: 0.0}}\naxes:")
    axes = robby(tmp_path, text)
    axes.enable()
    for node in (3, 2):
        axes.cruise(node, 20.0, ramp=100.0)
    axes.go(1.0)
    wheels = axes[2].plant.position / axes[2].plant._scale * RADIUS
    assert axes.world.describe().base.x < 0.6 * wheels


def test_a_displaced_encoder_moves_no_joint(tmp_path):
    axes = robby(tmp_path)
    axes.enable()
    axes.go(1.0)
    axes[2].displace(100.0, axes.now)
    axes.go(1.0)
    assert axes[2].plant.position == pytest.approx(100.0, abs=1.0)
    assert abs(axes.world.describe().base.x) < 1e-3


# -- world robot


ENCODERS = ROBBY + 'encoders: {{"5": {{joint: left_wheel_joint, gear: 2, reversed: true}}}}\n'


def test_an_encoder_turns_with_the_joint_that_it_sits_on_behind_its_gear(tmp_path):
    axes = robby(tmp_path, ENCODERS)
    assert isinstance(axes.world, ShaftWorld)
    assert axes.world.has_shaft(5)
    assert not axes.world.has_shaft(6)
    axes.enable()
    for node in (3, 2):
        axes.cruise(node, 4.0)
    axes.go(1.0)
    wheel = -axes[3].plant.position / 254.64790894703253
    assert wheel > 1.0
    assert axes.world.shaft_position(5) == pytest.approx(-0.5 * wheel, abs=0.05)
    axes.world.publish()


def test_an_encoder_on_no_joint_is_reported_with_its_line(tmp_path):
    with pytest.raises(
        PhysicsError, match=r"physics\.yml:7:17: an encoder names the unknown joint 'left_weel_joint'.* \(did you mean"
    ):
        robby(tmp_path, ENCODERS.replace("{{joint: left_wheel_joint, gear", "{{joint: left_weel_joint, gear"))
    with pytest.raises(PhysicsError, match="'x' is not a node"):
        robby(tmp_path, ENCODERS.replace('"5"', '"x"'))
