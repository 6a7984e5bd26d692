import pytest
from support.host import use_private_folders
from support.virtualbench import served, servo

from canopen_control.errors import ConfigError, RemoteError
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint
from canopen_control.view.robot_info import VirtualNode
from canopen_control.view.world_client import WorldClient
from canopen_control.virtual.plant import PlainWorld

CAN = "memory:view-world"
NODES = (VirtualNode("real", CAN, 4), VirtualNode("virtual", CAN, 5))


class Noting(PlainWorld):
    def __init__(self):
        self.acts = []

    def act(self, what):
        if getattr(what, "joint", "") == "roof":
            raise ConfigError("no drive moves a joint 'roof'")
        self.acts.append(what)


@pytest.fixture
def served_in(tmp_path, monkeypatch):
    use_private_folders(monkeypatch, tmp_path)
    return lambda world: served(CAN, servo(5), world)


def test_what_is_asked_for_happens_in_the_world_of_the_drives(served_in):
    world = Noting()
    with served_in(world):
        client = WorldClient(NODES)
        assert client.changeable()
        client.act(AddPayload(mass=3.0))
        with pytest.raises(RemoteError, match="no drive moves a joint 'roof'"):
            client.act(BlockJoint(joint="roof"))
    assert world.acts == [AddPayload(mass=3.0)]


def test_without_physics_nothing_can_be_asked_for(served_in):
    with served_in(PlainWorld()):
        assert not WorldClient(NODES).changeable()
        with pytest.raises(RemoteError, match="no world with physics"):
            WorldClient(NODES).act(AddPayload(mass=3.0))
    assert not WorldClient(NODES).changeable()
