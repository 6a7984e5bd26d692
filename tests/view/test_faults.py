import pytest
from support.onbus import TMCM, OnBus

from canopen_control.errors import RemoteError
from canopen_control.view.faults import FaultDesk, control_name
from canopen_control.virtual.control import NodeControl, control_path

NODES = {
    "buses": {"can": {"channel": "memory:desk"}},
    "nodes": [{"name": "left", "node_id": 3, "bus": "can"}, {"name": "right", "node_id": 2, "bus": "can"}],
}


@pytest.fixture
def left():
    """Return the left drive, on the bus and with its control socket; there is no right one."""
    with OnBus("memory:desk", {3: TMCM}) as drives:
        control = drives.call(lambda: NodeControl(drives._host, drives.nodes[3]))
        yield drives.nodes[3]
        drives.call(control.close)


@pytest.mark.parametrize(
    ("channel", "node_id"), [("local:robby", 3), ("vcan0", 127), ("memory:a.b/c", 1), ("local:" + "x" * 32, 5)]
)
def test_the_name_is_the_one_that_the_virtual_node_gives_its_socket(channel, node_id):
    assert control_path(channel, node_id).stem == f"drive-{control_name(channel, node_id)}"


def test_only_drives_that_are_there_can_be_broken(left):
    assert FaultDesk(NODES).drives() == ["left"]


def test_a_fault_is_switched_on_and_off(left):
    desk = FaultDesk(NODES)
    name = desk.faults("left")[0]["name"]
    assert desk.switch("left", name, on=True) == [name]
    assert [fault["name"] for fault in desk.faults("left") if fault["on"]] == left.switches.active == [name]
    assert desk.switch("left", name, on=False) == []


def test_what_the_drive_refuses_is_told_in_its_words(left):
    with pytest.raises(RemoteError, match="nonsense"):
        FaultDesk(NODES).switch("left", "nonsense", on=True)


def test_a_drive_that_is_not_there_is_told():
    assert FaultDesk(NODES).drives() == []
    with pytest.raises(RemoteError, match="virtual drive right is not running"):
        FaultDesk(NODES).faults("right")
