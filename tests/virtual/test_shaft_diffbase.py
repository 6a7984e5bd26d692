"""The pose of a base, against the closed forms of straight lines and circles, and against a fine integration."""

from __future__ import annotations

import math
import os
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import astuple

from canopen_control.errors import ConfigError
from canopen_control.host.sockets import runtime_dir
from canopen_control.virtual.shaft import LEFT, RIGHT, DiffBase, SharedBase, open_shared, shared_path, slipped

MS, S = 1_000_000, 1_000_000_000
SEPARATION = 0.4


def drive(base, left, right, seconds=1.0, step_ms=5):
    """Let both wheels go with constant speeds in m/s."""
    steps = round(seconds * 1000 / step_ms)
    for wheel, speed in ((LEFT, left), (RIGHT, right)):
        base.report(wheel, [(k * step_ms * MS, speed * k * step_ms / 1000) for k in range(steps + 1)])
    return base


def test_equal_wheels_go_straight():
    pose = drive(DiffBase(SEPARATION), 0.5, 0.5, 4.0).pose()
    assert (pose.x, pose.y, pose.heading) == pytest.approx((2.0, 0.0, 0.0))
    assert pose.time_ns == 4 * S


def test_opposite_wheels_turn_on_the_spot():
    pose = drive(DiffBase(SEPARATION), -0.2, 0.2, 3.0).pose()
    assert (pose.x, pose.y, pose.heading) == pytest.approx((0.0, 0.0, 3.0))


@pytest.mark.parametrize("step_ms", [1, 5, 250])
def test_unequal_wheels_go_along_a_circle_exactly_whatever_the_step(step_ms):
    left, right, seconds = 0.3, 0.7, 2.0
    pose = drive(DiffBase(SEPARATION), left, right, seconds, step_ms).pose()
    turn = (right - left) / SEPARATION * seconds
    radius = 0.5 * (left + right) * seconds / turn
    expected = (radius * math.sin(turn), radius * (1 - math.cos(turn)), turn)
    assert (pose.x, pose.y, pose.heading) == pytest.approx(expected, abs=1e-9)


def test_a_full_circle_comes_home():
    turn_s = 2 * math.pi * SEPARATION / 0.4
    base = DiffBase(SEPARATION)
    base.report(LEFT, [(0, 0.0), (round(turn_s * S), 0.3 * turn_s)])
    base.report(RIGHT, [(0, 0.0), (round(turn_s * S), 0.7 * turn_s)])
    assert (base.pose().x, base.pose().y) == pytest.approx((0, 0), abs=1e-6)


@given(st.lists(st.tuples(st.booleans(), st.integers(1, 30)), max_size=30))
def test_the_pose_does_not_depend_on_the_order_and_bundling_of_reports(bundles):
    points = [[(k * 5 * MS, math.sin(0.05 * k + wheel)) for k in range(200)] for wheel in (LEFT, RIGHT)]
    once, often = DiffBase(SEPARATION), DiffBase(SEPARATION)
    for wheel in (LEFT, RIGHT):
        once.report(wheel, points[wheel])
    rest = [list(points[LEFT]), list(points[RIGHT])]
    for side, count in bundles:
        often.report(int(side), rest[side][:count])
        del rest[side][:count]
    for wheel in (LEFT, RIGHT):
        often.report(wheel, rest[wheel])
    assert astuple(often.pose()) == pytest.approx(astuple(once.pose()), abs=1e-9)


def test_wheels_with_other_times_are_met_in_between():
    base = DiffBase(SEPARATION)
    base.report(LEFT, [(0, 0.0), (10 * MS, 1.0), (20 * MS, 2.0)])
    base.report(RIGHT, [(0, 0.0), (15 * MS, 1.5)])
    assert base.pose().time_ns == 15 * MS
    assert (base.pose().x, base.pose().heading) == pytest.approx((1.5, 0.0))


def test_a_wheel_that_is_not_received_for_ten_seconds_stands():
    base = DiffBase(SEPARATION)
    base.report(RIGHT, [(0, 0.0)])
    base.report(LEFT, [(0, 0.0), (1 * S, 0.1)])
    assert base.pose().time_ns == 0
    base.report(LEFT, [(11 * S, 0.25)])
    assert base.pose().time_ns == 11 * S
    assert base.pose().heading == pytest.approx(-0.25 / SEPARATION)


def test_points_out_of_order_are_ignored():
    base = drive(DiffBase(SEPARATION), 1.0, 1.0)
    before = base.pose()
    base.report(LEFT, [(5, 99.0)])
    assert base.pose() == before


def test_two_processes_share_one_floor_through_a_file(tmp_path):
    path = tmp_path / "floor"
    left, right = SharedBase(SEPARATION, path), SharedBase(SEPARATION, path)
    for k in range(0, 200, 4):
        left.report(LEFT, [((k + i) * 5 * MS, 0.3 * (k + i) * 0.005) for i in range(4)])
        right.report(RIGHT, [((k + i) * 5 * MS, 0.7 * (k + i) * 0.005) for i in range(4)])
    alone = drive(DiffBase(SEPARATION), 0.3, 0.7, 0.995)
    assert astuple(left.pose()) == pytest.approx(astuple(alone.pose()), abs=1e-9)
    assert right.pose() == left.pose()
    left.close()
    right.close()
    path.write_text("{half a fi")
    torn = SharedBase(SEPARATION, path)
    assert torn.pose().x == 0.0
    torn.close()
    torn.close()


def test_a_shared_file_that_cannot_be_opened_is_an_error_of_the_user(tmp_path):
    with pytest.raises(ConfigError, match="cannot be shared"):
        SharedBase(SEPARATION, tmp_path / "none" / "floor").pose()


def test_slip_is_the_same_for_a_seed_and_has_its_deviation():
    steps = [slipped(1.0, 0.05, 7, LEFT, k) - 1.0 for k in range(20_000)]
    assert steps == [slipped(1.0, 0.05, 7, LEFT, k) - 1.0 for k in range(20_000)]
    assert statistics.pstdev(steps) == pytest.approx(0.05, rel=0.02)
    assert statistics.fmean(steps) == pytest.approx(0.0, abs=0.002)
    assert steps != [slipped(1.0, 0.05, 8, LEFT, k) - 1.0 for k in range(20_000)]
    assert steps != [slipped(1.0, 0.05, 7, RIGHT, k) - 1.0 for k in range(20_000)]


def test_a_name_alone_is_a_file_in_the_private_folder(monkeypatch, tmp_path):
    tmp_path.chmod(0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path = shared_path("robby-floor")
    assert path.parent == runtime_dir()
    os.close(open_shared(path))
    assert path.stat().st_mode & 0o777 == 0o600
    assert shared_path(f"{tmp_path}/floor") == tmp_path / "floor"


@pytest.mark.parametrize("make", ["link", "open", "fifo"])
def test_a_file_that_another_user_may_have_put_there_is_refused(tmp_path, make):
    path = tmp_path / "floor"
    if make == "link":
        (tmp_path / "other").write_text("")
        path.symlink_to(tmp_path / "other")
    elif make == "fifo":
        os.mkfifo(path)
    else:
        path.write_text("")
        path.chmod(0o666)
    with pytest.raises(ConfigError, match=r"cannot be shared: .*private folder"):
        open_shared(path)
