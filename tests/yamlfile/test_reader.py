from __future__ import annotations

import enum
import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples

from canopen_control.errors import BusConfigError, ConfigError, RobotConfigError
from canopen_control.yamlfile import reader
from canopen_control.yamlfile.convert import convert, position, setting
from canopen_control.yamlfile.node import Node, Problem  # noqa: TC001 - types of fields are looked up at run time
from canopen_control.yamlfile.reader import load, parse, read, read_text, tree

if TYPE_CHECKING:
    from canopen_control.yamlfile.node import Problem, Problems


CONFIG = Path(__file__).parents[2] / "config"


class Mode(enum.Enum):
    POSITION = 1
    VELOCITY = 3


@dataclass(frozen=True)
class Mapping:
    index: int = setting(low=0x1000, high=0xFFFF)
    sub_index: int = setting(0, low=0, high=255)


@dataclass(frozen=True)
class Drive:
    node_id: int = setting(low=1, high=127)
    polling: bool = True
    scale: float = 1.0
    cob_id: int | str = "auto"
    heartbeat_producer: int | None = None
    mapping: list[Mapping] = field(default_factory=list)
    mode: Mode = Mode.VELOCITY
    kind: Literal["auto", 7] = "auto"
    pair: tuple[int, float] = (1, 2.0)
    name: str = setting("", key="device-name")
    rest: Any = None
    here: Node = position()  # noqa: RUF009 - it is a field


@dataclass(frozen=True)
class Bus:
    nodes: dict[str, Drive]
    pdos: dict[int, str] = field(default_factory=dict)
    options: dict[str, object] = field(default_factory=dict)


def messages(text: str, cls: type = Bus, **options: Any) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        parse(text, cls, "bus.yml", **options)
    return [line for line in str(caught.value).splitlines() if line.startswith("bus.yml:")]


def drive(text: str) -> Drive:
    return parse(text, Drive)


def test_a_file_becomes_dataclasses_with_defaults():
    bus = parse("nodes:\n  left: {node_id: 0x3, mapping: [{index: 0x6041}, {index: 0x6060, sub_index: 1}]}\n", Bus)
    assert bus.nodes["left"] == Drive(3, mapping=[Mapping(0x6041), Mapping(0x6060, 1)])
    assert bus.options == {}


def test_numbers_are_taken_as_rcl_takes_them():
    assert drive("{node_id: 1, scale: 3}").scale == 3.0
    assert drive("{node_id: 1, scale: 1e3}").scale == 1000.0
    assert drive("{node_id: 1, scale: -2.5e-1}").scale == -0.25
    assert math.isnan(drive("{node_id: 1, scale: .NAN}").scale)
    assert drive("{node_id: 010}").node_id == 8


@pytest.mark.parametrize(
    ("text", "output"),
    [
        ("010", "010 is a number of base 8 in YAML, and means 8; write it in base 10 or 16"),
        ("1:30", "1:30 is a number of base 60 in YAML, and means 90; write it in base 10 or 16"),
        ("007", ""),
        ("0x10", ""),
    ],
)
def test_a_number_that_yaml_reads_in_another_base_is_reported(text, output):
    results: list[Problem] = []
    parse(f"{{node_id: {text}, scale: {text}}}", Drive, "bus.yml", warnings=results)
    assert [item.message for item in results] == [output] * (2 if output else 0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('"5"', "'5'; remove the quotes"),
        ('"0x1F"', "'0x1F'; remove the quotes"),
        ("\u22125", "'\u22125'; its minus is another character, write -5"),
        ("1,5", "'1,5'; write a decimal point, and no separator between thousands"),
        ("1.000,5", "'1.000,5'; write a decimal point, and no separator between thousands"),
        ("5 ms", "'5 ms'; write the number without a unit, converted to that of this key"),
        ("0.5s", "'0.5s'; write the number without its unit, such as 0.5"),
        ("-5.5rad/s", "'-5.5rad/s'; write the number without its unit, such as -5.5"),
        ("five", "'five'"),
    ],
)
def test_a_text_that_means_a_number_is_refused_with_the_way_to_write_it(text, message):
    assert messages(f"scale: {text}\nnode_id: 1", Drive) == [
        f"bus.yml:1:8: scale: expected a number, got the text {message}"
    ]
    assert messages("node_id: 1e1", Drive)[0].endswith("expected an integer, got the text '1e1'; write 10")
    assert messages("node_id: 10.0", Drive)[0].endswith("expected an integer, got the number 10.0; write 10")
    assert messages("node_id: 5s", Drive)[0].endswith("write the number without a unit, converted to that of this key")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("\tnode_id: 1", "1:1: found character '\\t' that cannot start any token; indent with spaces instead of tabs"),
        ("scale: @x", "that cannot start any token; put a text that begins with this character in quotes"),
        ("scale: *x", "found undefined alias 'x'; put a text that begins with * in quotes"),
        (" scale: 1\nnode_id: 1", "found '<block mapping start>'; indent it like its neighbours"),
        (
            "scale: 1\nnode_id\ncob_id: 1",
            "at line 2); a key ends with a colon and a space; put a text of several lines",
        ),
        ("scale: - 1", "sequence entries are not allowed here; begin a list in a new line"),
        ('scale: "1', "found unexpected end of stream (while scanning a quoted scalar at line 1); close the quotes"),
        ("scale: {a: 1", "separate the entries with commas, and close the bracket"),
    ],
)
def test_an_error_of_the_grammar_names_the_correction(text, message):
    (result,) = messages(text, Drive)
    assert message in result


