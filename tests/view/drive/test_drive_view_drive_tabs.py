import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")


from canopen_control.view.drive.drive_view import TABS


def test_a_tab_can_be_shown_and_left():
    for slot in TABS:
        assert callable(slot.make.show)
        assert callable(slot.make.leave)
