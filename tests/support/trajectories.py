"""Points and trajectories of the golden vectors, and how they are compared."""

from __future__ import annotations

from typing import Any

from support.control import same, vectors

from canopen_control.controllers.trajectory.point import JointTrajectory, Point

QUANTITIES = ("positions", "velocities", "accelerations", "effort")


def cases(group: str) -> list[Any]:
    """Return the cases of a group of the trajectories' vectors."""
    return vectors(group, "trajectories.json")


def point(values: dict[str, Any]) -> Point:
    return Point(*(values.get(key, ()) for key in QUANTITIES), time=values.get("t_ns", 0))


def message(values: dict[str, Any]) -> JointTrajectory:
    points = [point(value) for value in values.get("points", ())]
    return JointTrajectory(values.get("joint_names", ()), points, values.get("stamp_ns", 0))


def close(found: list[float], wanted: list[float], tolerance: float = 1e-9) -> bool:
    """Whether two vectors agree as the vectors' README says: |a-b| <= tolerance*max(1,|b|)."""
    return len(found) == len(wanted) and all(
        same(a, b, 0.0) or abs(a - b) <= tolerance * max(1.0, abs(b)) for a, b in zip(found, wanted, strict=True)
    )


def differences(found: Point, wanted: dict[str, Any], tolerance: float = 1e-9) -> dict[str, Any]:
    """Return the quantities of a point that are not as the vectors have them: (found, wanted) by name."""
    return {
        key: (getattr(found, key), wanted[key])
        for key in QUANTITIES
        if key in wanted and not close(getattr(found, key), wanted[key], tolerance)
    }