def test_each_merge_conflict_is_reported_and_nothing_else():
    conflict = "<<<<<<< HEAD\nnode_id: 1\n=======\nnode_id: 2\n>>>>>>> other\n"
    text = "a merge conflict: keep one of the versions, and remove the lines with <, = and >"
    assert messages(f"{conflict}scale: 1\n{conflict}", Drive) == [f"bus.yml:1:1: {text}", f"bus.yml:7:1: {text}"]


def test_every_error_is_reported_at_once_in_the_order_of_the_lines():
    result = messages(
        "nodes:\n"
        "  left: {node_id: 200, hartbeat_producer: 3}\n"
        "  right:\n"
        "    node_id: three\n"
        "    polling: 'false'\n"
        "    mapping: [{index: 1}]\n"
        "    cob_id: 1.5\n"
        "foo: 1\n"
    )
    assert result == [
        "bus.yml:2:19: nodes.left.node_id: 200 is out of range 1..127",
        "bus.yml:2:24: nodes.left.hartbeat_producer: unknown key 'hartbeat_producer' (did you mean "
        "'heartbeat_producer'?)",
        "bus.yml:4:14: nodes.right.node_id: expected an integer, got the text 'three'",
        "bus.yml:5:14: nodes.right.polling: expected true or false, got the text 'false'; remove the quotes",
        "bus.yml:6:23: nodes.right.mapping[0].index: 1 is out of range 4096..65535",
        "bus.yml:7:13: nodes.right.cob_id: expected an integer or text, got the number 1.5",
        "bus.yml:8:1: foo: unknown key 'foo'; known: nodes, pdos, options",
    ]


def test_a_message_shows_the_line_and_a_caret_under_the_place():
    with pytest.raises(BusConfigError) as caught:
        parse("nodes:\n\tleft", Bus, "bus.yml")
    assert caught.value.line == 2
    with pytest.raises(BusConfigError) as caught:
        parse("nodes:\n  left: {node_id: 200}\n", Bus, "bus.yml")
    assert str(caught.value).splitlines()[1:] == ["      left: {node_id: 200}", "                      ^"]
    assert (caught.value.line, caught.value.key) == (2, "nodes.left.node_id")


def test_a_missing_key_is_named_where_its_mapping_stands():
    assert messages("nodes:\n  left:\n    scale: 1.0\n") == ["bus.yml:3:5: nodes.left: missing key 'node_id'"]
    assert messages("") == ["bus.yml:1:1: missing key 'nodes'"]


def test_a_repeated_key_is_an_error_with_both_lines():
    result = messages("nodes:\n  left: {node_id: 1}\n  right: {node_id: 2}\n  left: {node_id: 3}\n")
    assert result == ["bus.yml:4:3: nodes.left: duplicate key 'left' (first at line 2); rename or remove one"]
    assert messages("nodes: {}\npdos: {3: a, 0x3: b}\n") == [
        "bus.yml:2:14: pdos.0x3: duplicate key 3, which was written differently before"
    ]


def test_without_strictness_repeated_and_unknown_keys_are_warnings_and_the_last_one_wins():
    warnings: list[Problem] = []
    value = parse("{node_id: 1, scale: 2, scale: 3, nodeid: 4}", Drive, warnings=warnings, strict=False)
    assert value.scale == 3.0
    assert [warning.message for warning in warnings] == [
        "duplicate key 'scale' (first at line 1); rename or remove one",
        "unknown key 'nodeid' (did you mean 'node_id'?)",
    ]


def test_anchors_and_merge_keys_work_and_own_keys_win():
    bus = parse(
        ".base: &base {node_id: 9, scale: 2.0}\n"
        ".more: &more {polling: false, scale: 5.0}\n"
        "nodes:\n  a: {<<: *base, node_id: 1}\n  b: {<<: [*more, *base], node_id: 2}\n",
        Bus,
        strict=False,
    )
    assert (bus.nodes["a"].node_id, bus.nodes["a"].scale) == (1, 2.0)
    assert (bus.nodes["b"].node_id, bus.nodes["b"].scale, bus.nodes["b"].polling) == (2, 5.0, False)
    assert messages("nodes: {a: {<<: 3, node_id: 1}}") == [
        "bus.yml:1:13: nodes.a.<<: << merges only mappings; give an alias of a mapping, or a list of aliases"
    ]


