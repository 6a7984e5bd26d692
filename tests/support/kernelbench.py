"""A whole robot in one process on a real kernel's CAN, in real time: master and drives on sockets of their own."""

from __future__ import annotations

import os

from support.guest import scaled_robby
from support.host import TIME_SCALE
from support.observers import Observer
from support.robots import LEFT, MS, RIGHT, Bench

from canopen_control.host.reactor import Reactor
from canopen_control.runtime.core import RobotCore
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot

CHANNEL = os.environ.get("CANOPEN_CONTROL_TEST_CHANNEL", "vcan0")
"""The SocketCAN interface of the tests that take what there is."""

SCALE = max(1.0, TIME_SCALE / 2.5)  # one process needs less time than several


class KernelBench(Bench):
    """A `Bench` whose clock and bus are real; its times, and robby's, are those of the test multiplied by `scale`."""

    jitter = 0.25

    def __init__(self, folder, *, config=None, drives=(LEFT, RIGHT), **how):
        self.scale, self.channel = SCALE, CHANNEL
        self.reactor, self.errors, self.events = Reactor(), [], []
        self.reactor.on_error = self.errors.append
        self.drives, self.hosts, self.ports, self.robot = {}, {}, {}, None
        self._now = None
        files = find_robot(str(config or scaled_robby(folder, SCALE)))
        self.setup = read_robot(files, can=[CHANNEL], **how)
        try:
            self.robot = RobotCore(self.setup, self.reactor)
            for node_id in drives:
                self.power_on(node_id)
        except BaseException:
            self.close()
            raise
        self.robot.observers.append(Observer(event=self.events.append))

    def run(self, ms):
        """Let milliseconds of the test pass, one call's after the other's without any between."""
        self._now = (self._now or self.reactor.now()) + round(ms * self.scale * MS)
        self.reactor.run_until(self._now)
        assert self.errors == [], self.errors

    def until(self, condition, ms=5000):
        """Let time pass until `condition`; fail after `ms` of the test, else return how many it took."""
        begin = self._now = self.reactor.now()
        reported = self.reactor.run_until(condition, round(ms * self.scale * MS))
        assert reported, f"not within {ms} ms: {[event.text for event in self.events[-6:]]}"
        self._now = self.reactor.now()
        return (self._now - begin) / MS / self.scale
