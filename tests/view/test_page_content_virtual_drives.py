import pytest
from support.onbus import TMCM, OnBus

from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.drive import ListFaults, SetSignals, SwitchFault
from canopen_control.view.page_content import VirtualDrives, read_faults
from canopen_control.view.robot_connection import NodeAddress
from canopen_control.virtual.control import NodeControl

NODES = (NodeAddress("left", "memory:desk", 3), NodeAddress("right", "memory:desk", 2))


@pytest.fixture
def left():
    """Return the left drive, on the bus and with its control socket; there is no right one."""
    with OnBus("memory:desk", {3: TMCM}) as drives:
        control = drives.call(lambda: NodeControl(drives._host, drives.nodes[3]))
        yield drives.nodes[3]
        drives.call(control.close)


def test_only_drives_that_are_there_can_be_broken(left):
    assert VirtualDrives(NODES).running() == ["left"]


def test_a_fault_is_switched_on_and_off(left):
    client = VirtualDrives(NODES)
    name = client.ask("left", ListFaults())[0].name
    assert client.ask("left", SwitchFault(name=name, on=True)).active == [name]
    assert read_faults(client).active["left"] == left.fault_switches.active == [name]
    assert client.ask("left", SwitchFault(name=name, on=False)).active == []


def test_what_the_drive_refuses_is_reported_in_its_words(left):
    with pytest.raises(RemoteError, match="nonsense"):
        VirtualDrives(NODES).ask("left", SwitchFault(name="nonsense", on=True))


def test_a_drive_that_is_not_there_is_reported():
    assert VirtualDrives(NODES).running() == []
    with pytest.raises(RemoteError, match="virtual drive right is not running"):
        VirtualDrives(NODES).ask("right", ListFaults())


def test_an_unknown_name_is_reported():
    with pytest.raises(RemoteError, match="drive 'x' does not exist"):
        VirtualDrives(NODES).ask("x", SwitchFault(name="silent", on=True))


def test_a_robot_that_ends_during_the_query_is_omitted(left, monkeypatch):
    monkeypatch.setattr(VirtualDrives, "running", lambda self: ["left", "right"])
    assert list(read_faults(VirtualDrives(NODES)).drives) == ["left"]


@pytest.mark.usefixtures("left")
def test_inputs_are_asked_of_the_device_which_may_have_none():
    with pytest.raises(RemoteError, match="has no signals, because it is a drive"):
        VirtualDrives(NODES).ask("left", SetSignals(values={"di0": 1.0}))
