from __future__ import annotations

from dataclasses import dataclass

import pytest

from canopen_control.errors import RobotConfigError
from canopen_control.yamlnode import INVALID, NOWHERE, Node, convert, setting
from canopen_control.yamltree import parse, read


@dataclass(frozen=True)
class Even:
    value: int = setting(low=0)

    def __post_init__(self) -> None:
        if self.value % 2:
            raise ValueError(f"{self.value} is odd")


@dataclass(frozen=True)
class Bounds:
    rate: float = setting(1.0, low=0.0, nan=True)
    names: tuple[str, ...] = setting((), choices=("a", "b"))
    many: list[int] = setting(factory=list, low=1, high=3)  # noqa: RUF009 - it is a field


def test_what_a_dataclass_refuses_is_a_mistake_in_the_file():
    assert parse("value: 4", Even) == Even(4)
    with pytest.raises(RobotConfigError, match="1:1: 3 is odd"):
        parse("value: 3", Even, error=RobotConfigError)


def test_bounds_and_choices_hold_for_elements_and_nan_may_be_within_them():
    assert parse("rate: .nan\nnames: [a, b]\nmany: [1, 3]", Bounds).many == [1, 3]
    with pytest.raises(RobotConfigError) as caught:
        parse("rate: -1\nnames: [a, c]\nmany: [4]", Bounds, error=RobotConfigError)
    text = str(caught.value)
    assert "rate: -1 is out of range 0.0.." in text
    assert "names[1]: the text 'c' is not one of a, b" in text
    assert "many[0]: 4 is out of range 1..3" in text


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [("3", int | str, 3), ("x", int | str, "x"), ("[1]", list[int] | str, [1]), ("1e2", float | None, 100.0)],
)
def test_a_union_takes_the_member_that_fits_the_value(text, kind, value):
    assert read(text).convert(kind) == value


@pytest.mark.parametrize(("text", "kind"), [("[x]", int | str), ("1.5", int | str), ("true", int), ("1", bool)])
def test_what_fits_no_member_is_invalid_and_reported(text, kind):
    root = read(text)
    assert convert(root, kind) is INVALID
    assert len(root.problems.errors) == 1


def test_a_node_of_the_wrong_kind_gives_nothing_instead_of_raising():
    scalar = read("3")
    assert (scalar.items(), scalar.elements(), scalar.keys(), scalar.get("a")) == ([], [], {}, None)
    assert (NOWHERE.value, NOWHERE.line, NOWHERE.text) == (None, 0, "")
    assert repr(scalar) == "Node(<text>:1:1 )"


def test_a_field_of_node_type_gets_the_node_itself():
    assert isinstance(read("a: 1").convert(Node), Node)
    assert read("a: 1").convert(object) == {"a": 1}
