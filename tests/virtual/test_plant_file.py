from __future__ import annotations

import math
import sys

import pytest
from support.virtualbench import Bench, S, servo_od

from canopen_control.rpc.messages.drive import WorldState
from canopen_control.virtual.device import make_device
from canopen_control.virtual.plant import IdealPlant, LagPlant, LoadedPlant
from canopen_control.virtual.plant_file import WorldError, read_world
from canopen_control.virtual.shaft import WheelPlant
from canopen_control.virtual.trajectory import hold, move_to

BASE = """
base: {left: 5, right: 6, wheel_radius: 0.1, wheel_separation: 0.4, counts_per_revolution: 1000, reversed: [right]}
"""
METRES = 0.2 * 3.141592653589793 / 1000


def world(tmp_path, text):
    path = tmp_path / "plant.yml"
    path.write_text(text)
    return read_world(path)


def test_each_axis_has_the_plant_that_the_file_specifies(tmp_path):
    created = world(
        tmp_path,
        """
        default: {kind: lag, time_constant: 0.2}
        axes:
          "3": {torque_limit: 800, inertia: 2.0, friction: 30, external: -50, backlash: 20, stalled: true}
          "3/1": {kind: ideal}
        """,
    )
    loaded = created.plant(3, 0)
    assert isinstance(loaded, LoadedPlant)
    assert (loaded.torque_limit, loaded.inertia, loaded.friction, loaded.external) == (800, 2.0, 30, -50)
    assert (loaded.backlash, loaded.stalled) == (20, True)
    assert isinstance(created.plant(3, 1), IdealPlant)
    lag = created.plant(4, 0)
    assert isinstance(lag, LagPlant)
    assert lag.time_constant == 0.2


def test_an_empty_file_leaves_every_axis_ideal(tmp_path):
    created = world(tmp_path, "")
    assert isinstance(created.plant(3, 0), IdealPlant)
    assert (created.describe(), created.period_ns) == (WorldState(), None)
    created.close()


@pytest.mark.parametrize("share", [False, True])
def test_two_drives_move_the_base_they_are_wheels_of(tmp_path, share):
    text = BASE.replace("]}", f"], share: {tmp_path}/floor}}") if share else BASE
    worlds = [world(tmp_path, text) for _ in range(2 if share else 1)]
    left, right = (
        Bench(make_device(servo_od(node_id), node_id, plant=lambda axis, w=w, n=node_id: w.plant(n, axis)))
        for node_id, w in ((5, worlds[0]), (6, worlds[-1]))
    )
    assert isinstance(left.drive.mover.plant, WheelPlant)
    for bench, speed in ((left, 1000), (right, -1000)):
        bench.enable(3)
        bench.write(0x60FF, speed)
    for _ in range(50):
        left.on(0.02)
        right.on(0.02)
    for item in worlds:
        item.describe()
    pose = worlds[0].describe().base
    way = left.drive.mover.plant.position * METRES
    assert pose.x == pytest.approx(way, abs=1000 * METRES * 0.005)  # to the last point of the grid
    assert (pose.y, pose.heading) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert pose.time_ns == pytest.approx(2 * S, abs=5e6)
    assert right.number(0x6064, signed=True) == -left.number(0x6064, signed=True)
    for item in worlds:
        item.close()


def test_each_wheel_may_have_a_radius_of_its_own(tmp_path):
    created = world(tmp_path, BASE.replace("reversed", "left_wheel_radius: 0.11, reversed"))
    wheels = [created.plant(node_id, 0) for node_id in (5, 6)]
    for wheel in wheels:
        wheel.follow(hold(0, 0.0), 0, S)  # the first point is where it begins
        wheel.follow(move_to(S, 0.0, 0.0, 1000.0, 1000.0, 1e9, 1e9), S, 3 * S)
    created.describe()
    ways = [wheel._distance for wheel in wheels]
    assert ways == pytest.approx([0.11 * math.tau, -0.1 * math.tau])
    assert created.describe().base.heading == pytest.approx((ways[1] - ways[0]) / 0.4)


def test_a_wheel_has_the_plant_of_its_axis_inside(tmp_path):
    created = world(tmp_path, BASE + 'axes: {"5": {kind: loaded, inertia: 3.0}}\n')
    assert created.plant(5, 0).inner.inertia == 3.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('axes: {"3": {kind: lag, inertia: 2}}', "a plant of kind lag has no inertia"),
        ('axes: {"x": {kind: lag}}', "'x' is not an axis"),
        ('axes: {"300": {kind: lag}}', "'300' is not an axis"),
        ('axes: {"3/9": {kind: lag}}', "'3/9' is not an axis"),
        ('axes: {"3": {kind: rubber}}', "rubber"),
        ('axes: {"3": {kind: lag, time_constant: 0}}', "time_constant"),
        (BASE.replace("right: 6", "right: 5"), "must be different nodes"),
        (BASE.replace("wheel_radius: 0.1, ", ""), "wheel_radius"),
        ("engine: none.of.that:make", "cannot be used"),
        ("engine: json", "cannot be used"),
        ("engine: json:nothing", "cannot be used"),
        ("bass: {}", "bass"),
    ],
)
def test_errors_are_reported_with_their_line(tmp_path, text, words):
    with pytest.raises(WorldError, match=words):
        world(tmp_path, text)


def test_another_engine_can_replace_ours(tmp_path, monkeypatch):
    (tmp_path / "engine_of_test.py").write_text(
        "from canopen_control.virtual.plant import IndependentPlants\n"
        "class Engine(IndependentPlants):\n    def __init__(self, path): self.path = path\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    created = world(tmp_path, "engine: engine_of_test:Engine\nsprings: [1, 2]\n")
    assert created.path == tmp_path / "plant.yml"
    assert isinstance(created.plant(3, 0), IdealPlant)
    del sys.modules["engine_of_test"]
