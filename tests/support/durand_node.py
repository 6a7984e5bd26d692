"""A node of the `durand` library in virtual time: its network is a port, its scheduler the reactor."""

import threading

from durand import DatatypeEnum, Node, Variable, set_scheduler
from durand.network import NetworkABC
from durand.scheduler import AbstractScheduler

from canopen_control.frame import CanFrame, frames_of, pack_records

WRITABLE, MEASURED = 0x2000, 0x2001


class PortNetwork(NetworkABC):
    """Frames of a node on a port."""

    def __init__(self, reactor, port):
        self.port, self.callbacks = port, {}
        reactor.add_reader(port, self.receive)

    def add_subscription(self, cob_id, callback):
        self.callbacks[cob_id] = callback

    def remove_subscription(self, cob_id):
        del self.callbacks[cob_id]

    def send(self, cob_id, msg):
        self.port.send(pack_records([CanFrame(cob_id, bytes(msg))]))

    def receive(self):
        for frame in frames_of(self.port.receive()):
            callback = self.callbacks.get(frame.can_id)
            if callback is not None:
                callback(frame.can_id, frame.data)


class ReactorScheduler(AbstractScheduler):
    """Timers of a node."""

    def __init__(self, reactor):
        self.reactor, self.own_lock = reactor, threading.Lock()

    def add(self, delay, callback, args=(), kwargs=None):
        return self.reactor.call_later(round(delay * 1e9), lambda: callback(*args, **(kwargs or {})))

    def cancel(self, entry):
        entry.cancel()

    @property
    def lock(self):
        return self.own_lock


def durand_node(reactor, port, node_id):
    """Return a node with an RPDO and a TPDO of four bytes each."""
    set_scheduler(ReactorScheduler(reactor))
    node = Node(PortNetwork(reactor, port), node_id)
    node.object_dictionary[WRITABLE] = Variable(DatatypeEnum.UNSIGNED32, "rw", 0)
    node.object_dictionary[MEASURED] = Variable(DatatypeEnum.UNSIGNED32, "ro", 0)
    node.rpdo[0].mapping, node.tpdo[0].mapping = [(WRITABLE, 0)], [(MEASURED, 0)]
    node.rpdo[0].enable = node.tpdo[0].enable = True
    return node
