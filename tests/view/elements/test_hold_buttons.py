import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from support.pages import visited

from canopen_control.view.elements.hold_buttons import HoldButton, HoldButtons


def test_a_held_button_says_so_and_a_foreign_word_is_nothing():
    told = []

    async def act(user, _buttons):
        group = user.find(kind=HoldButtons)
        for word in ("go", "other", None, ["go"]):
            group.trigger("hold", word)
        group.trigger("release")

    visited(lambda: HoldButtons([HoldButton("go", "Go")], told.append, lambda: told.append("let go")), act)
    assert told == ["go", "let go"]


def test_a_held_button_speaks_often_enough_for_the_dead_man():
    from canopen_control.view.teleop import LET_GO_NS

    async def act(_user, buttons):
        return buttons.props["period"]

    assert visited(lambda: HoldButtons([], print, print), act) * 1e6 * 3 <= LET_GO_NS
