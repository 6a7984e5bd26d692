from __future__ import annotations

from support.virtualbench import S, servo

from canopen_control.bus.memory import MemoryBus
from canopen_control.host.reactor import ManualClock, Reactor
from canopen_control.virtual.control import NodeControl
from canopen_control.virtual.nodehost import NodeHost
from canopen_control.virtual.plant import LoadedPlant
from canopen_control.virtual.timeline import Switching, Timeline


def test_steps_happen_in_their_time_and_one_that_cannot_is_told():
    with Reactor(ManualClock(S)) as reactor:
        port, node, said = MemoryBus("timeline").open("drives"), servo(5, plant=lambda axis: LoadedPlant()), []
        host = NodeHost(reactor, port, [node])
        control = NodeControl(host, node)
        steps = [
            Switching(S, 5, "silent"),
            Switching(2 * S, 5, "silent", on=False),
            Switching(3 * S, 5, plant=(("external", -50.0),)),
            Switching(4 * S, 5, plant=(("colour", 1.0),)),
        ]
        Timeline(reactor, {node: control}, {5: node}, said.append).plan(steps)
        active = []
        for _ in range(4):
            reactor.run_for(S + 1)
            active.append(list(node.switches.active))
        assert active[:2] == [["silent"], []]
        assert node.drives[0].mover.plant.external == -50.0
        assert said == ["node 5: scenario: plant: 'colour' is no number of this plant"]
        control.close()
        host.close()
        port.close()
