"""A drive with a habit of its own: one dictionary as EDS file, as virtual drive, and as what a bus.yml boots."""

from __future__ import annotations

import dataclasses
import textwrap

from support.virtualbench import servo_od

from canopen_control.frame import CanFrame, frames_of, pack_records
from canopen_control.master.config import read_bus
from canopen_control.master.network import Network
from canopen_control.od.dcf import eds_text
from canopen_control.virtual.device import make_device

MS = 1_000_000
NODE = 5
ORDINARY = """
heartbeat_producer: 100
tpdo:
  1: {enabled: true, cob_id: auto, transmission: 1, mapping: [{index: 0x6041}, {index: 0x6061}]}
  2: {enabled: true, cob_id: auto, transmission: 1, mapping: [{index: 0x6064}]}
rpdo:
  1: {enabled: true, cob_id: auto, mapping: [{index: 0x6040}, {index: 0x6060}]}
  2: {enabled: true, cob_id: auto, mapping: [{index: 0x60FF}]}
"""


def dictionary(drop=(), **changes):
    """Return a servo's dictionary without `drop` (addresses, indices), and with `sIIII_SS={field: value}` changed."""
    od = servo_od(NODE)
    for name, fields in changes.items():
        address = int(name[1:5], 16), int(name[6:8], 16)
        od.entries[address] = dataclasses.replace(od.entries[address], **fields)
    for address in [entry for entry in od.entries if entry in drop or entry[0] in drop]:
        del od.entries[address]
    for index in [entry for entry in od.objects if not od.subindices(entry)]:
        del od.objects[index]
    return od


def write_bus(folder, od, node=ORDINARY, master="{node_id: 1, sync_period: 20000}"):
    """Write the EDS of a dictionary and a bus.yml for it; return the path of the latter."""
    (folder / "drive.eds").write_text(eds_text(od))
    path = folder / "bus.yml"
    keys = textwrap.indent(textwrap.dedent(node), "    ")
    path.write_text(f"master: {master}\nnodes:\n  drive:\n    dcf: drive.eds\n    node_id: {NODE}\n{keys}")
    return path


class Booted:
    """The master of a bus.yml and the virtual drive of its one EDS, with nothing in between; simulated time."""

    def __init__(self, path, device=None):
        self.config, self.events, self.now = read_bus(path), [], 1_000 * MS
        self.wire = []
        self.device = device or make_device(next(iter(self.config.eds_paths.values())), NODE)
        self.network = Network("can", self.config, self.events.append, self.config.master.sync_period * 1000)
        self.node = self.network.nodes["drive"]
        self.network.start(self.now)

    def run(self, ms):
        """Let milliseconds pass, or fewer if the drive is ready before."""
        for _ in range(ms):
            self._exchange()
            if self.node.ready:
                return self
            self.step()
        return self

    def step(self):
        """Let a millisecond pass."""
        self.now += MS
        self.device.tick(self.now)
        if self.now // MS % 20 == 0:
            self.device.receive(CanFrame(0x080, b""), self.now)
        self.network.tick(self.now)
        self._exchange()

    def give(self, *frames):
        """Let the master hear frames."""
        self.network.receive(pack_records([CanFrame(*frame) for frame in frames]), self.now)
        self._exchange()

    def _exchange(self):
        while True:
            sent = list(frames_of(self.network.take()))
            for frame in sent:
                self.device.receive(frame, self.now)
            answers = self.device.frames()
            self.wire += [*sent, *answers]
            if not sent and not answers:
                return
            self.network.receive(pack_records(answers), self.now)

    @property
    def collected(self):
        return [event.text for event in self.events]


def boot(folder, od, node=ORDINARY, ms=3000, **how):
    """Boot the virtual drive of a dictionary by an ordinary bus.yml."""
    return Booted(write_bus(folder, od, node, **how)).run(ms)
