"""Robby on virtual drives, its page in a browser, and a witness on its bus."""

import math

from support.browser import RobotPage
from support.host import eventually
from support.listener import Witness

STATUSWORD, VELOCITY = 0x6041, 0x606C
LEFT, RIGHT = 3, 2
STANDING = 20  # microsteps/s; 2546 are 10 rad/s
FORWARD, DIFF_DRIVE = "robby_forward_controller", "robby_base_controller"


class RobotView:
    """Robby, its page, and a witness on its bus."""

    def __init__(self, stage, chromium, name, *options, teleop=False, size=(1440, 900)):
        self.stage, self.name = stage, name
        self.run = stage.robby(name, *options)
        self.view = stage.start("view", "--name", name, "--port", "0", *(["--teleop"] if teleop else []))
        self.url = self.view.until("view: http").split()[-1]
        self.witness = Witness(name)
        for node_id in (LEFT, RIGHT):
            self.witness.join(node_id)
        self.chromium, self.size = chromium, size

    def page(self):
        return RobotPage(self.chromium, self.url, self.size).open()

    def ready(self, page):
        """Do what the page says to do where the drives are not enabled: a busy machine may have stopped the robot."""
        words = {"needs enable": "Enable", "fault": "Reset fault"}

        def running():
            for message, label in words.items():
                if page.page.get_by_text(message, exact=True).first.is_visible():
                    page.click(label)
                    page.page.wait_for_timeout(500)
            return page.page.get_by_text("running", exact=True).first.is_visible()

        assert eventually(running), page.text()

    def drive(self, *speeds):
        """Command the wheels, in rad/s, until the test ends; returns when both turn so fast."""
        self.stage.start("command", FORWARD, *speeds, "--name", self.name)
        self.turning(speeds[0] * 0.9)

    def turning(self, speed):
        steps = speed * 1600 / math.tau
        assert eventually(lambda: min(abs(self.velocity(joint)) for joint in (LEFT, RIGHT)) > steps)

    def velocity(self, node_id):
        series = self.witness.series(node_id, VELOCITY)
        return series[-1][1] if series else 0

    def stood_after(self, begin):
        """Wait until both drives stand, by what they say on the bus; return how many seconds after `begin` they did."""
        assert eventually(lambda: max(abs(self.velocity(joint)) for joint in (LEFT, RIGHT)) <= STANDING)
        last = [
            max(time for time, value in self.witness.series(node_id, VELOCITY) if abs(value) > STANDING)
            for node_id in (LEFT, RIGHT)
        ]
        return max(last) - begin
