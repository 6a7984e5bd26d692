"""The client of a virtual drive, against one that runs in a thread."""

import os

import pytest
from support.onbus import TMCM, OnBus

from canopen_control.client.drive_client import DriveClient
from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.drive import GetDriveState, ListFaults, SetPlant, SwitchFault
from canopen_control.virtual.control import NodeControl

CHANNEL = "memory:client"


@pytest.fixture
def drive():
    with OnBus(CHANNEL, {3: TMCM}) as drives:
        control = drives.call(lambda: NodeControl(drives._host, drives.nodes[3]))
        with DriveClient.connect(CHANNEL, 3) as client:
            yield client
        drives.call(control.close)


def test_it_knows_whom_it_speaks_to(drive):
    assert (drive.hello.node_id, drive.hello.channel, drive.hello.pid) == (3, CHANNEL, os.getpid())


def test_answers_are_structures(drive):
    assert drive.ask(SwitchFault(name="warning")).active == ["warning"]
    assert [each.name for each in drive.ask(ListFaults()) if each.on] == ["warning"]
    state = drive.ask(GetDriveState())
    assert (state.faults, state.axes[0].plant.velocity, state.world) == (["warning"], 0.0, None)


def test_what_is_refused_is_told_in_its_words(drive):
    with pytest.raises(RemoteError, match="'colour' is no number of this plant") as refused:
        drive.ask(SetPlant(numbers={"colour": 1.0}))
    assert refused.value.kind == "ConfigError"


def test_a_drive_that_is_not_there_is_named():
    with pytest.raises(RemoteError, match="virtual drive 9 on memory:client is not running"):
        DriveClient.connect(CHANNEL, 9)
    with pytest.raises(RemoteError, match="the left one is not running"):
        DriveClient.connect(CHANNEL, 9, label="the left one")
