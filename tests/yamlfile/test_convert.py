from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import pytest

from canopen_control.errors import RobotConfigError
from canopen_control.yamlfile.convert import INVALID, convert, derived, keys_of, part, setting
from canopen_control.yamlfile.node import Node
from canopen_control.yamlfile.reader import parse, read


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
    many: list[int] = setting(factory=list, low=1, high=3)


@dataclass(frozen=True)
class Switches:
    state: int = setting(5, choices=(2, 5), hint="; 5 is on")
    beat: int = setting(1, off=True)


@dataclass(frozen=True)
class Choice:
    cob_id: int | Literal["auto"] | None = None
    safe: bool | float | Literal["keep"] | None = None


@pytest.mark.parametrize(("text", "value"), [("auto", "auto"), ("0x181", 0x181), ("", None)])
def test_a_number_or_a_word(text, value):
    assert parse(f"cob_id: {text}", Choice).cob_id == value


def test_a_text_that_is_neither_a_number_nor_the_word_is_refused_with_both():
    for text in ("automatic", "[1]", "1.5"):
        with pytest.raises(RobotConfigError, match=r"cob_id: expected an integer or auto or nothing, got "):
            parse(f"cob_id: {text}", Choice, error=RobotConfigError)
    assert [parse(f"safe: {text}", Choice).safe for text in ("keep", "true", "1", "1e3")] == ["keep", True, 1.0, 1000.0]
    with pytest.raises(RobotConfigError, match=r"safe: expected true or false or a number or keep or nothing, got "):
        parse("safe: kept", Choice, error=RobotConfigError)


def test_a_wrong_choice_ends_with_its_hint():
    with pytest.raises(RobotConfigError, match=r"state: the integer 8 is not one of 2, 5; 5 is on"):
        parse("state: 8", Switches, error=RobotConfigError)


@pytest.mark.parametrize(
    ("text", "value", "reported"), [("false", 0, [1, 0]), ("true", INVALID, [0, 1]), ("0", 0, [0, 0])]
)
def test_false_is_zero_where_a_setting_can_be_off(text, value, reported):
    root = read(f"beat: {text}")
    converted = convert(root, Switches)
    assert (converted if value is INVALID else converted.beat) == value
    assert [len(root.problems.warnings), len(root.problems.errors)] == reported


def test_what_a_dataclass_refuses_is_an_error_in_the_file():
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
    assert convert(read(text), kind) == value


@pytest.mark.parametrize(("text", "kind"), [("[x]", int | str), ("1.5", int | str), ("true", int), ("1", bool)])
def test_what_fits_no_member_is_invalid_and_reported(text, kind):
    root = read(text)
    assert convert(root, kind) is INVALID
    assert len(root.problems.errors) == 1


def test_a_field_of_node_type_gets_the_node_itself():
    assert isinstance(convert(read("a: 1"), Node), Node)
    assert convert(read("a: 1"), object) == {"a": 1}


@dataclass(frozen=True)
class Sides:
    left: int = setting(low=0)
    right: int = setting(0, key="other")


@dataclass(frozen=True)
class Box:
    sides: Sides = part()  # noqa: RUF009 - it is a field
    bounds: Bounds = part()  # noqa: RUF009 - it is a field
    name: str = ""
    made_of: str = derived("wood")


def test_the_keys_of_parts_stand_alongside_those_of_the_whole():
    assert keys_of(Box) == ["left", "other", "rate", "names", "many", "name"]
    assert parse("left: 3\nother: 4\nname: b\nrate: 2", Box) == Box(Sides(3, 4), Bounds(rate=2.0), "b")


def test_errors_in_a_part_are_reported_as_those_of_the_whole_and_what_is_derived_is_not_a_key():
    with pytest.raises(RobotConfigError) as caught:
        parse("left: -1\nnam: b\nsides: {left: 1}\nmade_of: stone", Box, error=RobotConfigError)
    message = str(caught.value)
    assert "1:7: left: -1 is out of range" in message
    assert "unknown key 'nam' (did you mean 'name'?)" in message
    assert "unknown key 'sides'" in message
    assert "unknown key 'made_of'" in message
    with pytest.raises(RobotConfigError, match="missing key 'left'"):
        parse("name: b", Box, error=RobotConfigError)


def test_ignored_keys_are_not_error():
    root = read("left: 1\npolling: [x]")
    assert convert(root, Sides, ignored=("polling",)) == Sides(1)
    assert root.problems.errors == []
