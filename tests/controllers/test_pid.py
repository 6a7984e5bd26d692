import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import same
from support.trajectories import cases

from canopen_control.controllers.pid import AntiWindup, Gains, Pid

NAMES = {"antiwindup_strategy": "anti_windup", "tracking_time_constant": "tracking_time", "error_deadband": "deadband",
         "legacy_antiwindup": "clamp_integral"}  # fmt: skip


def gains(values) -> Gains:
    named = {NAMES.get(key, key): value for key, value in values.items()}
    return Gains(**{**named, "anti_windup": AntiWindup(named.get("anti_windup", "undefined"))})


def step(pid: Pid, verb, *values) -> float | None:
    if verb == "reset":
        return pid.reset(keep_integral=values[0])
    if verb == "gains":
        try:
            return pid.set_gains(gains(values[0]))
        except ValueError:  # refused; the old ones stay
            return None
    return pid.compute(*values) if verb == "e" else pid.compute_with_rate(*values)


@pytest.mark.parametrize("case", cases("pid"), ids=lambda case: case["name"])
def test_it_computes_as_control_toolbox_does(case):
    inputs, expect = case["in"], case["expect"]
    if expect["constructor"] != "ok":
        with pytest.raises(ValueError, match="u_min"):
            gains(inputs["gains"])
        return
    try:
        created = gains(inputs["gains"])
    except ValueError:
        assert expect["antiwindup_used"] == "undefined" or not any("u" in item for item in expect["steps"])
        return
    pid = Pid(created)
    assert same(created.tracking_time_used, expect["tracking_time_constant_used"], case["tolerance"])
    for each, expected in zip(inputs["steps"], expect["steps"], strict=True):
        if "error" in expected:
            with pytest.raises(ValueError, match="is negative"):
                step(pid, *each)
            continue
        command = step(pid, *each)
        result = {"u": command, "p_error": pid.error, "i_term": pid.integral, "d_error": pid.error_rate}
        for key, value in expected.items():
            if key in result:
                assert same(result[key], value, case["tolerance"]), (each, key, result[key], value)


FINITE = st.floats(-1e3, 1e3)


@given(st.lists(st.tuples(FINITE, st.floats(0.0, 1.0)), max_size=20), st.sampled_from(list(AntiWindup)))
def test_output_and_integral_never_leave_their_limits(steps, anti_windup):
    limits = {"u_min": -2.0, "u_max": 3.0, "i_min": -0.5, "i_max": 0.25}
    pid = Pid(Gains(2.0, 5.0, 0.1, anti_windup=anti_windup, **limits))
    for error, dt in steps:
        assert -2.0 <= pid.compute(error, dt) <= 3.0
        assert -0.5 <= pid.integral <= 0.25


def test_an_error_that_is_not_a_number_gives_none_and_the_next_one_continues():
    pid = Pid(Gains(2.0))
    assert math.isnan(pid.compute(math.nan, 0.1))
    assert pid.compute(1.0, 0.1) == 2.0


@pytest.mark.parametrize(
    "wrong", [{"u_min": 1.0, "u_max": 0.0}, {"u_max": math.nan}, {"i_min": 0.1}, {"i_max": -0.1},
              {"anti_windup": AntiWindup.BACK_CALCULATION, "tracking_time": -1.0}]
)  # fmt: skip
def test_gains_that_cannot_be_are_refused(wrong):
    with pytest.raises(ValueError, match=r"give|must include 0"):
        Gains(1.0, **wrong)


@pytest.mark.parametrize(
    ("i", "u_max", "integral"), [(1.0, math.inf, math.nan), (1.0, 0.5, -math.inf), (-1.0, 0.5, math.inf)]
)
def test_a_back_calculation_without_a_time_constant_raises_nothing(i, u_max, integral):
    pid = Pid(Gains(i=i, d=0.0, u_max=u_max, anti_windup=AntiWindup.BACK_CALCULATION))
    pid.integral = 1.0
    pid.compute(1.0, 0.1)
    assert same(pid.integral, integral)
