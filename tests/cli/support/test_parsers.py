"""Parsers of the verbs: distinction of values and options."""

import argparse
import importlib
import inspect
import json
import sys

import pytest

from canopen_control.cli.main import main
from canopen_control.cli.support.output import painted
from canopen_control.cli.support.parsers import actions_of, parser_of
from canopen_control.cli.verbs import VERBS, WITHOUT_JSON

BENCH = "--can local:x --eds a.eds"
NEGATIVE = {
    f"jog 5 {BENCH} --velocity -20rpm": ("velocity", "-20rpm"),
    f"jog 5 {BENCH} --velocity -.5": ("velocity", "-.5"),
    f"jog 5 {BENCH} --position -90deg --for 2": ("position", "-90deg"),
    f"jog 5 {BENCH} --torque -1e2": ("torque", -100.0),
    f"tune 5 {BENCH} --step -30rpm": ("step", "-30rpm"),
    "scope 3:0x6064 --cursors -0.1,0.25": ("cursors", "-0.1,0.25"),
    "sdo write 3 0x60FF -0x10 --type i32": ("value", "-0x10"),
    "world payload 12 --at -0.1,0,0": ("at", "-0.1,0,0"),
    "world push -30,0,0 --for 0.3": ("value", "-30,0,0"),
    "trajectory play --waypoints -0.4": ("waypoints", "-0.4"),
    "axis home left --method -1": ("method", -1),
}


@pytest.mark.parametrize("line", NEGATIVE)
def test_a_negative_value_with_a_unit_may_follow_its_option(line):
    dest, value = NEGATIVE[line]
    verb, *words = line.split()
    assert getattr(parser_of(verb).parse_args(words), dest) == value


AFTER_OPTIONS = {
    "dump 3 --can local:x 0x1018 0x60*": {"node": "3", "what": ["0x1018", "0x60*"], "can": "local:x"},
    "fault 3 --can local:x silent on": {"what": "3", "name": "silent", "state": "on"},
    "axis mode all --name robby PV": {"node": "all", "mode": "PV"},
    "run robby --for 1 a:=1 --mock b:=2": {"config": "robby", "xacro": ["a:=1", "b:=2"], "mock": True},
    "sdo write 3 0x60FF --type i32 -5": {"object": "0x60FF", "value": "-5"},
    "dump 3": {"what": []},
}


@pytest.mark.parametrize("line", AFTER_OPTIONS)
def test_words_that_may_be_omitted_may_follow_an_option(line):
    verb, *words = line.split()
    parsed = vars(parser_of(verb).parse_args(words))
    assert {name: parsed[name] for name in AFTER_OPTIONS[line]} == AFTER_OPTIONS[line]


@pytest.mark.parametrize("line", ["dump 3 --cn local:x 0x1018", "axis mode all PV CSP", "run robby --fro 1 a:=1"])
def test_words_too_many_and_unknown_options_are_refused(line, capsys):
    verb, *words = line.split()
    with pytest.raises(SystemExit) as caught:
        parser_of(verb).parse_args(words)
    assert caught.value.code == 2
    assert "error: unrecognized arguments" in capsys.readouterr().err


def test_waypoints_may_begin_with_a_negative_position():
    words = ["play", "--waypoints", "-0.4 -0.3; 0 0"]
    assert parser_of("trajectory").parse_args(words).waypoints == "-0.4 -0.3; 0 0"


def own_parsers(parser):
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for choice in action.choices.values():
                yield from own_parsers(choice)


@pytest.mark.parametrize("verb", VERBS)
def test_no_option_resembles_a_negative_number(verb):
    """Otherwise argparse takes every negative number for an option."""
    options = [
        option
        for parser in own_parsers(parser_of(verb))
        for option in parser._option_string_actions
        if parser._negative_number_matcher.match(option)
    ]
    assert options == []


# Every verb that prints a result prints it as JSON with --json; colours are for terminals.


FORWARD, BASE = "robby_forward_controller", "robby_base_controller"
ACTIONS = [(verb, path, action) for verb in VERBS for path, action in actions_of(parser_of(verb), verb)]


@pytest.mark.parametrize(("path", "action"), [(path, action) for _, path, action in ACTIONS])
def test_every_action_has_json_or_is_listed_with_a_reason(path, action):
    has = any("--json" in item.option_strings for item in action._actions)
    assert has is (path not in WITHOUT_JSON)


def test_the_list_names_actions_that_exist_with_their_reasons():
    assert {path for _, path, _ in ACTIONS} >= set(WITHOUT_JSON)
    assert all(WITHOUT_JSON.values())


