"""Robby on a floor, with wheels that are not those of its YAML: the whole robot in simulated time, and a client."""

import functools
import math
from pathlib import Path

from support.robots import Bench, dictionary_of

from canopen_control.bus.channel import open_port
from canopen_control.calibration.base_link import Driven, WheelValues
from canopen_control.calibration.umbmark import Pace
from canopen_control.errors import CanopenError, RemoteError
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.parameters import GetParameters, ParameterValue, SetParameters
from canopen_control.rpc.messages.robot import ListControllers, Subscribe, TwistController
from canopen_control.rpc.messages.state import TruePose
from canopen_control.runtime.ground_truth import odometry_at
from canopen_control.runtime.status import state_sample
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeHost
from canopen_control.virtual.plant_file import read_world

BASE = "robby_base_controller"
QUICK = Pace(speed=0.8, turn=3.0, ramp=1.2, turn_ramp=6.0, settle=0.2)
PLANT = """
base: {left: 3, right: 2, wheel_radius: 0.035, wheel_separation: %s, counts_per_revolution: 1600,
       right_wheel_radius: %s, reversed: [%s], slip: %s}
"""


def plant_text(*, track=1.0, unequal=1.0, slip=0.0):
    """Return the plant file of a robby whose track and right wheel are so many times what its YAML says."""
    return PLANT % (0.24 * track, 0.035 * unequal, REVERSED, slip)


REVERSED = "left"


class FloorBench(Bench):
    """Robby on its floor; `robot.truth` is kept up to date."""

    def __init__(self, folder, name, **wrong):
        path = Path(folder) / "plant.yml"
        path.write_text(plant_text(**wrong))
        self.world = read_world(path)
        super().__init__(name, controllers=[BASE])

    def power_on(self, node_id, faults=()):
        node = next(candidate for candidate in self.setup.bus.nodes.values() if candidate.node_id == node_id)
        port = open_port(self.channel, label=f"drive {node_id}")
        plant = functools.partial(self.world.plant, node_id)
        device = make_device(dictionary_of(self.setup.bus.eds_paths[node.name]), node_id, faults, plant=plant)
        self.drives[node_id], self.ports[node_id] = device, port
        self.hosts[node_id] = NodeHost(self.reactor, port, [device])

    def hurry(self):
        """Let it be driven as fast as its drives can, so that squares take less time."""
        values = {"linear.x.max_acceleration": 2.0, "linear.x.max_deceleration": -2.0, "angular.z.max_velocity": 4.0}
        values |= {"angular.z.min_velocity": -4.0, "angular.z.max_acceleration": 12.0}
        values |= {"angular.z.max_deceleration": -12.0}
        expected = [ParameterValue(name=name, kind="double", value=value) for name, value in values.items()]
        self.robot.manager.set_parameters(BASE, expected)

    def look(self):
        """Bring the axes to the present, and the true pose to the robot."""
        now = self.reactor.now()
        for drive in self.drives.values():
            drive.advance_drives(now)
        base = self.world.describe().base
        self.robot.truth.take(base, odometry_at(self.robot.manager, 0), self.robot.wall_offset_ns)


class BenchClient:
    """Stands for a RobotClient: what it asks is done at once, and time passes while it waits for messages."""

    def __init__(self, bench):
        self.bench, self.robot = bench, "robby"
        self.rate, self.twists = None, []
        self.on_state = lambda _count: None
        self.states = 0

    def ask(self, request, timeout=None):
        try:
            return self.answer(request)
        except RemoteError:
            raise
        except CanopenError as error:
            raise RemoteError(type(error).__name__, str(error)) from None

    def answer(self, request):
        robot = self.bench.robot
        match request:
            case TwistController(controller=name, linear=linear, angular=angular, dead_man=dead_man):
                assert dead_man
                robot.command(name, [linear, angular], "calibrate", holder=self)
                self.twists.append((linear, angular))
            case Subscribe(state_rate=rate):
                self.rate = rate
            case ListControllers():
                return tuple(robot.manager.list())
            case GetParameters(controller=name):
                return robot.manager.parameters(name)
            case SetParameters(controller=name, values=values):
                robot.manager.set_parameters(name, values)
            case _:
                raise AssertionError(request)
        return Done()

    def messages(self, timeout=None):
        while timeout and self.rate:
            self.states += 1
            self.on_state(self.states)
            self.bench.run(20)
            self.bench.look()
            yield state_sample(self.bench.robot)


class InventedBase:
    """A base by its formulas alone, which drives exact squares by its odometry; in the place of a BaseLink."""

    controller = BASE

    def __init__(self, *, left=1.0, right=1.0, track=1.0, simulated=True):
        self.true, self.factors, self.simulated = (track, left, right), (1.0, 1.0, 1.0), simulated
        self.driven = 0

    def wheel_values(self):
        return WheelValues(0.24 * self.factors[0], self.factors)

    def set_factors(self, factors):
        self.factors = factors

    def true_pose(self):
        return TruePose(time=0.0, x=0.0, y=0.0, heading=0.0) if self.simulated else None

    def drive(self, path):
        self.driven += 1
        sign = path.direction.value
        track, left, right = (true / factor for true, factor in zip(self.true, self.factors, strict=True))
        separation = 0.24 * self.factors[0]
        x = y = heading = 0.0
        for _ in range(4):
            for ways in ((path.side, path.side), (-sign * math.pi / 4 * separation, sign * math.pi / 4 * separation)):
                way, turn = (ways[0] * left + ways[1] * right) / 2, ways[1] * right - ways[0] * left
                turn /= separation * track
                chord = way * (math.sin(turn / 2) / (turn / 2) if turn else 1.0)
                x += chord * math.cos(heading + turn / 2)
                y += chord * math.sin(heading + turn / 2)
                heading += turn
        return Driven((0.0, 0.0, sign * math.tau), (x, y, heading) if self.simulated else None)