def test_an_error_behind_an_alias_is_reported_once_for_each_place_it_is_used_in():
    result = messages("nodes:\n  a: &a {node_id: 500}\n  b: *a\n")
    assert result == [
        "bus.yml:2:19: nodes.a.node_id: 500 is out of range 1..127",
        "bus.yml:2:19: nodes.b.node_id: 500 is out of range 1..127",
    ]


@pytest.mark.rest
def test_an_alias_inside_its_own_anchor_and_a_file_that_multiplies_itself_are_refused():
    assert "refers to its own anchor" in messages("nodes: &a {x: *a}")[0]
    bomb = "a: &a [x, x, x, x, x, x, x, x, x, x]\n"
    bomb += "".join(
        f"{new}: &{new} [{', '.join([f'*{old}'] * 10)}]\n" for old, new in zip("abcdef", "bcdefg", strict=True)
    )
    assert "aliases expand" in messages(bomb)[0]
    assert "nested too deeply" in messages("[" * 100 + "]" * 100)[0]
    assert "nested too deeply" in messages("[" * 5000 + "]" * 5000)[0]


def test_a_nothing_takes_the_default_or_none_and_is_an_error_where_a_value_is_needed():
    value = drive("{node_id: 1, scale: , heartbeat_producer: null}")
    assert (value.scale, value.heartbeat_producer) == (1.0, None)
    assert parse("nodes:\n", Bus, strict=False).nodes == {}
    assert messages("{node_id: }", Drive) == ["bus.yml:1:10: node_id: expected an integer, got nothing"]


def test_enums_literals_tuples_and_text_report_the_expected_values():
    assert drive("{node_id: 1, mode: position}").mode is Mode.POSITION
    assert drive("{node_id: 1, mode: 3, kind: 7, pair: [2, 3], device-name: on}".replace("on}", "'on'}")).pair == (
        2,
        3.0,
    )
    assert messages(
        "{node_id: 1,\nmode: sped,\nkind: 8,\npair: [1],\ndevice-name: 12,\nscale: [1],\nmapping: {a: 1}}", Drive
    ) == [
        "bus.yml:2:7: mode: no Mode is called 'sped'; known: POSITION, VELOCITY",
        "bus.yml:3:7: kind: expected auto or 7, got the integer 8",
        "bus.yml:4:7: pair: expected a list of 2 values, got a list of 1",
        "bus.yml:5:14: device-name: expected text, got the integer 12; put it in quotes",
        "bus.yml:6:8: scale: expected a number, got a list of 1",
        "bus.yml:7:10: mapping: expected a list, got a mapping",
    ]


def test_a_check_across_fields_joins_the_other_errors_with_its_place():
    def check(bus: Bus, problems: Problems) -> None:
        for node in bus.nodes.values():
            if node.node_id == 5:
                problems.error(node.here, "five is taken")

    assert messages("nodes:\n  a: {node_id: 5}\n", check=check) == ["bus.yml:2:6: nodes.a: five is taken"]


def test_syntax_errors_name_line_and_column():
    assert messages("a: [1,\nb: {")[0].startswith("bus.yml:2:5: ")
    assert messages("a: \x07")[0] == "bus.yml:1:4: the character U+0007 is not allowed"
    assert messages('a: "\\UFFFFFFFF"')


def test_a_tree_is_read_freely_and_lies_over_another():
    root = read("a: {b: [1, two], c: {d: 0x10}}\nz: {c: {e: 5, d: 1}, k: 3}\n")
    a, z = root.get("a"), root.get("z")
    assert a is not None
    assert z is not None
    assert a.value == {"b": [1, "two"], "c": {"d": 16}}
    assert [key for key, _ in a.items()] == ["b", "c"]
    assert a.get("nothing") is None
    assert a.merged_over(z).value == {"c": {"e": 5, "d": 16}, "k": 3, "b": [1, "two"]}
    both = a.merged_over(z).get("c")
    assert both is not None
    assert (both.line, both.where) == (1, "a.c")
    assert convert(a, int, 7) == 7
    with pytest.raises(BusConfigError, match="1:4: a: expected an integer, got a mapping"):
        root.problems.raise_if_any()


