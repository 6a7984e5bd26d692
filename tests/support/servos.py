"""Two generic servo drives in virtual time, whose modes of operation a test chooses, under one controller."""

import math

from support.faultbench import FaultBench
from support.generic import JOINTS, write_generic

DECELERATION = 262144 / 65536 * math.tau  # 0x6084 in rad/s^2


def start_servos(folder, name, controller, modes="", **how):
    """Return the bench of a robot that runs; `close` ends it."""
    bench = FaultBench(name, config=write_generic(folder, modes=modes, **how), drives=(2, 3), controllers=[controller])
    bench.start()
    return bench


def command(robby, controller, value, ms):
    """Command all joints for so long, every 10 ms."""
    for _ in range(ms // 10):
        robby.robot.command(controller, [value] * len(JOINTS), "test")
        robby.run(10)
