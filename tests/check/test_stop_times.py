"""How long an axis takes to stand, by hand-computed examples."""

import math

import pytest

from canopen_control.check.stop_times import AxisFacts, stop_time

OBJECTS = {0x6084: 2000, 0x6085: 5000, 0x6007: 3, 0x605A: 2, 0x605E: 2}


def facts(**more):
    inputs = {
        "joint": "left_wheel",
        "node": "left_drive",
        "node_id": 3,
        "speed": 1000.0,
        "cycle_s": 0.02,
        "silence_s": 0.5,
        "data_s": 0.06,
        "master_s": 0.3,
        "objects": OBJECTS,
        "lives": {"forward": 0.6},
    }
    return AxisFacts(**{**inputs, **more})


def case(cause, **more):
    return next(item for item in stop_time(facts(**more)).cases if cause in item.cause)


@pytest.mark.parametrize(
    ("cause", "detection", "ramp"),
    [
        ("requested", 0.02, 0.5),  # a cycle; 1000 / 2000
        ("forward", 0.62, 0.5),
        ("is silent", 0.52, 0.5),
        ("TPDOs", 0.08, 0.5),
        ("master", 0.3, 0.2),  # the quick stop ramp: 1000 / 5000
        ("fault", 0.0, 0.2),
    ],
)
def test_each_reason_has_its_detection_and_its_ramp(cause, detection, ramp):
    result = case(cause)
    assert (result.detection_s, result.ramp_s) == (pytest.approx(detection), pytest.approx(ramp))
    assert result.total_s == pytest.approx(detection + ramp)


def test_the_longest_is_the_sum_of_the_reason_that_takes_longest():
    result = stop_time(facts())
    assert result.longest_s == pytest.approx(0.62 + 0.5)
    assert result.words == (
        "stop of left_wheel (left_drive): 1.120 s at most from 1000 units/s: "
        "the command of forward ends 0.620 s, ramp of 0x6084 (2000) 0.500 s"
    )


def test_a_joint_with_the_name_of_its_node_is_named_once():
    assert stop_time(facts(joint="lift", node="lift")).words.startswith("stop of lift: ")


@pytest.mark.parametrize(
    ("objects", "ramp", "by"),
    [
        ({0x6007: 1}, 0.2, "ramp of 0x6085 (5000)"),  # a fault, then 0x605E
        ({0x6007: 1, 0x605E: 1}, 0.5, "ramp of 0x6084 (2000)"),
        ({0x6007: 3, 0x605A: 6}, 0.2, "ramp of 0x6085 (5000)"),
        ({0x6007: 3, 0x605A: 1}, 0.5, "ramp of 0x6084 (2000)"),
        ({0x6007: 3, 0x605A: 0}, math.inf, "0x605A is 0, which means: drive function off, the motor coasts"),
        ({0x6007: 3, 0x605A: -1}, math.inf, "0x605A is -1, which is manufacturer-specific"),
        ({0x6007: 0}, math.inf, "0x6007 is 0, a reaction without a ramp"),
        ({0x6007: 2}, math.inf, "0x6007 is 2, a reaction without a ramp"),
        ({0x6085: 0}, math.inf, "0x6085 is unknown"),
    ],
)
def test_the_drive_stops_according_to_its_option_code_when_the_master_is_lost(objects, ramp, by):
    result = case("master", objects=OBJECTS | objects)
    assert (result.ramp_s, result.by) == (ramp, by)


def test_without_a_deceleration_the_master_ramps_half_a_second():
    result = case("requested", objects={})
    assert (result.ramp_s, result.by) == (0.5, "the master's ramp")


def test_a_stop_that_nothing_bounds_reports_what_does_not():
    assert stop_time(facts(objects=OBJECTS | {0x6007: 0})).words == (
        "stop of left_wheel (left_drive): no limit if the master is silent: 0x6007 is 0, a reaction without a ramp"
    )
    assert stop_time(facts(speed=math.inf)).words.endswith(
        "the command of forward ends 0.620 s, then ramp of 0x6084 (2000) from an unlimited speed"
    )


@pytest.mark.parametrize(("ramp", "slow"), [(101, None), (99, 1000 / 99), (0, None)])
def test_a_ramp_is_slow_if_the_quick_stop_comes_before_its_end(ramp, slow):
    result = stop_time(facts(objects=OBJECTS | {0x6084: ramp})).slow_ramp
    assert (result and result.ramp_s) == (slow and pytest.approx(slow))


@pytest.mark.parametrize(
    ("brake", "ramp", "by"), [(0.4, 0.5, "ramp of 0x6084 (2000)"), (3.0, 3.0, "its deceleration limit")]
)
def test_a_controller_that_brakes_slower_than_the_drive_determines_the_end_of_its_command(brake, ramp, by):
    result = case("forward", brakes={"forward": brake})
    assert (result.ramp_s, result.by) == (pytest.approx(ramp), by)
    assert case("requested", brakes={"forward": brake}).ramp_s == pytest.approx(0.5)
