import dataclasses
import re

import pytest
from support.physicsbench import BRAKED, Axes, robby_urdf

from canopen_control.physics.body_model import BASE_JOINT, alone, prepared, read_spec
from canopen_control.physics.engine import make
from canopen_control.physics.physics_file import AxisSettings, FloorContact, PhysicsError
from canopen_control.physics.scene_file import Start, WorldDescription
from canopen_control.physics.urdf_repair import repaired
from canopen_control.urdf.description import parse_description

WHEELS = {side: AxisSettings(f"{side}_wheel_joint", 100.0) for side in ("left", "right")}


def body(urdf, *axes, free=None, floor=None):
    description = parse_description(urdf, "robot.urdf")
    created = repaired(description)
    robot = prepared(
        read_spec(created, "robot.urdf"),
        description,
        {axis.joint: axis for axis in axes},
        floor or FloorContact(),
        step=1e-3,
        density=1000.0,
        free=free,
        path="physics.yml",
        start=Start(),
    )
    return alone(robot, WorldDescription(), 1e-3, "robot.urdf")


def robby(**how):
    return body(robby_urdf(), *WHEELS.values(), **how)


def test_a_robot_on_wheels_has_a_free_root_and_all_its_weight():
    created = robby()
    assert created.model.joint(BASE_JOINT).id == 0
    assert created.base == created.model.body("base_footprint").id
    assert float(created.model.body_subtreemass[0]) == pytest.approx(3.0 + 2 * 0.15 + 0.014, abs=1e-3)


@pytest.mark.parametrize(("urdf", "free"), [(BRAKED, None), (robby_urdf(), False)])
def test_another_is_bolted_to_the_ground(urdf, free):
    axes = [AxisSettings("swing", 1.0)] if urdf == BRAKED else WHEELS.values()
    created = body(urdf, *axes, free=free)
    assert created.base is None
    assert "no wheel carries the robot, so its root is fixed to the ground" in created.notes


def test_wheels_become_ellipsoids_with_the_grip_of_the_floor():
    created = robby(floor=FloorContact(friction=0.3, caster_friction=0.01))
    model = created.model
    kinds = {model.geom(index).name.partition(" shape")[0]: index for index in range(model.ngeom)}
    assert int(model.geom_type[kinds["left_wheel"]]) == 4  # an ellipsoid
    assert model.geom_size[kinds["left_wheel"]].tolist() == [0.035, 0.035, 0.01]
    grips = {name: float(model.geom_friction[index][0]) for name, index in kinds.items()}
    assert (grips["left_wheel"], grips["caster"], grips["floor"]) == (0.3, 0.01, 0.0)


def test_the_motor_of_a_wheel_is_estimated_by_what_it_moves():
    motor = robby().joints["left_wheel_joint"].motor
    share = 3.314 / 2
    assert motor.rated_torque == pytest.approx(0.8 * share * 9.81 * 0.035, rel=0.01)
    assert motor.peak_torque == pytest.approx(2 * motor.rated_torque)
    assert motor.rotor == pytest.approx(motor.rated_torque / 500.0)
    assert motor.inertia == pytest.approx(share * 0.035**2 + 9e-5 + motor.rotor, rel=0.05)
    assert not motor.brake


def test_what_the_file_specifies_of_a_motor_holds():
    axis = AxisSettings(
        "swing",
        1.0,
        10.0,
        rated_torque=7.0,
        peak_torque=9.0,
        rotor_inertia=1e-4,
        friction=0.1,
        damping=0.2,
        inertia=3.0,
    )
    motor = body(BRAKED, dataclasses.replace(axis, brake=False)).joints["swing"].motor
    assert dataclasses.astuple(motor) == (7.0, 9.0, 3.0, pytest.approx(0.01), 0.1, 0.2, False)


def test_the_friction_and_damping_of_a_driven_joint_are_those_of_the_description():
    urdf = BRAKED.replace("</joint>", '<dynamics damping="0.7" friction="0.3"/></joint>', 1)
    assert "dynamics" in urdf
    created = body(urdf, AxisSettings("swing", 1.0))
    place = created.joints["swing"]
    assert (created.model.dof_damping[place.dof], created.model.dof_frictionloss[place.dof]) == (0.7, 0.3)
    assert (place.motor.damping, place.motor.friction) == (0.7, 0.3)
    created = body(urdf, AxisSettings("swing", 1.0, friction=0.1))
    assert (created.model.dof_damping[place.dof], created.model.dof_frictionloss[place.dof]) == (0.7, 0.1)


