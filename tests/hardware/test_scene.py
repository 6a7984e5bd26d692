from canopen_control.hardware.description import parse_description

CYLINDER = '<geometry><cylinder radius="0.1" length="0.02"/></geometry>'
SPHERE = '<geometry><sphere radius="0.2"/></geometry>'


def radii(link: str) -> dict[str, float]:
    return parse_description(f'<robot name="r"><link name="w">{link}</link></robot>').radii


def test_a_link_with_one_round_collision_has_its_radius_else_that_of_its_visual():
    assert radii(f"<collision>{CYLINDER}</collision><visual>{SPHERE}</visual>") == {"w": 0.1}
    assert radii(f"<visual>{SPHERE}</visual>") == {"w": 0.2}


def test_two_round_shapes_or_none_or_nonsense_are_no_radius():
    assert radii(f"<collision>{CYLINDER}</collision><collision>{SPHERE}</collision>") == {}
    assert radii("<collision><geometry><box size='1 1 1'/></geometry></collision><collision/>") == {}
    assert radii('<collision><geometry><sphere radius="big"/></geometry></collision>') == {}


def test_gazebos_plugins_are_known_with_their_lines():
    text = '<robot name="r">\n<gazebo reference="x"/>\n<gazebo>\n<plugin name="a" filename="liba.so"/></gazebo></robot>'
    (plugin,) = parse_description(text).gazebo
    assert (plugin.name, plugin.filename, plugin.line) == ("a", "liba.so", 4)
