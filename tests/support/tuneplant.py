"""A virtual motor with hidden parameters, pushed by a tuning run cycle by cycle: no bus, no clock but its own."""

from __future__ import annotations

import math

from canopen_control.commissioning.jog_motion import JogEnd, JogKind, JogLimits
from canopen_control.commissioning.tune_run import TuneMotion, TuneRecord, TuneSample
from canopen_control.virtual.plant import LoadedPlant
from canopen_control.virtual.trajectory import ramp_to

COUNTS = 65536 / math.tau
INERTIA = 1000 * 2.5 / 2e6 * COUNTS  # per mille s^2/rad
VISCOUS = 0.0005 * COUNTS
COULOMB = 40.0


def loaded(**kwargs):
    """Return the motor."""
    return LoadedPlant(acceleration=2e6, inertia=1.5, friction=COULOMB, viscosity=0.0005, **kwargs)


def pushed(plant, excitation, period, delay=0):
    """Push it with a torque that comes a cycle and `delay` more of them late; return the end and the record."""
    limits = JogLimits(speed=60.0, travel=60 * math.tau, current=3000.0)
    motion, record = TuneMotion(JogKind.TORQUE, excitation, limits, now=0), TuneRecord(period)
    now, cycle, waiting, step = 0, 0, [0.0] * (delay + 1), round(period * 1e9)
    while motion.ended is JogEnd.NONE:
        speed = round(plant.velocity) / COUNTS
        motion.see(plant.position / COUNTS, speed, plant.torque, enabled=True)
        motion.tick(now)
        record.put(TuneSample(cycle, motion.command, plant.position / COUNTS, speed, plant.torque))
        waiting.append(motion.command)
        torque = waiting.pop(0)
        plant.apply_torque(ramp_to(now, 0.0, torque, torque, math.inf, math.inf), now, now + step)
        now, cycle = now + step, cycle + 1
    return motion.ended, record
