from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import same, vectors

from canopen_control.controllers.limiters import NAN, RateLaw, RateLimiter, VelocityLimits

UPSTREAM = {
    "min_value": "min_velocity",
    "max_value": "max_velocity",
    "min_first_derivative_neg": "max_acceleration_reverse",
    "max_first_derivative_pos": "max_acceleration",
    "min_first_derivative_pos": "max_deceleration",
    "max_first_derivative_neg": "max_deceleration_reverse",
    "min_second_derivative": "min_jerk",
    "max_second_derivative": "max_jerk",
}


def limits(params: dict[str, float]) -> VelocityLimits:
    return VelocityLimits(**{UPSTREAM[key]: float(value) for key, value in params.items()})


@pytest.mark.parametrize("case", vectors("rate_limiter_upstream") + vectors("rate_limiter_edges"))
def test_it_limits_as_upstream_does(case):
    limiter = RateLaw(limits(case["params"]))
    v, v0, v1, dt = (case[key] for key in ("v", "v0", "v1", "dt"))
    result = {
        "limit": lambda: limiter.limit(v, v0, v1, dt),
        "limit_value": lambda: limiter.limit_velocity(v),
        "limit_first_derivative": lambda: limiter.limit_acceleration(v, v0, dt),
        "limit_second_derivative": lambda: limiter.limit_jerk(v, v0, v1, dt),
    }[case["call"]]()
    assert same(result, case["expect_v"], 1e-12)


@pytest.mark.parametrize("case", vectors("rate_limiter_ctor"))
def test_it_refuses_what_upstream_refuses(case):
    if case["expect_error"] is None:
        assert RateLaw(limits(case["params"]))
    else:
        with pytest.raises(ValueError, match=case["expect_error"]):
            RateLaw(limits(case["params"]))


POSITIVE = st.one_of(st.just(math.nan), st.floats(0.0, 50.0))
NEGATIVE = POSITIVE.map(lambda value: -value)
COMMANDS = st.lists(st.floats(-1e6, 1e6) | st.sampled_from([math.inf, -math.inf]), min_size=1, max_size=30)
LIMITS = st.builds(VelocityLimits, NEGATIVE, POSITIVE, NEGATIVE, POSITIVE, NEGATIVE, POSITIVE, NEGATIVE, POSITIVE)


def outputs(given_limits: VelocityLimits, commands: list[float], dt: float) -> list[float]:
    """Return what comes out, from rest, two zeros first."""
    limiter, out = RateLaw(given_limits), [0.0, 0.0]
    for command in commands:
        out.append(limiter.limit(command, out[-1], out[-2], dt))
    return out


@given(LIMITS, COMMANDS, st.floats(1e-4, 1.0))
def test_no_velocity_limit_is_ever_exceeded(given_limits, commands, dt):
    out = outputs(given_limits, commands, dt)
    if not math.isnan(given_limits.max_velocity):
        low = given_limits.min_velocity if not math.isnan(given_limits.min_velocity) else -given_limits.max_velocity
        assert all(low <= value <= given_limits.max_velocity for value in out[2:])


@given(LIMITS, COMMANDS, st.floats(1e-4, 1.0))
def test_no_acceleration_limit_is_ever_exceeded(given_limits, commands, dt):
    up = given_limits.max_acceleration
    if math.isnan(up):
        return

    def other(value: float, default: float) -> float:
        return default if math.isnan(value) else value

    reverse = other(given_limits.max_acceleration_reverse, -up)
    down, down_reverse = other(given_limits.max_deceleration, reverse), other(given_limits.max_deceleration_reverse, up)
    out = outputs(given_limits, commands, dt)
    for before, value in itertools.pairwise(out[1:]):
        low, high = (down if before > 0 else reverse) * dt, (down_reverse if before < 0 else up) * dt
        slack = 1e-9 * (1.0 + abs(value) + abs(before))
        assert low - slack <= value - before <= high + slack


@given(st.floats(0.0, 50.0), COMMANDS, st.floats(1e-4, 1.0))
def test_no_jerk_limit_is_ever_exceeded_while_a_step_grows(jerk, commands, dt):
    out = outputs(VelocityLimits(max_jerk=jerk), [command for command in commands if math.isfinite(command)], dt)
    for v1, v0, value in zip(out, out[1:], out[2:], strict=False):
        step, before = value - v0, v0 - v1
        if (step - before) * step > 0.0:
            assert abs(step - before) <= jerk * dt * dt + 1e-9 * (1.0 + abs(value) + abs(v0) + abs(v1))


def test_without_limits_nothing_is_changed():
    assert RateLaw(VelocityLimits()).limit(math.inf, 0.0, 0.0, 0.01) == math.inf
    assert RateLaw(VelocityLimits(max_deceleration=-1.0)).limit(7.0, 0.0, 0.0, 0.01) == 7.0


def test_the_jerk_limit_of_older_distributions_is_another_one():
    # humble bounds by jerk * 2 * dt^2 and always; ours is jazzy's jerk * dt^2, while the step grows: a smoother start
    limiter = RateLaw(VelocityLimits(max_jerk=5.0))
    assert same(limiter.limit(1.0, 0.0, 0.0, 0.1), 5.0 * 0.1**2)


HUMBLE = [
    case
    for case in vectors("speed_limiter_humble")
    if "expect_error" not in case and not case["params"]["has_jerk_limits"]
]


