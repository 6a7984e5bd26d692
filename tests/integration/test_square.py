"""Robby drives a square on virtual drives; where it is, is known twice, by formulas of their own."""

import math

import pytest
from support.robots import LEFT, MS, RIGHT, Bench, copy_robby

BASE = "robby_base_controller"
SIDE, SPEED, TURN = 1.0, 0.25, math.pi / 8  # m, m/s, rad/s
RADIUS, SEPARATION = 0.035, 0.24  # the robot as it is, whatever its files say
COUNTS = 1600 / (2 * math.pi)  # microsteps per rad
MOUNTED = {LEFT: -1, RIGHT: 1}  # the left motor is mounted mirrored


class Base:
    """The robot's body, moved by the motors' own shafts: a rigid body in steps of a millisecond.

    The speed of each wheel on the ground moves the body about its centre of rotation, found by geometry; nothing here
    comes from the master, the bus or the odometry.
    """

    def __init__(self, bench):
        self._drives, self._reactor = bench.drives, bench.reactor
        self.x = self.y = self.heading = 0.0
        self._last = self._angles()

    def _angles(self):
        for drive in self._drives.values():
            drive.advance_drives(self._reactor.now())
        plants = {node: drive.drives[0].mover.plant for node, drive in self._drives.items()}
        return {node: MOUNTED[node] * plant.position / COUNTS for node, plant in plants.items()}

    def step(self):
        angles = self._angles()
        left, right = (RADIUS * (angles[node] - self._last[node]) for node in (LEFT, RIGHT))
        self._last = angles
        if abs(right - left) < 1e-12:
            self.x += left * math.cos(self.heading)
            self.y += left * math.sin(self.heading)
            return
        # both wheels run on circles about the same point, at -d and d + separation to the left wheel's side
        turned = math.atan2(right - left, SEPARATION)
        reach = 0.5 * SEPARATION * (right + left) / (right - left)
        centre = (self.x - reach * math.sin(self.heading), self.y + reach * math.cos(self.heading))
        self.heading += turned
        self.x, self.y = centre[0] + reach * math.sin(self.heading), centre[1] - reach * math.cos(self.heading)


def drive_square(name, config="robby"):
    """Drive four sides and four corners; return the pose by odometry and by the drives' plants."""
    bench = Bench(name, config=str(config), controllers=[BASE])
    try:
        bench.start()
        base, controller = Base(bench), bench.robot.manager.get(BASE)
        for _ in range(4):
            for twist, seconds in (([SPEED, 0.0], SIDE / SPEED), ([0.0, TURN], math.pi / 2 / TURN)):
                follow(bench, base, twist, seconds)
                follow(bench, base, [0.0, 0.0], 1.0)  # along the ramps to a stop
        odometry = controller.odometry
        return (odometry.x, odometry.y, odometry.heading), (base.x, base.y, base.heading)
    finally:
        bench.close()


def follow(bench, base, twist, seconds):
    for milliseconds in range(round(seconds * 1000)):
        if milliseconds % 100 == 0:
            bench.robot.command(BASE, twist, "test")
        bench.reactor.run_for(MS)
        base.step()
    assert bench.errors == []


def agree(odometry, plant):
    """Within 1 %: of the side for the place, of the full turn for the heading."""
    way = math.dist(odometry[:2], plant[:2])
    return way <= 0.01 * SIDE and abs(odometry[2] - plant[2]) <= 0.01 * 2 * math.pi


def test_odometry_and_plant_agree_on_where_a_square_of_a_metre_ends():
    odometry, plant = drive_square("square")
    assert agree(odometry, plant), (odometry, plant)
    assert math.hypot(*plant[:2]) < 0.05  # it was a square: it ends where it began
    assert plant[2] == pytest.approx(2 * math.pi, rel=0.01)


@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_with_a_wheel_separation_five_per_cent_wrong_they_do_not(factor, tmp_path):
    wrong = copy_robby(tmp_path, controllers={"wheel_separation: 0.24": f"wheel_separation: {SEPARATION * factor}"})
    odometry, plant = drive_square(f"square{factor * 100:.0f}", wrong)
    assert not agree(odometry, plant)
    assert abs(plant[2] / odometry[2] - factor) < 0.01
