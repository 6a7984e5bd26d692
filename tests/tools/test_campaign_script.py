"""The campaign's script: the same seed gives the same list, and a list that was written can be read."""

from pathlib import Path

from campaigner.script import FAULTS, HARMLESS, KINDS, make_script, read_script

ROOT = Path(__file__).parents[2]


def test_half_an_hour_does_everything_there_is():
    actions = make_script(3, 3600)
    assert {action.kind for action in actions} == KINDS
    assert [action.at for action in actions] == sorted(action.at for action in actions)
    assert {action.params["who"] for action in actions if action.kind == "kill"} == {
        "runtime", "drive", "recorder", "hub", "bridge",
    }  # fmt: skip
    assert {action.params["name"] for action in actions if action.kind == "fault"} <= {*FAULTS, *HARMLESS}


def test_what_is_written_is_read():
    actions = make_script(11, 600)
    assert read_script(["# seed 11", "", *map(str, actions)]) == actions


def test_the_campaign_of_ci_is_a_list_that_can_be_played():
    actions = read_script((ROOT / "tools" / "campaigner" / "floor.txt").read_text().splitlines())
    assert {"stream", "once", "absurd", "stop", "enable", "fault", "kill", "restart", "hostile", "flood"} <= {
        action.kind for action in actions
    }
    assert "--replay tools/campaigner/floor.txt" in (ROOT / ".ci" / "run").read_text()
