"""Robby in simulated time with a fault switched on: when it was told, when the robot stood, what it takes to go on."""

from __future__ import annotations

from support.robots import LEFT, RIGHT, Bench

from canopen_control.errors import CanopenError
from canopen_control.hardware.axis_statechart import Action

CYCLE_MS = 20
SPEED = 10 / 0.003926990816987242  # microsteps/s at 10 rad/s
RAMP_MS = 1000 * SPEED / 16000  # by 0x6084 and 0x6085
STATES = {0x27: "OPERATION_ENABLED", 0x07: "QUICK_STOP_ACTIVE", 0x0F: "FAULT_REACTION_ACTIVE"}


class FaultBench(Bench):
    """`victim` is the node-ID of the drive that gets the fault; times are in ms from the moment it was switched on."""

    victim = LEFT
    began = 0

    def turning(self, speed=10.0):
        """Start, and turn both wheels at a steady speed."""
        self.start()
        self.hold(speed, speed, ms=600)
        self.events.clear()
        self.began = self.reactor.now()
        return self

    def switch(self, name, on=True, node=None):
        """Switch a fault of the virtual drive on or off."""
        node = self.victim if node is None else node
        drive = self.drives[node]
        drive.fault_switches.set(name, on, self.reactor.now())
        self.hosts[node].wake(drive)
        if on:
            self.began = self.reactor.now()

    def collected(self, kind, ms=3000):
        """Wait for an event of a kind; returns it and after how many ms it came."""
        self.until(lambda: self.found(kind), ms)
        event = self.found(kind)[0]
        return event, (event.time - self.began) / 1e6

    def found(self, kind):
        return [event for event in self.events if event.kind == kind]

    def standing(self, *nodes):
        return all(abs(self.speed(node)) < 1 for node in nodes or self.drives)

    def stopped_after(self, *nodes, ms=5000):
        """Wait until wheels stand, still commanded all the time; returns ms since the fault."""
        while not self.standing(*nodes):
            assert (self.reactor.now() - self.began) / 1e6 < ms, [event.text for event in self.events]
            self.publish(10.0, 10.0)
            self.run(1)
        return (self.reactor.now() - self.began) / 1e6

    def powered(self, node):
        """Whether the drive itself says that its motor has torque."""
        return self.drives[node].get(0x6041) & 0x6F in STATES

    def disabled_after(self, ms=6000):
        """Wait until no drive has torque; returns ms since the fault."""
        self.until(lambda: not any(self.powered(node) for node in self.drives), ms)
        return (self.reactor.now() - self.began) / 1e6

    def expect_stays_down(self, ms=1000):
        """Assert that commands alone move nothing."""
        for _ in range(ms // 100):
            self.publish(10.0, 10.0)
            self.run(100)
            assert self.standing()

    def axis(self, action, node="all", ms=15_000, **how):
        """Ask for an action and wait for the answer: None or the reason."""
        answers = []
        try:
            self.robot.axis(action, node, answers.append, **how)
        except CanopenError as error:
            return str(error)
        self.until(lambda: answers, ms)
        return answers[0]

    def goes_on(self):
        """Enable and turn again: the robot is as good as before."""
        reason = self.axis(Action.ENABLE)
        assert reason is None, reason
        self.hold(10.0, 10.0, ms=600)
        assert self.speed(RIGHT) == -self.speed(LEFT)
        assert abs(self.speed(RIGHT) - SPEED) < 0.01 * SPEED

    def axis_refused(self, action=Action.ENABLE, node="all", **how):
        """Ask for an action that is refused; returns why."""
        reason = self.axis(action, node, **how)
        assert reason is not None
        return reason
