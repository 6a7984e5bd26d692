import typing

import pytest

from canopen_control.rpc.messages.samples import (
    BatteriesSample,
    BatteryReading,
    ControllerSample,
    DiagnosticsSample,
    DofReading,
    GpioSample,
    GripperSample,
    ImuSample,
    JointDiagnosis,
    JointStatesSample,
    MecanumSample,
    OdometrySample,
    PidSample,
    PoseSample,
    RangeSample,
    Sample,
    SteeringSample,
    TrajectoryPoint,
    TrajectorySample,
    WrenchSample,
    grown,
    kind_of,
    stamped,
)
from canopen_control.rpc.messages.state import StateSample
from canopen_control.rpc.wire import convert, plain

SAMPLES = {
    "base": OdometrySample(time=1.5, x=1.0, y=2.0, heading=0.5, limited=(0.4, 0.1)),
    "forklift": SteeringSample(time=1.5, x=1.0, y=2.0, heading=0.5, steering=[0.1, None], traction_commands=[3.0]),
    "platform": MecanumSample(time=1.5, x=1.0, y=2.0, heading=0.5, lateral=0.2, wheels=[1.0, 2.0, 3.0, None]),
    "states": JointStatesSample(time=2.0, names=("a",), joints={"a": {"position": 1.0, "load": None}}),
    "io": GpioSample(time=3.0, parts={"lamp": {"on": 1.0}}),
    "arm": TrajectorySample(
        time=5.0,
        joints=("a",),
        executing=True,
        holding=False,
        reference=TrajectoryPoint(positions=[1.0], velocities=[0.5], time_from_start=0.25),
        feedback=TrajectoryPoint(positions=[0.9]),
        error=TrajectoryPoint(positions=[0.1]),
        output=TrajectoryPoint(positions=[1.1]),
    ),
    "gripper": GripperSample(
        time=6.5,
        joint="finger",
        position=0.02,
        velocity=0.0,
        effort=None,
        target=0.04,
        executing=True,
        stalled=False,
        reached_goal=False,
    ),
    "power": BatteriesSample(
        time=6.75,
        batteries=[BatteryReading(name="main", voltage=24.5, percentage=0.5, present=True)],
        together=BatteryReading(name=""),
    ),
    "imu": ImuSample(
        time=7.0,
        frame_id="imu_link",
        orientation=(0.0, 0.0, 0.0, 1.0),
        angular_velocity=(None, None, None),
        linear_acceleration=(0.0, 0.0, 9.81),
    ),
    "sonar": RangeSample(time=8.0, frame_id="front", range=None, max_range=4.0),
    "wrist": WrenchSample(time=9.0, frame_id="tool0", force=(1.0, None, 2.0), torque=(0.0, 0.0, 0.5)),
    "gps": PoseSample(time=9.5, frame_id="map", position=(1.0, 2.0, None), orientation=(0.0, 0.0, 0.0, 1.0)),
    "loops": PidSample(
        time=6.0,
        dofs=[
            DofReading(
                name="a",
                reference=1.0,
                feedback=0.9,
                feedback_dot=None,
                error=0.1,
                error_dot=None,
                time_step=0.01,
                output=0.2,
            )
        ],
    ),
    "health": DiagnosticsSample(time=4.0, joints=[JointDiagnosis("a", 2, "in fault", {"age": None})]),
}


def test_samples_of_every_kind_cross_the_wire_as_what_they_are():
    there = convert(plain(StateSample(samples=SAMPLES)), StateSample)
    assert there.samples == SAMPLES
    assert {type(sample) for sample in there.samples.values()} == set(typing.get_args(ControllerSample))
    assert there.samples_of(PidSample) == {"loops": SAMPLES["loops"]}
    assert there.samples_of(OdometrySample) == {name: SAMPLES[name] for name in ("base", "forklift", "platform")}


def test_a_sample_grows_into_a_kind_that_has_its_fields():
    result = grown(MecanumSample, SAMPLES["base"], wheels=[1.0])
    assert (result.x, result.limited, result.wheels, kind_of(type(result))) == (1.0, (0.4, 0.1), [1.0], "mecanum")


def test_each_kind_has_a_word_of_its_own():
    kinds = [kind_of(arg) for arg in typing.get_args(ControllerSample)]
    assert kinds == [
        *("odometry", "steering", "mecanum", "joint_states", "gpio", "diagnostics", "trajectory", "pid", "gripper"),
        *("imu", "range", "wrench", "pose", "batteries"),
    ]
    assert plain(SAMPLES["io"])["kind"] == "gpio"


def test_a_kind_that_is_unknown_is_reported():
    with pytest.raises(Exception, match="Invalid value 'dance'"):
        convert({"samples": {"dancer": {"kind": "dance", "time": 1.0}}}, StateSample)
    assert issubclass(OdometrySample, Sample)


def test_a_message_is_stamped_again_and_what_it_reports_stays():
    moved = stamped(SAMPLES["base"], 9.0, x=5.0)
    assert (moved.time, moved.x, moved.y) == (9.0, 5.0, SAMPLES["base"].y)
    assert SAMPLES["base"].time == 1.5
