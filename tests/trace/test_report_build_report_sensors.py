"""What a report says of sensors, batteries, outputs and grippers: the samples are those that controllers tell."""

import pytest
from msgspec.structs import replace

from canopen_control.rpc.messages.samples import (
    BatteriesSample,
    BatteryReading,
    GpioSample,
    GripperSample,
    ImuSample,
    JointStatesSample,
    PoseSample,
    RangeSample,
    WrenchSample,
)
from canopen_control.rpc.messages.state import StateSample, TimedSnapshot
from canopen_control.trace.flight_file import NO_FAULT, FlightFile, FlightMeta
from canopen_control.trace.report_build import facts_of, measured
from canopen_control.trace.report_page import page_of

SAMPLES = {
    "imu": ImuSample(time=1.0, frame_id="i", orientation=(0.0, 0.0, 0.6, 0.8), angular_velocity=(None, None, 0.5),
                     linear_acceleration=(None, None, 9.81)),
    "front": RangeSample(time=1.0, frame_id="f", range=1.25),
    "wrist": WrenchSample(time=1.0, frame_id="w", force=(1.0, None, None), torque=(None, None, 0.25)),
    "gps": PoseSample(time=1.0, frame_id="m", position=(1.0, 2.0, 3.0), orientation=(None,) * 4),
    "power": BatteriesSample(time=1.0, batteries=[BatteryReading(name="main", voltage=24.5, percentage=0.5)],
                             together=BatteryReading(name="")),
    "io": GpioSample(time=1.0, parts={"box": {"lamp": 1.0, "pressed": None}}),
    "gripper": GripperSample(time=1.0, joint="finger", position=0.01, velocity=0.0, effort=None, target=0.04,
                             executing=True, stalled=False, reached_goal=False),
    "states": JointStatesSample(time=1.0, names=("a",), joints={"a": {"position": 1.0}}),
}  # fmt: skip


def test_each_kind_has_its_values_with_their_units():
    rows = {(each.controller, each.what): (each.unit, each.last) for each in measured([StateSample(samples=SAMPLES)])}
    assert rows == {
        **{("imu", f"orientation.{axis}"): ("", value) for axis, value in zip("xyzw", (0, 0, 0.6, 0.8), strict=True)},
        ("imu", "angular_velocity.z"): ("rad/s", 0.5),
        ("imu", "linear_acceleration.z"): ("m/s²", 9.81),
        ("front", "range"): ("m", 1.25),
        ("wrist", "force.x"): ("N", 1.0),
        ("wrist", "torque.z"): ("Nm", 0.25),
        **{("gps", f"position.{axis}"): ("m", value) for axis, value in zip("xyz", (1.0, 2.0, 3.0), strict=True)},
        ("power", "main voltage"): ("V", 24.5),
        ("power", "main percentage"): ("", 0.5),
        ("io", "box/lamp"): ("", 1.0),
        ("gripper", "finger position"): ("rad or m", 0.01),
        ("gripper", "finger target"): ("rad or m", 0.04),
    }


def ranges(*values):
    samples = (RangeSample(time=float(at), frame_id="f", range=value) for at, value in values)
    return [StateSample(time=each.time, samples={"front": each}) for each in samples]


def test_the_least_the_most_and_the_last_are_of_all_publications_and_what_is_not_known_counts_as_nothing():
    (row,) = measured(ranges((1, 2.0), (2, 0.5), (3, None), (4, 1.5)))
    assert (row.least, row.most, row.last) == (0.5, 2.0, 1.5)
    assert measured(ranges((1, None))) == []
    assert measured([TimedSnapshot(time=1.0)]) == []


def test_a_publication_that_two_samples_show_counts_once():
    first, second = ranges((1, 2.0), (1, 3.0))
    assert measured([first, second])[0].last == 2.0


@pytest.fixture
def file():
    meta = FlightMeta(robot="r", reason=NO_FAULT)
    return FlightFile(meta, states=ranges((1, 2.0), (2, 0.5)))


def test_a_report_has_them_in_its_facts_and_on_its_page(file):
    facts = facts_of(file)
    assert [(each.controller, each.least) for each in facts.measured] == [("front", 0.5)]
    page = page_of(facts)
    assert ">Measured<" in page
    assert ">front<" in page
    assert ">Measured<" not in page_of(replace(facts, measured=()))
