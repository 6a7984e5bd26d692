"""Limits and commands of the golden vectors of joint limiters."""

from __future__ import annotations

from typing import Any

from support.control import vectors

from canopen_control.controllers.limiters import NOTHING, QUANTITIES
from canopen_control.urdf.joint_element import HardLimits


def limiter_cases(kind: str) -> list[Any]:
    """Return the cases of a limiter of one joint, `saturation` or `soft`."""
    return [vector for vector in vectors("joint_limiter", "joint_limits.json") if vector["in"]["kind"] == kind]


def hard(values: dict[str, float]) -> HardLimits:
    return HardLimits(**values)


def quantities(values: dict[str, float]) -> list[float]:
    result = list(NOTHING)
    for name, value in values.items():
        result[QUANTITIES.index(name)] = value
    return result


def expect_as_recorded(limiter: Any, case: dict[str, Any]) -> None:
    """Do the steps of a case, and assert what it expects of each."""
    for step, expected_result in zip(case["in"]["steps"], case["expect"]["steps"], strict=True):
        if step == ["reset"]:
            limiter.reset()
            continue
        actual, desired = quantities(step[0]), quantities(step[1])
        if "error" in expected_result:
            assert expected_result["error"] == "position_out_of_bounds"
            with_error(limiter, actual, desired, step[2])
            continue
        assert limiter.enforce(actual, desired, step[2]) is expected_result["limited"], (case["name"], step)
        expected = quantities(expected_result["command"])
        for result, value in zip(desired, expected, strict=True):
            same = result != result or abs(result - value) <= case["tolerance"] * max(1.0, abs(value))
            assert same, (case["name"], step, desired, expected)
            assert (result != result) == (value != value)


def with_error(limiter: Any, actual: list[float], desired: list[float], period: float) -> None:
    import pytest

    from canopen_control.errors import ControlError

    with pytest.raises(ControlError, match="outside its range"):
        limiter.enforce(actual, desired, period)
