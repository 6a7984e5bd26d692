"""The client of a virtual drive, against one that runs in a thread."""

import os
from types import SimpleNamespace

import pytest
from support.onbus import TMCM, OnBus

from canopen_control.client import drive_client
from canopen_control.client.drive_client import DriveClient, shapes_of_world, signal_values
from canopen_control.errors import ConfigError, RemoteError
from canopen_control.rpc.messages.drive import GetDriveState, ListFaults, SetPlant, SwitchFault, WorldShape
from canopen_control.virtual.control import NodeControl

CHANNEL = "memory:client"
BOX = WorldShape(name="box 0", kind="box", size=(1.0, 2.0, 3.0), position=(0.5, 0.0, 1.5))


@pytest.fixture
def drive():
    with OnBus(CHANNEL, {3: TMCM}) as drives:
        control = drives.call(lambda: NodeControl(drives._host, drives.nodes[3]))
        with DriveClient.connect(CHANNEL, 3) as client:
            yield client
        drives.call(control.close)


def test_it_names_its_peer(drive):
    assert (drive.hello.node_id, drive.hello.channel, drive.hello.pid) == (3, CHANNEL, os.getpid())


def test_answers_are_structures(drive):
    assert drive.ask(SwitchFault(name="warning")).active == ["warning"]
    assert [item.name for item in drive.ask(ListFaults()) if item.on] == ["warning"]
    state = drive.ask(GetDriveState())
    assert (state.faults, state.axes[0].plant.velocity, state.world) == (["warning"], 0.0, None)


def test_what_is_refused_is_reported_in_its_words(drive):
    with pytest.raises(RemoteError, match="'colour' is not a number of this plant") as refused:
        drive.ask(SetPlant(numbers={"colour": 1.0}))
    assert refused.value.kind == "ConfigError"


def test_a_drive_that_is_not_there_is_named():
    with pytest.raises(RemoteError, match="virtual drive 9 on memory:client is not running"):
        DriveClient.connect(CHANNEL, 9)
    with pytest.raises(RemoteError, match="the left one is not running"):
        DriveClient.connect(CHANNEL, 9, label="the left one")


@pytest.mark.parametrize(
    ("text", "values"), [("di0=1", {"di0": 1.0}), (" di0 = 1 , ai0=-2.5e3", {"di0": 1.0, "ai0": -2500.0})]
)
def test_signals_are_read_as_people_write_them(text, values):
    assert signal_values(text) == values


@pytest.mark.parametrize("text", ["", "di0", "=1", "di0=", "di0=inf", "di0=1,"])
def test_what_is_not_a_value_of_a_signal_is_refused(text):
    with pytest.raises(ConfigError, match="write SIGNAL=NUMBER"):
        signal_values(text)


def test_shapes_are_requested_from_the_first_drive_that_has_them(monkeypatch):
    requests = []

    class Drive(SimpleNamespace):
        def __enter__(self):
            return self

        def __exit__(self, *_):
            return None

        def ask(self, _request):
            requests.append(self.node_id)
            return (BOX,) if self.node_id == 3 else ()

    def connect(_channel, node_id, _timeout):
        if node_id == 4:
            raise RemoteError("BusClosed", "it is gone")
        return Drive(node_id=node_id)

    monkeypatch.setattr(drive_client.DriveClient, "connect", connect)
    monkeypatch.setattr(drive_client, "list_sockets", lambda _kind: ["desk-2", "desk-3", "desk-4"])
    nodes = [("local:desk", number) for number in (1, 4, 2, 3)]
    assert shapes_of_world(nodes) == (BOX,)
    assert requests == [2, 3]
    assert shapes_of_world(nodes[:3]) == ()
