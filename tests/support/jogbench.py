"""A virtual drive on a bus inside this process, and `jog` on it as a user types it: all of it in virtual time."""

from __future__ import annotations

import contextlib

from support.lockstep import lockstep
from support.onbus import GENERIC, OnBus

from canopen_control.cli.main import main

NODE_ID = 5


class JogBench:
    """`jog` on the drive of node 5, which has one axis."""

    def __init__(self, bus, eds):
        self.bus, self.eds = bus, eds
        self.drive = bus.nodes[NODE_ID]

    def jog(self, *words, node=NODE_ID, eds=None):
        """Run the verb and return its exit code."""
        return self.verb("jog", *words, node=node, eds=eds)

    def verb(self, verb, *words, node=NODE_ID, eds=None):
        """Run another one."""
        return main([verb, str(node), "--can", self.bus.channel, "--eds", eds or self.eds, *words])

    @property
    def words(self):
        """Which bus and EDS are meant."""
        return ["--can", self.bus.channel, "--eds", self.eds]

    def get(self, index, subindex=0):
        """Return what an object of the drive holds, on the drive's own thread."""
        return self.bus.call(lambda: self.drive.store.get(index, subindex))

    @property
    def speed(self):
        """The plant's velocity, in counts per second."""
        return self.bus.call(lambda: self.drive.drives[0].mover.plant.velocity)


@contextlib.contextmanager
def jog_bench(eds=GENERIC, channel="memory:jog", plant=None):
    with lockstep(), OnBus(channel, {NODE_ID: eds}, plant=plant) as bus:
        yield JogBench(bus, eds)
