from canopen_control.yamlfile.node import NOWHERE
from canopen_control.yamlfile.reader import read


def test_a_node_of_the_wrong_kind_gives_nothing_instead_of_raising():
    scalar = read("3")
    assert (scalar.items(), scalar.elements(), scalar.keys(), scalar.get("a")) == ([], [], {}, None)
    assert (NOWHERE.value, NOWHERE.line, NOWHERE.text) == (None, 0, "")
    assert repr(scalar) == "Node(<text>:1:1 )"
