"""The campaign's script: the same seed gives the same list, and a list that was written can be read."""

import itertools
from pathlib import Path

import pytest
from campaigner.script import FAULTS, HARMLESS, KINDS, TOP_SPEED, Action, make_script, read_script

from canopen_control.virtual.fault_table import FAULTS as TABLE

ROOT = Path(__file__).parents[2]


def test_the_same_seed_gives_the_same_actions_and_another_one_others():
    assert make_script(1, 120) == make_script(1, 120)
    assert make_script(1, 120) != make_script(2, 120)


def test_a_longer_campaign_begins_as_the_shorter_one_does():
    short, long = make_script(7, 60), make_script(7, 600)
    assert long[: len(short)] == short
    assert all(action.at < 60 for action in short)


def test_half_an_hour_does_everything_there_is():
    actions = make_script(3, 3600)
    assert {action.kind for action in actions} == KINDS
    assert [action.at for action in actions] == sorted(action.at for action in actions)
    assert {action.params["who"] for action in actions if action.kind == "kill"} == {
        "runtime", "drive", "recorder", "hub", "bridge",
    }  # fmt: skip
    assert {action.params["name"] for action in actions if action.kind == "fault"} <= {*FAULTS, *HARMLESS}


def test_for_minutes_the_runtime_is_spared_so_that_its_memory_shows():
    ends = {("kill", "runtime"), ("kill", "hub"), ("restart", "")}
    ended = [each.at for each in make_script(3, 3600) if (each.kind, each.params.get("who", "")) in ends]
    gaps = [after - before for before, after in itertools.pairwise(ended)]
    assert sum(gap > 300 for gap in gaps) >= 5
    assert sum(gap < 60 for gap in gaps) >= 6


def test_every_fault_of_the_script_is_one_of_the_drives():
    assert {*FAULTS, *HARMLESS} <= set(TABLE)
    assert not set(FAULTS) & set(HARMLESS)


def test_no_command_is_faster_than_the_observer_reckons_with():
    speeds = [abs(each.number(side)) for each in make_script(5, 3600) for side in ("left", "right")]
    assert 0 < max(speeds) <= TOP_SPEED


def test_what_is_written_is_read():
    actions = make_script(11, 600)
    assert read_script(["# seed 11", "", *map(str, actions)]) == actions


@pytest.mark.parametrize("line", ["stop", "soon stop", "1.0", "1.0 stop latch", "1.0 fly", "1.0 stop 'latch=no"])
def test_what_is_no_action_is_refused_by_its_line(line):
    with pytest.raises(ValueError, match=r"is not an action|there is no"):
        read_script([line])


def test_a_list_by_hand_is_played_in_the_order_of_time():
    assert read_script(["2 stop latch=no", "1 enable"]) == [Action(1.0, "enable"), Action(2.0, "stop", {"latch": "no"})]


def test_the_campaign_of_ci_is_a_list_that_can_be_played():
    actions = read_script((ROOT / "tools" / "campaigner" / "floor.txt").read_text().splitlines())
    assert {"stream", "once", "absurd", "stop", "enable", "fault", "kill", "restart", "hostile", "flood"} <= {
        each.kind for each in actions
    }
    assert "--replay tools/campaigner/floor.txt" in (ROOT / ".ci" / "run").read_text()
