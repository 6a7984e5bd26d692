import pytest
from support.onbus import TMCM, OnBus

from canopen_control.errors import RemoteError
from canopen_control.view.page_content import FaultClient, read_faults
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
    assert FaultClient(NODES).drives() == ["left"]


def test_a_fault_is_switched_on_and_off(left):
    client = FaultClient(NODES)
    name = client.faults("left")[0].name
    assert client.switch("left", name, on=True) == [name]
    assert read_faults(client).active["left"] == left.fault_switches.active == [name]
    assert client.switch("left", name, on=False) == []


def test_what_the_drive_refuses_is_reported_in_its_words(left):
    with pytest.raises(RemoteError, match="nonsense"):
        FaultClient(NODES).switch("left", "nonsense", on=True)


def test_a_drive_that_is_not_there_is_reported():
    assert FaultClient(NODES).drives() == []
    with pytest.raises(RemoteError, match="virtual drive right is not running"):
        FaultClient(NODES).faults("right")


def test_an_unknown_name_is_reported():
    with pytest.raises(RemoteError, match="drive 'x' does not exist"):
        FaultClient(NODES).switch("x", "silent", on=True)


def test_a_robot_that_ends_during_the_query_is_omitted(left, monkeypatch):
    monkeypatch.setattr(FaultClient, "drives", lambda self: ["left", "right"])
    assert list(read_faults(FaultClient(NODES)).drives) == ["left"]


@pytest.mark.usefixtures("left")
def test_inputs_are_asked_of_the_device_which_may_have_none():
    with pytest.raises(RemoteError, match="has no signals, because it is a drive"):
        FaultClient(NODES).set_signals("left", {"di0": 1.0})
