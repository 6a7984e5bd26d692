import pytest

from canopen_control.cia402.state import State
from canopen_control.monitor.monitor_content import Tone, age_cell, state_cell


@pytest.mark.parametrize("state", State)
def test_every_state_is_in_the_standards_words_and_has_a_sign_besides_its_colour(state):
    cell = state_cell(state.name)
    assert cell.text == state.name.replace("_", " ")
    assert cell.tone is not Tone.PLAIN
    assert str(cell).startswith(f"{cell.tone.value} ")


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [(None, "✖ never"), (0.0, "0 ms"), (0.0199, "20 ms"), (0.5, "▲ 500 ms, stale"), (1.5, "▲ 1.5 s, stale")],
)
def test_an_age_reports_in_words_that_it_is_stale(seconds, shown):
    assert str(age_cell(seconds, stale=0.25, dead=2.0)) == shown