def test_files_are_read_as_utf8_and_what_cannot_be_read_is_the_callers_error(tmp_path):
    file = tmp_path / "drive.yml"
    file.write_bytes(b"\xef\xbb\xbfnode_id: 4\r\nscale: 2\r\n")
    assert load(file, Drive) == Drive(4, scale=2.0)
    assert tree(file).get("scale").line == 2
    file.write_bytes(b"node_id: 4\nscale: \xff\n")
    with pytest.raises(RobotConfigError, match=r"drive.yml:2:1: byte 0xFF is not UTF-8"):
        load(file, Drive, error=RobotConfigError)
    with pytest.raises(RobotConfigError, match=r"none.yml: cannot be read: No such file"):
        load(tmp_path / "none.yml", Drive, error=RobotConfigError)


YAML = st.text(alphabet=st.sampled_from(list("abn:-[]{}&*!|>'\"#%@`,?\n\t 01.~<=\\x\r\ufeffé\x00\ud800")), max_size=80)
LINES = st.lists(
    st.sampled_from(
        [
            "nodes:",
            "  a: &x",
            "    node_id: 1",
            "    node_id: x",
            "  b: *x",
            "  <<: *x",
            "- 1",
            "? [a]",
            "  mapping: [{}]",
        ]
    ),
    max_size=12,
).map("\n".join)


@pytest.mark.rest
@given(st.one_of(YAML, LINES, st.text(max_size=60)))
@settings(max_examples=examples(500))
def test_any_text_whatever_gives_a_value_or_the_asked_for_error(text):
    for cls in (Bus, Drive):
        try:
            parse(text, cls, error=RobotConfigError)
        except RobotConfigError as error:
            assert str(error).startswith("<text>:")  # noqa: PT017 - either outcome is right


PLAIN = st.recursive(
    st.one_of(st.integers(-(10**9), 10**9), st.booleans(), st.none(), st.floats(allow_nan=False), st.text(max_size=8)),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=6), inner, max_size=4)),
    max_leaves=20,
)


@given(PLAIN)
def test_what_yaml_writes_is_read_back(value):
    import yaml

    if not isinstance(value, dict):
        value = {"value": value}
    value = {key: each for key, each in value.items() if isinstance(key, str)}
    root = read(yaml.safe_dump(value), error=RobotConfigError)
    assert root.value == value


@given(st.integers(1, 40), st.integers(0, 30))
def test_an_error_is_reported_at_its_own_line_and_column(line, indent):
    text = "\n" * (line - 1) + f"{{{' ' * indent}node_id: wrong}}"
    assert messages(text, Drive)[0].startswith(f"bus.yml:{line}:{indent + 11}: node_id:")


def shape(node):
    """All that the reader takes from PyYAML's nodes: kind, tag, place and text."""
    if node is None:
        return None
    here = (type(node).__name__, node.tag, node.start_mark.line, node.start_mark.column)
    if isinstance(node, yaml.ScalarNode):
        return (*here, node.value, bool(node.style))
    if isinstance(node, yaml.SequenceNode):
        return (*here, *map(shape, node.value))
    return (*here, *((shape(key), shape(value)) for key, value in node.value))


WORDS = (
    "a", "- ", ": ", "\n", "\n  ", "#", " # ", "'", '"', "{", "}", "[", "]", ",", "|\n", ">-\n", "? ", "?", "! ", "~",
    "1", "!!int ", "---\n", "%YAML 1.1\n", "<<: ", "\t", "\r", "\u2028", "\x85", "\u00e9", "\\x41", ":",
)  # fmt: skip


@settings(max_examples=examples(300))
@given(st.lists(st.sampled_from(WORDS), max_size=16).map("".join))
def test_both_parsers_give_the_same_tree_or_the_same_error(text):
    try:
        expected = shape(yaml.compose(text + "\n", Loader=yaml.SafeLoader))
    except yaml.YAMLError as error:
        with pytest.raises(type(error), match=re.escape(str(error))):
            reader._root(text + "\n")
    else:
        assert shape(reader._root(text + "\n")) == expected


def test_all_files_of_the_bundled_robots_are_read_by_the_fast_parser(monkeypatch):
    if not yaml.__with_libyaml__:
        assert reader._FAST_LOADER is None
        return
    monkeypatch.setattr(yaml, "SafeLoader", None)
    files = [path for path in CONFIG.rglob("*.y*ml") if path.is_file()]
    assert len(files) > 10
    for path in files:
        assert shape(reader._root(path.read_text(encoding="utf-8"))) is not None, path


def test_a_file_of_absurd_size_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "bus.yml"
    with path.open("wb") as file:
        file.truncate(9_000_000_000)
    with pytest.raises(BusConfigError, match=r"cannot be read: it has 9000\.0 MB, more than the limit of 8 MB"):
        read_text(path)
    with pytest.raises(BusConfigError, match="it is not a regular file"):
        read_text("/dev/zero")
