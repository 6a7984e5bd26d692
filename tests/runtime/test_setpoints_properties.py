"""Set-points that arrive smoothly: six axes on a trajectory, and a host that is late, at 100 and 250 Hz."""

import contextlib
import functools
import itertools
import random

import pytest
from canopen_control_bench.arm import ENDS, NODES, arm_at
from canopen_control_bench.simulated_arm import MS, SimulatedArm

MAX_LATE = 2 * MS
THERE = [0.3 * each for each in ENDS]
OTHER = "\n  sync_producer: other\n  sync_order: first"


@pytest.fixture
def arms():
    with contextlib.ExitStack() as created:

        def make(*args, late=lambda: 0, **how):
            arm = created.enter_context(contextlib.closing(SimulatedArm(*args, **how)))
            arm.late = late
            arm.run(100)
            return arm

        yield make


def play(arm, missed=0):
    """Follow a trajectory and return what each drive has got at each SYNC, from its begin to its end."""
    arm.measure_anew()
    arm.play(THERE, 0.6)
    assert arm.robot.pacer.missed <= missed
    return {node: arm.taken(node) for node in NODES}


def ripple(points):
    """Return the standard deviation of the second differences of what a drive got: its acceleration."""
    differences = [c - 2 * b + a for a, b, c in zip(points, points[1:], points[2:], strict=False)]
    mean = sum(differences) / len(differences)
    return (sum((difference - mean) ** 2 for difference in differences) / len(differences)) ** 0.5


def moving(points):
    """Return the part of a motion between its ends."""
    first = next(place for place, value in enumerate(points) if value != points[0])
    last = next(place for place, value in enumerate(reversed(points)) if value != points[-1])
    return points[first : len(points) - last]


def jitter(seed):
    chance = random.Random(seed)
    return lambda: round(chance.random() * MAX_LATE)


@pytest.fixture(scope="module")
def calm(tmp_path_factory):
    """Return what gives the set-points of a host that is never late, and what its drives say, by rate and SYNC."""

    @functools.cache
    def of(hertz, keys=""):
        config = arm_at(tmp_path_factory.mktemp("calm"), hertz, keys)
        with contextlib.closing(SimulatedArm(f"calm{hertz}{bool(keys)}", config, own_sync=not keys)) as arm:
            arm.run(100)
            taken = play(arm)
            return {node: ([points for (points,) in taken[node]], arm.quality(node)) for node in NODES}

    return of


@pytest.mark.parametrize(("hertz", "order"), [(100, "last"), (250, "first")])
def test_a_late_host_sends_the_set_points_of_the_grid_each_once(arms, calm, tmp_path, hertz, order):
    config = arm_at(tmp_path, hertz, f"\n  sync_order: {order}")
    late = play(arms(f"late{order}{hertz}", config, late=jitter(hertz)))
    for node in NODES:
        assert {len(item) for item in late[node]} == {1}, "none lost, none doubled"
        got = [points for (points,) in late[node]]
        sent, expected = moving(got), moving(calm(hertz)[node][0])
        count = min(len(sent), len(expected))
        assert abs(len(sent) - len(expected)) <= 1, "one may lie before the first SYNC that was looked at"
        assert sent[-count:] == expected[-count:], "to the count what a host that is never late sends"


@pytest.mark.parametrize("hertz", [100, 250])
def test_behind_the_sync_of_a_node_at_200_ppm_a_late_host_loses_and_doubles_none(arms, calm, tmp_path, hertz):
    arm = arms(f"lateother{hertz}", arm_at(tmp_path, hertz, OTHER), own_sync=False, late=jitter(hertz))
    late = play(arm)
    for node in NODES:
        assert {len(item) for item in late[node]} == {1}, "none lost, none doubled"
        assert arm.joint(node).tracking.skipped == 0
        quality, (expected, calm_quality) = arm.quality(node), calm(hertz, OTHER)[node]
        assert (quality.missed, quality.doubled, quality.overwritten) == (0, 0, 0)
        assert quality.acceleration_ripple <= 1.1 * calm_quality.acceleration_ripple, "of what the motor is to do"
        assert ripple(moving([points for (points,) in late[node]])) <= 1.1 * ripple(moving(expected))


def test_one_set_point_for_each_wake_up_is_what_makes_a_drive_vibrate(arms, calm, tmp_path):
    arm = arms("otherway", arm_at(tmp_path, 250), late=jitter(7))
    arm.command_by_wake_up()
    other = play(arm)
    for node in NODES:
        got = [points for (points,) in other[node]]
        assert ripple(moving(got)) > 10 * ripple(moving(calm(250)[node][0]))


def test_a_cycle_that_is_too_late_for_the_sync_of_a_node_is_reported_each_joint(arms, tmp_path):
    late = iter([0] * 60 + [4 * MS] + [0] * 1000)
    config = arm_at(tmp_path, 250, "\n  sync_producer: other")
    arm = arms("tolate", config, own_sync=False, late=lambda: next(late))
    taken = play(arm, missed=1)
    for node in NODES:
        lost = sum(not item for item in taken[node])
        assert lost >= 1
        assert arm.joint(node).tracking.skipped == lost


@pytest.mark.parametrize("order", ["first", "last"])
def test_a_run_reports_how_well_the_joints_followed_and_that_no_set_point_was_missed(arms, tmp_path, order):
    arm = arms(f"told{order}", arm_at(tmp_path, 100, f"\n  sync_order: {order}"), late=jitter(3))
    taken = play(arm)
    for joint in arm.robot.joints.values():
        figures = joint.tracking.figures()
        assert (figures.repeated, figures.skipped) == (0, 0)
        assert 0.0 < figures.rms <= figures.worst == figures.worst_since_enable < 0.02
    quick = max(abs(b[0] - a[0]) for a, b in itertools.pairwise(taken[2]))
    assert figures.worst < 0.5 * quick / 1043037.8, (
        "less than the way of a cycle: the dead time of the bus is not an error"
    )
