import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from pathlib import Path

from canopen_control.view.drive import drive_tabs
from canopen_control.view.drive.drive_tabs import TABS


def test_every_tab_has_a_key_and_a_file_of_its_own():
    assert len({slot.key for slot in TABS}) == len(TABS)
    files = {path.stem for path in Path(drive_tabs.__file__).parent.glob("*_tab.py")} - {"drive_tab"}
    assert {slot.make.__module__.rpartition(".")[2] for slot in TABS} == files


def test_a_tab_can_be_shown_and_left():
    for slot in TABS:
        assert callable(slot.make.show)
        assert callable(slot.make.leave)
