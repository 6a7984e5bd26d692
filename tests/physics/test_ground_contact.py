import mujoco
import pytest

from canopen_control.physics.ground_contact import ContactPart, ground_at_rest

WHEEL = '<body name="{name}" pos="{pos}"><joint name="{name} turns" axis="{axis}"/><geom name="{name}" {shape}/></body>'
CYLINDER = 'type="cylinder" size="0.1 0.02" euler="90 0 0"'


def ground(*bodies):
    inside = "".join(bodies)
    base = f'<body name="base" pos="0 0 0.3"><geom name="box" type="box" size="0.2 0.1 0.05"/>{inside}</body>'
    return ground_at_rest(mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{base}</worldbody></mujoco>"))


def wheel(name="wheel", pos="0 0.2 -0.1", axis="0 1 0", shape=CYLINDER):
    return WHEEL.format(name=name, pos=pos, axis=axis, shape=shape)


def test_a_cylinder_that_turns_about_its_axis_is_a_wheel_and_the_robot_stands_on_it():
    result = ground(wheel())
    assert [(touche.geom, touche.part, touche.joint) for touche in result.touches] == [
        ("wheel", ContactPart.WHEEL, "wheel turns")
    ]
    assert result.touches[0].radius == pytest.approx(0.1)
    assert result.lift == pytest.approx(-0.1)  # the root is drawn so that the wheel floats 10 cm above 0
    assert result.rolls


@pytest.mark.parametrize(
    ("axis", "shape", "part"),
    [
        ("0 0 1", CYLINDER, ContactPart.ROLLER),  # it is steered, and drawn without its axle
        ("0 0 1", 'type="sphere" size="0.1"', ContactPart.CASTER),
        ("0 1 0", 'type="cylinder" size="0.1 0.02" euler="90 0 0" pos="0.05 0 0"', ContactPart.ROLLER),  # off its axis
        ("0 0 1", 'type="cylinder" size="0.1 0.1"', ContactPart.CASTER),  # it stands upright
    ],
)
def test_what_does_not_turn_about_its_own_axis_is_not_a_wheel(axis, shape, part):
    assert [touche.part for touche in ground(wheel(axis=axis, shape=shape)).touches] == [part]


def test_casters_alone_carry_no_robot_that_rolls():
    assert not ground(wheel(axis="0 0 1", shape='type="sphere" size="0.1"')).rolls
