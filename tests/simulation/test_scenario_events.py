from pathlib import Path

from canopen_control.simulation.scenario_events import KINDS, ScenarioEvent


def test_an_act_in_words_says_when_what_and_how_long():
    act = ScenarioEvent(1_500_000_000, "command", "wheels", values=(1.0, -2.5), for_ns=2_000_000_000)
    assert act.words == "1.500 s: command wheels 1 -2.5 for 2 s"
    assert ScenarioEvent(0, "fault", "3", name="silent").words == "0.000 s: fault 3 silent"


def test_every_kind_says_whom_it_takes_and_what_it_does():
    assert {kind.target for kind in KINDS.values()} == {"node", "member", "controller", ""}
    assert all(kind.does for kind in KINDS.values())


def test_the_page_lists_every_kind():
    page = (Path(__file__).parents[2] / "docs" / "guide" / "simulation.md").read_text(encoding="utf-8")
    for name, kind in KINDS.items():
        assert f"| `{name}` |" in page
        assert f"| {kind.does} |" in page
