import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")


from canopen_control.view.drive.drive_view import TABS


def test_every_tab_has_a_key_of_its_own():
    assert len({slot.key for slot in TABS}) == len(TABS)


def test_a_tab_can_be_shown_and_left():
    for slot in TABS:
        assert callable(slot.make.show)
        assert callable(slot.make.leave)
