"""One test of forward and diff-drive control, unchanged on mock hardware, simulated joints and virtual drives.

The virtual drives are on the memory bus in simulated time and, where a kernel has it, on SocketCAN in real time.
"""

import math

import pytest
from support.kernelbench import KernelBench
from support.robots import FORWARD, LEFT, RIGHT, Bench, copy_robby
from support.samples import state_dict

from canopen_control.errors import ControlError

BASE = "robby_base_controller"
PLUGIN = "canopen_ros2_control/RobotSystem"


SIMULATED = {"simulation": "canopen_control/SimulatedSystem", "Gazebo's plugin": "gz_ros2_control/GazeboSimSystem"}


KERNEL = "virtual drives on SocketCAN"
#: a guest with a kernel's CAN runs the last alone: the others are the same there, and slow
HARDWARE = [
    *(pytest.param(name, marks=pytest.mark.embedded) for name in ("mock", *SIMULATED, "virtual drives")),
    pytest.param(KERNEL, marks=pytest.mark.socketcan),
]


@pytest.fixture(params=HARDWARE)
def robot(request, tmp_path):
    """Return what starts robby with a controller, on each kind of hardware."""
    benches = []

    def start(controller):
        name = f"same{len(benches)}{abs(hash(request.node.nodeid)) % 10**8}"
        how = {"controllers": [controller]}
        if request.param == "mock":
            how |= {"mock": True, "drives": ()}
        elif request.param == KERNEL:
            benches.append(KernelBench(tmp_path, **how))
            benches[-1].start()
            return benches[-1]
        elif request.param != "virtual drives":
            plugin = (
                "canopen_control/SimulatedSystem"
                if request.param == "simulation"
                else "gz_ros2_control/GazeboSimSystem"
            )
            how |= {"config": copy_robby(tmp_path, description={PLUGIN: plugin}), "drives": ()}
        benches.append(Bench(name, **how))
        benches[-1].start()
        return benches[-1]

    assert (LEFT, RIGHT) == (3, 2)  # what the virtual drives are by default
    yield start
    for benche in benches:
        benche.close()


def wheels(bench, interface):
    return [bench.robot.registry.state(f"{side}_wheel_joint/{interface}").value for side in ("left", "right")]


def test_the_forward_controller_turns_the_wheels_as_commanded(robot):
    bench = robot(FORWARD)
    assert wheels(bench, "velocity") == pytest.approx([0.0, 0.0], abs=1e-6)
    bench.hold(10.0, -5.0, ms=1000)
    assert wheels(bench, "velocity") == pytest.approx([10.0, -5.0], rel=0.01)
    before = wheels(bench, "position")
    bench.hold(10.0, -5.0, ms=1000)
    moved = [(now - then) / bench.scale for now, then in zip(wheels(bench, "position"), before, strict=True)]
    assert moved == pytest.approx([10.0, -5.0], rel=0.02)
    for bad in ([math.nan, 1.0], [1.0], [1.0, math.inf]):
        with pytest.raises(ControlError):
            bench.command(*bad)
    bench.run(2600)  # no client commands any more: command_timeout
    assert wheels(bench, "velocity") == pytest.approx([0.0, 0.0], abs=0.05)
    assert bench.texts("command_timeout")


def test_deactivation_stops_the_wheels(robot):
    bench = robot(FORWARD)
    bench.hold(10.0, 10.0, ms=500)
    bench.robot.switch((), [FORWARD], strict=True)
    bench.run(1500)
    assert wheels(bench, "velocity") == pytest.approx([0.0, 0.0], abs=0.05)


def drive(bench, twist, seconds):
    for _ in range(round(seconds * 10)):
        bench.robot.command(BASE, twist, "test")
        bench.run(100)


def pose(bench):
    sample = state_dict(bench.robot)["samples"][BASE]
    return sample["x"], sample["y"], sample["heading"], sample["linear"], sample["angular"]


def test_the_base_goes_where_the_twist_commands(robot):
    bench = robot(BASE)
    drive(bench, [0.2, 0.0], 3.0)
    assert wheels(bench, "velocity") == pytest.approx([0.2 / 0.035] * 2, rel=0.01)
    assert pose(bench)[3] == pytest.approx(0.2, rel=0.01 + bench.jitter)
    bench.run(1500)  # cmd_vel_timeout, and the ramp of the limiter
    x, y, heading, linear, _ = pose(bench)
    # 2.9 s to the last command, half a second until the timeout, and what the brake makes up for what the start lost
    assert x == pytest.approx(0.2 * 3.4 * bench.scale, rel=0.03)
    assert (y, heading, linear) == pytest.approx((0.0, 0.0, 0.0), abs=5e-3)
    drive(bench, [0.0, 0.5], 2.0)
    bench.run(1500)
    assert pose(bench)[2] == pytest.approx(0.5 * 2.4 * bench.scale, rel=0.04)
    assert wheels(bench, "velocity") == pytest.approx([0.0, 0.0], abs=0.05)


def test_the_base_is_put_somewhere_else_and_continues_from_there(robot):
    bench = robot(BASE)
    bench.robot.manager.get(BASE).set_odometry(5.0, 6.0, math.pi / 2)
    drive(bench, [0.2, 0.0], 2.0)
    x, y, heading, *_ = pose(bench)
    assert x == pytest.approx(5.0, abs=0.01)
    assert -0.1 < y - 6.0 - 0.2 * 2.0 * bench.scale < 0.05
    assert heading == pytest.approx(math.pi / 2, abs=0.01)
