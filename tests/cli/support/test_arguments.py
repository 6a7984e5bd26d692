import argparse

import pytest

from canopen_control.cli.support.arguments import finite, node_id, seconds, timeout_seconds, whole, whole_number
from canopen_control.cli.support.parsers import parser_of
from canopen_control.cli.verbs import VERBS


@pytest.mark.parametrize(("text", "number"), [("12", 12), ("0x1F", 31), ("-3", -3)])
def test_whole_numbers(text, number):
    assert whole(text) == number


@pytest.mark.parametrize("text", ["0", "128", "-1", "x", "1.5", ""])
def test_what_is_not_a_node_id_is_reported_with_what_is(text):
    with pytest.raises(argparse.ArgumentTypeError) as caught:
        node_id(text)
    assert str(caught.value) == f"{text!r} is not a node-ID: 1 to 127"


@pytest.mark.parametrize("text", ["0", "-1", "61", "soon", "nan", "inf"])
def test_a_timeout_is_above_0_and_at_most_a_minute(text):
    with pytest.raises(argparse.ArgumentTypeError, match="is not a time in seconds above 0 and up to 60"):
        timeout_seconds(text)
    assert timeout_seconds("0.5") == 0.5


@pytest.mark.parametrize("text", ["0", "-1", "soon", "nan", "inf", "1e10"])
def test_a_time_is_finite_and_above_0(text):
    with pytest.raises(argparse.ArgumentTypeError, match="is not a time in seconds above 0"):
        seconds(text)
    assert [seconds(text) for text in ("0.5", "500ms", "2s", "1min", "1e3")] == [0.5, 0.5, 2.0, 60.0, 1000.0]


@pytest.mark.parametrize("text", ["x", "", "0", "11", "0x10", "1.0"])
def test_what_is_not_a_whole_number_within_its_bounds_is_reported_with_what_is(text):
    read = whole_number("tooth: 1 to 10", range(1, 11))
    with pytest.raises(argparse.ArgumentTypeError) as caught:
        read(text)
    assert str(caught.value) == f"{text!r} is not a tooth: 1 to 10"
    assert (read("10"), read("0xA")) == (10, 10)


@pytest.mark.parametrize("text", ["nan", "inf", "-inf"])
def test_a_command_is_finite(text):
    with pytest.raises(argparse.ArgumentTypeError, match="not a value that a drive could reach"):
        finite(text)
    with pytest.raises(argparse.ArgumentTypeError, match="'x' is not a number"):
        finite("x")


def own_types(parser):
    """Yield every function of ours that reads an argument."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for choice in action.choices.values():
                yield from own_types(choice)
        elif action.type not in (None, int, float, str):
            yield action.type


@pytest.mark.parametrize("verb", VERBS)
def test_no_argument_is_refused_with_the_name_of_a_function(verb):
    """A ValueError would become "invalid _number value: 'zz'"."""
    assert "" not in [refusal_of(read, "zz") for read in own_types(parser_of(verb))]


def refusal_of(read, text):
    try:
        read(text)
    except argparse.ArgumentTypeError as error:
        return str(error)
    return None


RENAMED = {
    "run --duration 5": ("--for", "duration", 5.0),
    "demo --duration 5": ("--for", "duration", 5.0),
    "trace --duration 5": ("--for", "duration", 5.0),
    "record --duration 5": ("--for", "duration", 5.0),
    "report --duration 5": ("--for", "duration", 5.0),
    "trajectory record -o x.yaml --duration 5": ("--for", "duration", 5.0),
    "scope 3:0x6064 --length 5": ("--for", "length", 5.0),
    "bench --seconds 5": ("--for", "seconds", 5.0),
    "run robby --name two": ("--as", "name", "two"),
    "demo robby --name two": ("--as", "name", "two"),
    "simulate robby --name two": ("--as", "name", "two"),
    "preflight robby --name two": ("--as", "name", "two"),
}


@pytest.mark.parametrize("line", RENAMED)
def test_the_former_name_of_an_option_is_understood_and_names_the_new_one(line, capsys):
    new, dest, value = RENAMED[line]
    verb, *words = line.split()
    args = parser_of(verb).parse_args(words)
    assert getattr(args, dest) == value
    error_output = capsys.readouterr().err
    assert error_output.count("\n") == 1
    assert f"{words[-2]} is now called {new};" in error_output
    words[-2] = new
    assert parser_of(verb).parse_args(words) == args
    assert capsys.readouterr().err == ""


def actions_of(parser):
    """Yield a parser, and those of its actions."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for choice in action.choices.values():
                yield from actions_of(choice)


@pytest.mark.parametrize("verb", VERBS)
def test_every_help_has_exit_codes_an_example_and_arguments_in_upper_case(verb):
    for parser in actions_of(parser_of(verb)):
        text = parser.format_help()
        assert "Exit codes" in text, parser.prog
        assert "example: canopen-control" in text or any(
            isinstance(action, argparse._SubParsersAction) for action in parser._actions
        ), parser.prog
        positionals = [item for item in parser._actions if not item.option_strings and item.help != argparse.SUPPRESS]
        names = [str(positional.metavar) for positional in positionals if positional.choices is None]
        assert [name for name in names if not name[0].isupper() and "|" not in name] == [], parser.prog


LISTS = {
    "init r --eds a.eds --node-id 2,3 --joint l,r": ("joint", ["l", "r"]),
    "init r --eds a.eds --node-id 2,3 --joint l --joint r": ("joint", ["l", "r"]),
    "plan robby --node left_drive,right_drive": ("node", ["left_drive", "right_drive"]),
    "trace --node 2,3 --node arm": ("node", ["2", "3", "arm"]),
    "run robby --controller a,b": ("controller", ["a", "b"]),
    "check robby --controller a --controller b": ("controller", ["a", "b"]),
    "simulate robby --controller a,b": ("controller", ["a", "b"]),
    "controller activate a,b c": ("controller", ["a", "b", "c"]),
    "controller switch --activate a,b --deactivate c d": ("activate", ["a", "b"]),
    "run robby": ("controller", []),
    "init r": ("joint", []),
}


@pytest.mark.parametrize("line", LISTS)
def test_names_are_repeated_or_separated_by_commas(line):
    dest, names = LISTS[line]
    verb, *words = line.split()
    parser = parser_of(verb)
    for _ in range(2):  # the default list is not changed
        assert getattr(parser.parse_args(words), dest) == names


@pytest.mark.parametrize("text", ["l,", ",", "l,,r", ""])
def test_an_empty_name_is_refused(text, capsys):
    with pytest.raises(SystemExit) as ended:
        parser_of("init").parse_args(["r", "--joint", text])
    assert ended.value.code == 2
    assert f"{text!r} contains an empty name; write a,b" in capsys.readouterr().err


@pytest.mark.parametrize(
    "line",
    [
        "axis enable left_drive,right_drive",
        "axis home arm --joint a,b",
        "nmt start 2,3",
        "sdo read 2,3 0x6041",
        "backup 2,3 -o a.dcf",
        "fault left_drive,right_drive silent on",
        "quirk 2,3 brake_delay on",
        "teleop --controller a,b",
        "gripper 0.1 --controller a,b",
        "calibrate --controller a,b",
        "trajectory cancel --controller a,b",
    ],
)
def test_where_one_name_counts_a_list_is_refused_with_the_form_that_works(line, capsys):
    verb, *words = line.split()
    with pytest.raises(SystemExit) as ended:
        parser_of(verb).parse_args(words)
    assert ended.value.code == 2
    assert "give one name here, and repeat the command for each of the others" in capsys.readouterr().err