def test_a_steered_wheel_without_an_axle_rolls():
    wheel = (
        '<link name="base"><inertial><mass value="9"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link><joint name="steer" type="revolute"><parent link="base"/><child link="wheel"/>'
        '<origin xyz="0 0 0.2"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="9" velocity="2"/></joint>'
        '<link name="wheel"><visual><origin rpy="1.57 0 0"/><geometry><cylinder radius="0.2" length="0.1"/></geometry>'
        "</visual></link>"
    )
    created = body(f'<robot name="r">{wheel}</robot>', AxisSettings("steer", 1.0))
    assert "the robot stands on no driven wheels, wheel turning freely" in created.notes
    assert created.model.njnt == 3  # the root, the steering, the axle


def test_what_is_drawn_on_a_wheel_touches_nothing():
    seen_only = re.sub(r"<collision>.*?</collision>", "", robby_urdf(), flags=re.DOTALL)
    model = body(seen_only, *WHEELS.values()).model
    shapes = [index for index in range(model.ngeom) if model.geom(index).name.startswith("left_wheel")]
    assert sorted(int(model.geom_contype[index]) for index in shapes) == [0, 2]


def test_what_mujoco_refuses_is_one_sentence():
    urdf = BRAKED.replace(' ixy="0"', "")
    assert urdf != BRAKED
    with pytest.raises(PhysicsError, match=r"^robot.urdf: MuJoCo cannot .+") as caught:
        body(urdf, AxisSettings("swing", 1.0))
    assert "\n" not in str(caught.value)


# -- mjcf model


SCENE = """<mujoco><worldbody>
  <geom type="plane" size="0 0 0.1"/>
  <body name="cart" pos="0 0 0.2">{free}<geom type="box" size="0.2 0.1 0.05" mass="4"/>
    <body name="arm" pos="0 0 0.1"><joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="1"/></body></body>
</worldbody></mujoco>"""


FIXED = SCENE.format(free="")


def world(tmp_path, scene=FIXED, joint="shoulder", more=""):
    (tmp_path / "scene.xml").write_text(scene)
    path = tmp_path / "plant.yml"
    path.write_text(
        f"engine: mujoco\nmjcf: scene.xml\n{more}axes:\n  '5': {{joint: {joint}, scale_pos_to_dev: 10000}}\n"
    )
    return make(path)


def test_a_drive_holds_and_moves_a_joint_of_a_users_own_scene(tmp_path):
    axes = Axes(world(tmp_path), (5, 0))
    axes.enable()
    axes.cruise(5, -0.5)
    axes.go(1.0)
    assert axes[5].plant.position == pytest.approx(axes[5].demand.at(axes.now)[0], abs=100)
    assert axes[5].plant.position < -3000
    assert axes.world.describe().base is None


def test_a_scene_with_a_free_body_has_a_base(tmp_path):
    base = world(tmp_path, SCENE.format(free="<freejoint/>")).describe().base
    assert base.z == pytest.approx(0.05, abs=0.01)  # it has settled on its box


def test_friction_and_damping_are_the_scenes_unless_the_plant_file_specifies_more(tmp_path):
    scene = FIXED.replace('axis="0 1 0"', 'axis="0 1 0" damping="0.4" frictionloss="0.2"')
    (tmp_path / "scene.xml").write_text(scene)
    path = tmp_path / "plant.yml"
    for more, expected in (("", (0.4, 0.2)), (", friction: 0.05, damping: 0.9", (0.9, 0.05))):
        axis = f"{{joint: shoulder, scale_pos_to_dev: 10000{more}}}"
        path.write_text(f"engine: mujoco\nmjcf: scene.xml\naxes:\n  '5': {axis}\n")
        model = make(path).model
        assert (model.dof_damping[0], model.dof_frictionloss[0]) == expected


@pytest.mark.parametrize(
    ("scene", "joint", "words"),
    [
        (FIXED, "sholder", "plant.yml:4:8: "),
        (FIXED, "sholder", "did you mean 'shoulder'?"),
        ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "shoulder", "has no joint 'shoulder'"),
        ("<mujoco><worldbody><bodi/></worldbody></mujoco>", "shoulder", "scene.xml: MuJoCo cannot read it: "),
        (FIXED.replace(' mass="1"', ' mass="0"'), "shoulder", "scene.xml: MuJoCo cannot simulate it: "),
    ],
)
def test_what_cannot_be_is_one_sentence(tmp_path, scene, joint, words):
    with pytest.raises(PhysicsError) as caught:
        world(tmp_path, scene, joint)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
