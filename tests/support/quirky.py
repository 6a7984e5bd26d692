"""A virtual node on a bench, with quirks."""

from __future__ import annotations

from support.virtualbench import Aborted, Bench, servo

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.virtual.quirks import switches_of


class Quirky(Bench):
    """A servo drive with `quirks` from its power-on."""

    def __init__(self, *quirks, node=None):
        node = servo() if node is None else node
        self.quirks = switches_of(node)
        self.quirks.start_with(quirks)
        super().__init__(node)

    def set(self, text, on=True):
        self.quirks.set(text, on, self.now)
        self.collect()

    def break_with(self, fault):
        self.node.fault_switches.set(fault, True, self.now)
        self.collect()

    def reboot(self, seconds=0.1):
        """Reset the node; return what it sent."""
        self.seen.clear()
        self.nmt(NmtCommand.RESET_NODE)
        self.on(seconds)
        return [frame for _, frame in self.seen]

    def code_of(self, index, sub=0):
        """Return the abort code of a read, None when it is answered."""
        try:
            self.read(index, sub)
        except Aborted as error:
            return error.code
        return None

    def emergencies(self):
        return [frame.data for _, frame in self.seen if frame.can_id == 0x085]

    def moving(self, mode=3):
        """Enabled in PV, at 1000 counts/s."""
        self.enable(mode)
        self.write(0x60FF, 1000)
        self.on(1)
        return self

    def faulted(self):
        """In FAULT, whose cause is gone."""
        self.enable(3)
        self.seen.clear()
        self.drive.fault(0x2310, self.now)
        return self.on(0.5)

    def stream(self, cycles=10):
        """Enabled in CSP, led by RPDOs at 1000 counts/s; return where to."""
        self.enable(8)
        for count in range(1, cycles + 1):
            self.put(0x305, (10 * count).to_bytes(4, "little") + bytes(4))
            self.on(0.01)
        return 10 * cycles
