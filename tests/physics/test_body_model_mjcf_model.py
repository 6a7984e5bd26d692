import pytest
from support.physicsbench import Axes

from canopen_control.physics.engine import make
from canopen_control.physics.physics_file import PhysicsError

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