@pytest.mark.parametrize("case", HUMBLE)
def test_an_older_file_limits_alike_with_min_acceleration_as_the_reverse_one(case):
    params, off = case["params"], math.nan
    velocity, acceleration = params["has_velocity_limits"], params["has_acceleration_limits"]
    limiter = RateLaw(
        VelocityLimits(
            min_velocity=params["min_velocity"] if velocity else off,
            max_velocity=params["max_velocity"] if velocity else off,
            max_acceleration_reverse=params["min_acceleration"] if acceleration else off,
            max_acceleration=params["max_acceleration"] if acceleration else off,
        )
    )
    assert same(limiter.limit(case["v"], case["v0"], case["v1"], case["dt"]), case["expect_v"], 1e-12)


IMPOSSIBLE = [case for case in vectors("speed_limiter_humble") if "expect_error" in case]
JERKY = [
    case for case in vectors("speed_limiter_humble") if "expect_error" not in case and case["params"]["has_jerk_limits"]
]


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_a_limit_that_is_on_without_a_number_is_off_where_older_ones_refuse_to_start(case):
    params = case["params"]
    velocity_limits = VelocityLimits(max_velocity=params["max_velocity"], max_acceleration=params["max_acceleration"])
    assert math.isfinite(RateLaw(velocity_limits).limit(case["v"], case["v0"], case["v1"], case["dt"]))


@pytest.mark.parametrize("case", JERKY)
def test_jerk_is_limited_at_least_as_gently_as_in_older_distributions(case):
    """Ours is jazzy's j * dt^2 where humble had 2 * j * dt^2: a step that grows never grows more than humble's did."""
    params, dt = case["params"], case["dt"]
    if math.isnan(params["max_jerk"]):
        return
    limiter = RateLaw(VelocityLimits(max_jerk=params["max_jerk"], min_jerk=params["min_jerk"]))
    result = limiter.limit_jerk(case["v"], case["v0"], case["v1"], dt)
    step, before = result - case["v0"], case["v0"] - case["v1"]
    if (case["v"] - case["v0"] - before) * (case["v"] - case["v0"]) > 0.0:
        low = params["min_jerk"] if not math.isnan(params["min_jerk"]) else -params["max_jerk"]
        assert 2 * low * dt * dt - 1e-9 <= step - before <= 2 * params["max_jerk"] * dt * dt + 1e-9


def test_a_limiter_of_several_numbers_begins_at_rest_or_where_they_are_and_keeps_two_commands():
    limiter = RateLimiter((0.0, NAN))
    laws = limiter.laws = [RateLaw(VelocityLimits(max_jerk=5.0)) for _ in range(2)]
    expected = [(0.0, 0.0), (3.0, 3.0)]  # last and earlier of each
    for _ in range(5):
        desired = [9.0, 9.0]
        assert limiter.enforce([7.0, 3.0], desired, 0.1)
        expected_result = [law.limit(9.0, *history, 0.1) for law, history in zip(laws, expected, strict=True)]
        assert desired == expected_result
        limiter.step([7.0, 3.0], desired)
        assert limiter.last == expected_result
        # the first command of a number that began where it was is its whole history
        first = math.isnan(limiter._earlier[1])
        expected = [
            (expected_result[0], expected[0][0]),
            (expected_result[1], expected_result[1] if first else expected[1][0]),
        ]
    limiter.reset()
    assert limiter.last[0] == 0.0
    assert math.isnan(limiter.last[1])


def test_a_number_that_is_not_a_command_stays_with_its_history():
    limiter = RateLimiter((0.0, NAN))
    desired = [math.nan, math.nan]
    assert not limiter.enforce([1.0, 0.4], desired, 0.1)
    limiter.step([1.0, 0.4], desired)
    assert math.isnan(desired[0])
    assert limiter.last == [0.0, 0.4]


@pytest.mark.parametrize(
    ("limits", "name"),
    [
        ({"max_velocity": 0.0}, "max_velocity"),
        ({"max_velocity": 0.0, "min_velocity": -1.0}, ""),
        ({"max_acceleration": 0.0, "max_deceleration": -1.0, "max_deceleration_reverse": 1.0}, "max_acceleration"),
        ({"max_acceleration": 1.0}, ""),
        ({"max_jerk": 0.0}, "max_jerk"),
        ({}, ""),
    ],
)
def test_a_limit_that_permits_no_motion_is_named(limits, name):
    assert RateLaw(VelocityLimits(**limits)).immobile == name


@pytest.mark.parametrize(
    ("limits", "names"),
    [
        ({"max_velocity": 0.0, "min_velocity": -1.0}, ("max_velocity", "")),
        ({"max_velocity": 1.0, "min_velocity": 0.0}, ("", "min_velocity")),
        (
            {"max_velocity": 0.0, "max_acceleration": 1.0, "max_acceleration_reverse": 0.0},
            ("max_velocity", "min_velocity"),
        ),
        ({"max_acceleration": 0.0, "max_acceleration_reverse": -1.0}, ("max_acceleration", "")),
        ({"max_jerk": 1.0, "min_jerk": 0.0}, ("", "min_jerk")),
        ({"max_velocity": 1.0}, ("", "")),
    ],
)
def test_a_limit_that_permits_motion_in_one_direction_is_named_for_the_other(limits, names):
    forward, backward = RateLaw(VelocityLimits(**limits)).blocked
    assert (forward, backward) == names
