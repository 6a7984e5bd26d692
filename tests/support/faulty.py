"""A virtual node on a bench, with its faults at hand."""

from __future__ import annotations

from support.virtualbench import Aborted, Bench, servo

from canopen_control.virtual.fault_table import FAULTS, FaultSwitches


class Faulty(Bench):
    """A bench with its fault switches."""

    def __init__(self, node):
        super().__init__(node)
        self.board = node.fault_switches or FaultSwitches(node)

    def set(self, name, on=True):
        self.board.set(name, on, self.now)
        self.collect()

    def sent(self, can_id, seconds):
        self.seen.clear()
        self.on(seconds)
        return [(when, frame.data) for when, frame in self.seen if frame.can_id == can_id]

    def beats(self, seconds=0.5):
        return [data for _, data in self.sent(0x705, seconds)]

    def answers(self, index=0x1000, sub=0):
        try:
            return self.read(index, sub)
        except Aborted as error:
            return error.code


def bench(**kwargs):
    b = Faulty(servo(**kwargs))
    b.write(0x1017, 100)
    b.on(0.01)
    return b


def fault(name):
    """Name a fault that a test is about; the test of the table looks for every one."""
    assert name in FAULTS
    return name
