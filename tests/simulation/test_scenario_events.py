from pathlib import Path

from canopen_control.simulation.scenario_events import KINDS


def test_every_kind_states_its_target_and_effect():
    assert {kind.target for kind in KINDS.values()} == {"node", "member", "controller", ""}
    assert all(kind.does for kind in KINDS.values())


def test_the_page_lists_every_kind():
    page = (Path(__file__).parents[2] / "docs" / "guide" / "simulation.md").read_text(encoding="utf-8")
    for name, kind in KINDS.items():
        assert f"| `{name}` |" in page
        assert f"| {kind.does} |" in page
