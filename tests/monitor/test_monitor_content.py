import pytest

from canopen_control.cia402.state import State
from canopen_control.monitor.monitor_content import Cell, Tone, age_cell, state_cell


@pytest.mark.parametrize("state", State)
def test_every_state_is_in_the_standards_words_and_has_a_sign_besides_its_colour(state):
    cell = state_cell(state.name)
    assert cell.text == state.name.replace("_", " ")
    assert cell.tone is not Tone.PLAIN
    assert str(cell).startswith(f"{cell.tone.value} ")


def test_only_operation_enabled_is_good_and_faults_are_bad():
    tones = {state: state_cell(state.name).tone for state in State}
    assert [state for state, tone in tones.items() if tone is Tone.GOOD] == [State.OPERATION_ENABLED]
    assert [s for s, t in tones.items() if t is Tone.BAD] == [State.FAULT_REACTION_ACTIVE, State.FAULT]


def test_no_state_is_a_dash():
    assert state_cell(None) == Cell("-")


def test_signs_differ():
    assert len({tone.value for tone in Tone}) == len(Tone)


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [(None, "✖ never"), (0.0, "0 ms"), (0.0199, "20 ms"), (0.5, "▲ 500 ms, stale"), (1.5, "▲ 1.5 s, stale")],
)
def test_an_age_says_in_words_that_it_is_stale(seconds, shown):
    assert str(age_cell(seconds, stale=0.25, dead=2.0)) == shown


def test_an_age_says_in_words_that_the_node_is_dead():
    assert age_cell(2.0, stale=0.25, dead=2.0) == Cell("2.0 s, dead", Tone.BAD)
