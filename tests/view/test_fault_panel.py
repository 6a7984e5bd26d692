import pytest

from canopen_control.errors import RemoteError
from canopen_control.view.fault_panel import OFF, ON, FaultPanel


class Desk:
    def __init__(self):
        self.there, self.on, self.gone = ["left", "right"], {"left": set(), "right": set()}, False

    def drives(self):
        return self.there

    def faults(self, drive):
        if self.gone:
            raise RemoteError("BusClosed", "it has died")
        return [
            {"name": name, "does": f"does {name}", "reaction": "stops", "once": False, "on": name in self.on[drive]}
            for name in ("silent", "hot")
        ]

    def switch(self, drive, fault, *, on):
        if self.gone:
            raise RemoteError("BusClosed", "it has died")
        (self.on[drive].add if on else self.on[drive].discard)(fault)
        return sorted(self.on[drive])


@pytest.fixture
def desk():
    return Desk()


@pytest.fixture
def panel(server, desk):
    panel = FaultPanel(server.gui, desk)
    panel.refresh()
    return panel


def test_without_virtual_drives_it_is_not_there(panel, desk):
    assert panel._folder.visible
    desk.there = []
    panel.refresh()
    assert not panel._folder.visible


def test_a_fault_is_explained_and_switched(panel, desk, hand):
    hand.choose(panel._drive, "right")
    hand.choose(panel._fault, "hot")
    assert "does hot" in panel._text.content
    hand.choose(panel._switch, ON)
    assert desk.on == {"left": set(), "right": {"hot"}}
    assert "right: hot" in panel._active.content
    hand.choose(panel._switch, OFF)
    assert desk.on["right"] == set()
    assert "No fault is on" in panel._active.content


def test_what_is_switched_elsewhere_is_seen(panel, desk):
    desk.on["left"].add("silent")
    panel.refresh()
    assert "left: silent" in panel._active.content


def test_a_drive_that_goes_away_is_told_and_the_folder_leaves(panel, desk, hand):
    desk.gone = True
    hand.choose(panel._switch, ON)
    assert hand.client.told == [("Not switched", "it has died")]
    assert not panel._folder.visible


def test_one_look_at_a_time(panel, desk):
    panel._busy.acquire()
    desk.there = []
    panel.refresh()
    assert panel._folder.visible  # the other look tells