@pytest.mark.parametrize("verb", sorted({verb for verb, path, _ in ACTIONS if path not in WITHOUT_JSON} - {"bench"}))
def test_a_verb_that_has_json_prints_it(verb):
    source = inspect.getsource(importlib.import_module(f"canopen_control.cli.{verb}"))
    delegated = {"command": "send(", "twist": "send(", "restore": "print_restored(", "clone": "print_restored("}
    delegated |= {"backup": "print_run(", "firmware": "print_run("}
    used = delegated.get(verb, "print_result(" if "print_result(" in source else "args.json")
    assert used in source or verb == "device"


def result(capsys, *words, code=0):
    assert main([*words, "--json"]) == code
    return json.loads(capsys.readouterr().out)


def test_of_verbs_that_change_something(mock_robot, capsys):
    assert result(capsys, "axis", "enable", "all") == {
        "action": "enable",
        "node": "all",
        "joint": None,
        "mode": None,
        "text": "",
    }
    sent = {"controller": FORWARD, "sent": 1, "once": True, "idle": {}}
    assert result(capsys, "command", FORWARD, "1", "1", "--once") == sent
    repeated = result(capsys, "command", FORWARD, "1", "1", "--for", "0.25")
    assert repeated["sent"] in range(2, 5)
    assert result(capsys, "controller", "switch", "--activate", BASE, "--deactivate", FORWARD) == [
        {"name": FORWARD, "state": "inactive"},
        {"name": BASE, "state": "active"},
    ]
    assert result(capsys, "twist", BASE, "0.1", "0", "--once")["controller"] == BASE
    assert result(capsys, "controller", "unload", FORWARD) == [{"name": FORWARD, "state": "unloaded"}]
    stopped = {"robot": "mock", "stopped": True, "latched": False, "disabled": False}
    assert result(capsys, "stop") == stopped
    assert result(capsys, "stop", "--latch") == {**stopped, "latched": True}
    assert result(capsys, "stop", "--release") == {**stopped, "stopped": False}
    assert result(capsys, "shutdown") == {"robot": "mock", "ended": True}


def test_of_files_that_are_written(private_folders, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    created = result(capsys, "init", "table", "--eds", "TMCM-1270.eds", "--node-id", "5", "--joint", "table_joint")
    assert created["nodes"] == [{"node_id": 5, "name": "table_drive"}]
    assert created["joints"] == ["table_joint"]
    assert "bus.yml" in created["files"]
    assert result(capsys, "export", "dbc", "robby", "-o", "robby.dbc") == {"file": "robby.dbc", "nodes": 2, "PDOs": 8}
    assert main(["export", "dbc", "robby", "--json"]) == 2
    assert "give -o FILE" in capsys.readouterr().err


TABLE = ["running, cycle 3", "left (2)  OPERATION ENABLED", "right (3)  FAULT", "bus.yml:3: error: no", "plain"]


def test_lines_have_colours_on_a_terminal_only(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert painted(TABLE) == TABLE
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    green, red = "\x1b[32m{}\x1b[m", "\x1b[31m{}\x1b[m"
    assert painted(TABLE) == [
        f"{green.format('running')}, cycle 3",
        f"left (2)  {green.format('OPERATION ENABLED')}",
        f"right (3)  {red.format('FAULT')}",
        f"bus.yml:3: {red.format('error')}: no",
        "plain",
    ]
    monkeypatch.setenv("NO_COLOR", "1")
    assert painted(TABLE) == TABLE


@pytest.mark.parametrize("verb", [None, *VERBS])
def test_a_man_page_is_made_for_every_verb(verb, capsys):
    assert main(["help", *([] if verb is None else [verb]), "--man"]) == 0
    page = capsys.readouterr().out
    name = "canopen\\-control" if verb is None else f"canopen\\-control\\-{verb}"
    assert page.startswith('.TH "')
    assert f".SH NAME\n{name} \\- " in page
    if verb is None:
        assert all(rf"\fBcanopen\-control\-{item}\fR(1)" in page for item in VERBS)
        return
    options = {option for _, action in actions_of(parser_of(verb), verb) for option in action._option_string_actions}
    hidden = {"--duration", "--length", "--seconds", "--name"}  # former names
    hidden |= {"--can"} if verb == "simulate" else set()  # refused
    assert all(option.replace("-", r"\-") in page for option in options - hidden)
    assert all(line.isprintable() and not line.startswith("'") for line in page.splitlines())


def test_an_unknown_verb_has_no_man_page(capsys):
    assert main(["help", "statsu", "--man"]) == 2
    assert "no verb 'statsu'" in capsys.readouterr().err
