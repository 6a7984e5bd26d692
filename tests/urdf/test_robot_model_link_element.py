from hypothesis import given
from hypothesis import strategies as st

from canopen_control.urdf.robot_model import GREY, read_model

ARM = """<robot name="arm">
<material name="red"><color rgba="1 0 0 0.5"/></material>
<link name="tip"><visual><geometry><mesh filename="package://a/b.stl" scale="2 2 2"/></geometry></visual></link>
<link name="base"><visual><origin xyz="0 0 1" rpy="0 0 1.5707963"/><geometry><box size="1 2 3"/></geometry>
 <material name="red"/></visual><visual><geometry><capsule radius="1" length="2"/></geometry></visual></link>
<link name="slide"><visual><geometry><sphere radius="0.5"/></geometry></visual></link></robot>"""


CYLINDER = '<geometry><cylinder radius="0.1" length="0.02"/></geometry>'
SPHERE = '<geometry><sphere radius="0.2"/></geometry>'


def radius(link: str) -> float | None:
    return read_model(f'<robot name="r"><link name="w">{link}</link></robot>').links["w"].radius


def test_a_link_with_one_round_collision_has_its_radius_else_that_of_its_visual():
    assert radius(f"<collision>{CYLINDER}</collision><visual>{SPHERE}</visual>") == 0.1
    assert radius(f"<visual>{SPHERE}</visual>") == 0.2


def test_shapes_materials_and_origins():
    model = read_model(ARM)
    box = model.links["base"].visuals[0]
    assert (box.size, box.pose.position, box.color, box.opacity) == ((1, 2, 3), (0, 0, 1), (255, 0, 0), 0.5)
    assert model.links["slide"].visuals[0].color == GREY
    mesh = model.links["tip"].visuals[0]
    assert (mesh.shape, mesh.file, mesh.size) == ("mesh", "package://a/b.stl", (2, 2, 2))
    assert model.notes == ("link base: <capsule> is not drawn; use a box, cylinder, sphere or mesh",)


def test_a_shape_without_a_size_is_reported_and_not_made_up():
    model = read_model(
        "<robot><link name='a'><visual><geometry><cylinder radius='1' length='x'/></geometry></visual></link></robot>"
    )
    assert model.links["a"].visuals == ()
    assert model.notes == ("link a: <cylinder> without its size is not drawn; use a box, cylinder, sphere or mesh",)


@given(st.text('robtlinkjxyz="0.1 -', max_size=80))
def test_no_text_in_a_shape_is_an_error_of_the_file(text):
    text = text.replace('"', "")
    shape = f'<visual><origin xyz="{text}"/><geometry><box size="{text}"/></geometry></visual>'
    assert read_model(f'<robot name="x"><link name="a">{shape}</link></robot>').links["a"].radius is None
