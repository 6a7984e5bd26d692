from __future__ import annotations

import pytest

from canopen_control.errors import RobotConfigError
from canopen_control.urdf.document import read_document


def test_elements_have_their_place_text_and_parameters():
    root = read_document("<a>\n <b name='x'>\n  hello \n <param name='p'> 1 </param></b></a>", "r.urdf").root
    (b,) = root.children
    assert (b.place, b.text, b.parameters(), root.child("b"), root.child("c")) == ((2, 2), "hello", {"p": "1"}, b, None)


def test_of_several_of_one_name_each_has_its_own_line():
    source = "<robot name='r'>\n<joint name='a'/>\n<joint name='a'/>\n</robot>"
    root = read_document(
        "<robot name='r'><joint name='a'/><joint name='a'/><joint name='a'/></robot>", "f", source
    ).root
    assert [item.place.line for item in root.children] == [2, 3, 3]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("<a>\n<b></a>", r"r\.urdf:2:6: not valid XML: mismatched tag"),
        ("", r"r\.urdf:1:1: not valid XML: no element found"),
        ("<a b='1' b='2'/>", "duplicate attribute"),
        ("<a>\ud800</a>", "not valid XML"),
    ],
)
def test_what_is_not_a_xml_names_the_place(text, expected):
    with pytest.raises(RobotConfigError, match=expected):
        read_document(text, "r.urdf")


def test_errors_are_collected_once_each_in_the_order_of_lines():
    document = read_document("<a>\n<b x='nan' y='1 2 z'/></a>", "r.urdf")
    b = document.root.children[0]
    assert document.number(b, "x", 7.0) == 7.0
    assert document.number(b, "x", 7.0) == 7.0
    assert document.vector(b, "y", (0.0, 0.0, 1.0)) == (0.0, 0.0, 1.0)
    assert document.name(b) == ""
    with pytest.raises(RobotConfigError) as caught:
        document.raise_if_any()
    assert str(caught.value).splitlines() == [
        "r.urdf:2:1: <b> has no name",
        "r.urdf:2:1: x='nan' of <b> is not a number",
        "r.urdf:2:1: y='1 2 z' of <b> is not three numbers",
    ]
