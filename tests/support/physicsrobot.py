"""A whole robot in simulated time whose virtual drives move it in physics, all of them in one host."""

from support.robots import Bench, dictionary_of

from canopen_control.bus.channel import open_port
from canopen_control.physics.engine import make
from canopen_control.runtime.physics_plant import write_plant
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeHost


class PhysicsRobot(Bench):
    """A robot under a manual clock; `world` is what its drives move. XDG_STATE_HOME is the test's own."""

    def __init__(self, name, *, config="robby", hall=None, **how):
        super().__init__(name, config=config, drives=(), physics=True, **how)
        self.world = make(write_plant(self.setup, self.robot.joints, hall))
        port = open_port(self.channel, label="drives")
        for node in self.setup.bus.nodes.values():
            self.drives[node.node_id] = self._device(self.setup.bus.eds_paths[node.name], node.node_id)
        self.hosts[0] = NodeHost(self.reactor, port, list(self.drives.values()))
        self.ports[0] = port

    def _device(self, eds, node_id):
        return make_device(dictionary_of(eds), node_id, plant=lambda axis: self.world.plant(node_id, axis))

    def plant(self, node_id):
        return self.drives[node_id].drives[0].mover.plant

    def power_off(self, node_id):
        self.hosts.pop(node_id).close()
        self.ports.pop(node_id).close()
        self.drives.clear()
