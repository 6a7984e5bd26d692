"""A wire of 1 Mbit/s between two ports, in virtual time: frames take their bits, and arrive late by a random time."""

from functools import partial
from random import Random

from canopen_control.bus.arbitration import duration_ns, frame_bits
from canopen_control.frame import frames_of, pack_records

BITRATE = 1_000_000
JITTER_NS = 300_000  # jitter of a busy computer or of an adapter


class Relay:
    """Passes the frames of each of two ports to the other; frames of one direction keep their order."""

    def __init__(self, reactor, first, second, seed):
        self.reactor, self.random = reactor, Random(seed)
        self.free = 0
        self.due = {first: 0, second: 0}
        self.ports = first, second
        for source, target in ((first, second), (second, first)):
            reactor.add_reader(source, partial(self._pass, source, target))

    def close(self):
        """Leave the reactor."""
        for port in self.ports:
            self.reactor.remove_reader(port)
            port.close()

    def _pass(self, source, target):
        for frame in frames_of(source.receive()):
            bits = frame_bits(frame.can_id, frame.data)
            self.free = max(self.free, self.reactor.now()) + duration_ns(bits, BITRATE)
            self.due[target] = max(self.due[target], self.free + self.random.randrange(JITTER_NS))
            self.reactor.call_at(self.due[target], partial(target.send, pack_records([frame])))
