import pytest
from support.physicsbench import MS, ROBBY, robby

from canopen_control.physics.physics_file import PhysicsError
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot, SetGrip

IN_A_WORLD = ROBBY.replace("axes:", "world: hall.yml\naxes:")


def in_world(tmp_path, text):
    (tmp_path / "hall.yml").write_text(text)
    return robby(tmp_path, IN_A_WORLD)


def driving(axes, speed=5.0, seconds=1.0, ramp=10.0):
    axes.enable()
    for node in (3, 2):
        axes.cruise(node, speed, ramp)
    axes.go(seconds)
    return axes


def torque(axes):
    return abs(axes[2].plant.torque)


def test_a_payload_on_one_side_leaves_a_sound_inertia_and_comes_off_again(tmp_path):
    axes = robby(tmp_path)
    model, link = axes.world.model, axes.world.model.body("base_link").id
    before = model.body_inertia[link].copy()
    axes.world.act(AddPayload(mass=2.0, position=(0.1, 0.05, 0.1)))
    assert (model.body_inertia[link] > before.min()).all()
    a, b, c = sorted(model.body_inertia[link])
    assert a + b >= c
    axes.world.act(AddPayload(mass=-2.0, position=(0.1, 0.05, 0.1)))
    assert float(model.body_mass[link]) == pytest.approx(3.0)
    assert sorted(model.body_inertia[link]) == pytest.approx(sorted(before), rel=1e-6)


def test_a_push_moves_a_robot_and_ends(tmp_path):
    axes = robby(tmp_path)
    axes.enable()
    axes.go(0.1)
    axes.world.act(PushRobot(force=(0.0, 40.0, 0.0), seconds=0.1))
    axes.go(1.0)
    y = axes.world.describe().base.y
    assert y > 0.005
    axes.go(1.0)
    assert axes.world.describe().base.y == pytest.approx(y, abs=1e-3)
    assert not axes.world.data.xfrc_applied.any()


def test_a_blocked_joint_stands_and_continues(tmp_path):
    axes = driving(robby(tmp_path))
    axes.world.act(BlockJoint(joint="right_wheel_joint"))
    assert axes[2].plant.stalled
    axes.go(0.5)
    place = axes[2].plant.position
    axes.go(0.2)
    assert axes[2].plant.position == pytest.approx(place, abs=3)
    axes.world.act(BlockJoint(joint="right_wheel_joint", on=False))
    axes.go(0.5)
    assert axes[2].plant.position > place + 200


def test_with_less_grip_a_start_slips(tmp_path):
    axes = robby(tmp_path)
    axes.world.act(SetGrip(friction=0.03))
    driving(axes, speed=20.0, seconds=1.0, ramp=100.0)
    assert axes.world.describe().base.x < 0.5 * 0.035 * axes[2].plant.position / axes[2].plant._scale


def test_a_patch_grips_by_where_the_wheels_are(tmp_path):
    axes = in_world(tmp_path, "patches: [{at: [0.6, 0], size: [1, 2], friction: 0.05}]")
    grips = axes.world.model.geom_friction
    wheel = axes.world._robots[""].body.wheels[0]
    assert float(grips[wheel, 0]) == 0.8
    driving(axes, speed=20.0, seconds=1.5)
    assert 0.2 < axes.world.describe().base.x < 1.0
    assert float(grips[wheel, 0]) == 0.05


def test_planned_events_occur_at_their_time_and_wake_a_sleeping_world(tmp_path):
    digests = []
    for every in (20, 137):
        axes = in_world(tmp_path, "steps: [{at: 4s, push: {force: [0, 60, 0], seconds: 0.1}}]")
        axes.enable()
        axes.go(3.9, every=every * MS)
        assert axes.world.asleep
        assert abs(axes.world.describe().base.y) < 1e-6
        axes.go(3.0, every=every * MS)
        assert axes.world.describe().base.y > 0.005
        digests.append(driving(axes, seconds=0.5).digest())
    assert digests[0] == digests[1]


@pytest.mark.rest
def test_a_ramp_is_climbed_and_a_wall_is_not_passed(tmp_path):
    axes = driving(in_world(tmp_path, "ramps: [{at: [0.3, 0], angle: 5, length: 3}]"), speed=8.0, seconds=3.0)
    base = axes.world.describe().base
    assert (base.z > 0.02, base.pitch < -0.05) == (True, True)
    walled = driving(in_world(tmp_path, "walls: [{from: [0.6, -1], to: [0.6, 1]}]"), speed=8.0, seconds=3.0)
    assert walled.world.describe().base.x < 0.6


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ("block: left_weel_joint", "no drive moves a joint 'left_weel_joint' (did you mean 'left_wheel_joint'?)"),
        ("payload: {mass: 1, on: bas_link}", "the robot has no link 'bas_link' (did you mean 'base_link'?)"),
        ("payload: {mass: .inf}", "finite"),
    ],
)
def test_what_is_not_there_is_reported_before_anything_runs(tmp_path, step, words):
    with pytest.raises(PhysicsError) as caught:
        in_world(tmp_path, f"steps:\n- {{at: 0s, friction: 0.5}}\n- {{at: 1s, {step}}}\n- {{at: 2s, {step}}}")
    first, second = str(caught.value).splitlines()
    assert words in first
    assert "hall.yml:3:3: " in first
    assert "hall.yml:4:3: " in second
