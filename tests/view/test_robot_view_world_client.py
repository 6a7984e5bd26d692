import pytest
from support.fake_client import FakeClient
from support.virtualbench import served, servo

from canopen_control.errors import ConfigError, RemoteError
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint
from canopen_control.rpc.messages.simulation import GetSimulation, Simulation
from canopen_control.view import robot_view
from canopen_control.view.page_content import VirtualDrives
from canopen_control.view.robot_connection import NodeAddress
from canopen_control.view.robot_view import WorldClient
from canopen_control.virtual.plant import IndependentPlants

CAN = "memory:view-world"
NODES = (NodeAddress("real", CAN, 4), NodeAddress("virtual", CAN, 5))


class Noting(IndependentPlants):
    def __init__(self):
        self.acts = []

    def act(self, what):
        if getattr(what, "joint", "") == "roof":
            raise ConfigError("no drive moves a joint 'roof'")
        self.acts.append(what)


def test_what_is_asked_for_happens_in_the_world_of_the_drives():
    world = Noting()
    with served(CAN, servo(5), world):
        client = WorldClient("robby", VirtualDrives(NODES))
        assert client.changeable()
        client.act(AddPayload(mass=3.0))
        with pytest.raises(RemoteError, match="no drive moves a joint 'roof'"):
            client.act(BlockJoint(joint="roof"))
    assert world.acts == [AddPayload(mass=3.0)]


def test_without_physics_nothing_can_be_asked_for():
    with served(CAN, servo(5), IndependentPlants()):
        assert not WorldClient("robby", VirtualDrives(NODES)).changeable()
        with pytest.raises(RemoteError, match="not in a physics simulation"):
            WorldClient("robby", VirtualDrives(NODES)).act(AddPayload(mass=3.0))
    assert not WorldClient("robby", VirtualDrives(NODES)).changeable()


@pytest.mark.parametrize("changeable", [True, False])
def test_a_robot_without_drives_is_asked_itself_and_reports_of_it(monkeypatch, changeable):
    simulation = Simulation(seconds=1.0, paused=False, period=0.02, changeable=changeable)
    robot = FakeClient(answers={GetSimulation: simulation})
    monkeypatch.setattr(robot_view.RobotClient, "connect", lambda name, _timeout: robot if name == "diffbot" else None)
    client = WorldClient("diffbot", VirtualDrives(()))
    assert client.changeable() is changeable
    assert client.act(AddPayload(mass=3.0))
    assert [item for item in robot.asked if not isinstance(item, GetSimulation)] == [AddPayload(mass=3.0)]


def test_a_robot_that_is_gone_is_in_no_world():
    assert not WorldClient("diffbot", VirtualDrives(())).changeable()
