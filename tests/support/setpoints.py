"""A virtual axis in a cyclic mode on a bench, and a master that sends its set-points in simulated time."""

from __future__ import annotations

import struct

from support.virtualbench import Bench, servo_od

from canopen_control.virtual.device import make_device
from canopen_control.virtual.device_model import GENERIC

MS = 1_000_000
RPDO, TARGETS = 0x305, struct.Struct("<ii")
STEP = 1000  # counts in 10 ms, at velocity V


class StreamBench(Bench):
    """A servo drive enabled in `mode`, whose RPDO 2 holds 0x607A and 0x60FF; `period_ms` is its 0x60C2.

    `synchronous`: the RPDO counts at SYNC, else at once. `mapped` are what it holds instead, as mapping entries.
    """

    def __init__(
        self, period_ms=10, *, mode=8, model=GENERIC, synchronous=True, plant=None, mapped=(), od=None, **changed
    ):
        super().__init__(make_device(od or servo_od(5, **changed), 5, model=model, plant=plant))
        self.write(0x1401, 0x80000000 | RPDO, 1)
        self.write(0x1401, 1 if synchronous else 255, 2)
        for number, item in enumerate(mapped, start=1):
            if number == 1:
                self.write(0x1601, 0)
            self.write(0x1601, item, number)
        if mapped:
            self.write(0x1601, len(mapped))
        self.write(0x1401, RPDO, 1)
        self.write(0x60C2, period_ms, 1)
        self.enable(mode)

    def send(self, *values):
        """Send the RPDO: set-points of 32 bits."""
        values = (*values, 0)[: max(2, len(values))]
        self.put(RPDO, struct.pack(f"<{len(values)}i", *values))

    def cycle(self, target, seconds=0.01):
        """Send a set-point, let it count, and let a period pass."""
        self.send(target)
        self.sync()
        self.on(seconds)

    def restart(self):
        self.drive.meter.restart()

    @property
    def quality(self):
        return self.drive.describe().set_points

    @property
    def ripple(self):
        """The standard deviation of the demanded velocity, and its ends, relative to V."""
        quality, v = self.quality, STEP / 0.01
        return quality.velocity_ripple, quality.velocity.min / v, quality.velocity.max / v

    def ramp(self, cycles=400, skip=(), repeat=(), settle=50):
        """Send set-points of the velocity V in every period but those to skip, some as the one before; measure."""
        position = 0
        for cycle in range(1, cycles):
            if cycle == settle:
                self.restart()
            if cycle in skip:
                self.sync()
                self.on(0.01)
                continue
            position = position if cycle in repeat else STEP * cycle
            self.cycle(position)
        return self

    def sampled_ramp(self, controller_ms, sync_ms, seconds=8.0):
        """Send, at every SYNC, the set-point that a controller with a period of its own made last."""
        begun = self.now
        while (gone := self.now - begun) < seconds * 1e9:
            if gone // MS == 400:
                self.restart()
            created = gone // (controller_ms * MS)
            self.cycle(round(created * controller_ms * STEP / 10), sync_ms / 1000)
        return self
