"""Parameters read from a drive after its boot."""

import math

import pytest
from support.generic import write_generic
from support.observers import Observer
from support.robots import Bench

from canopen_control.cia402.units import Scale
from canopen_control.frame import CanFrame
from canopen_control.hardware.axis_parameters import planned_scales


@pytest.fixture
def servo(tmp_path):
    benches = []

    def start(name="params", **how):
        benches.append(Bench(name, config=write_generic(tmp_path, **how), drives=(2, 3), controllers=["velocity"]))
        return benches[-1]

    yield start
    for bench in benches:
        bench.close()


def test_units_come_from_the_drive_where_bus_yml_gives_none(servo):
    bench = servo()
    bench.start()
    assert bench.joint(2).scale.pos_to_dev == pytest.approx(65536 / math.tau)
    assert bench.joint(2).parameters.counts_per_turn() == 65536


def test_a_gear_counts_where_there_is_not_a_feed_constant(servo):
    sdo = (
        "- {index: 0x6091, sub_index: 1, value: 3}\n    - {index: 0x6092, sub_index: 1, value: 1}\n"
        "    - {index: 0x6092, sub_index: 2, value: 1}"
    )
    bench = servo("params2", sdo=sdo)
    bench.start()
    assert bench.joint(2).parameters.counts_per_turn() == 3 * 65536


def test_a_scale_of_bus_yml_wins(servo):
    bench = servo("params3", extra="scale_pos_to_dev: 500.0\n  scale_pos_from_dev: 0.002")
    bench.start()
    assert bench.joint(2).scale.pos_to_dev == 500.0


ROS2_CANOPEN_DEFAULTS = (
    "scale_pos_to_dev: 1000.0",
    "scale_pos_from_dev: 0.001",
    "scale_vel_to_dev: 1000.0",
    "scale_vel_from_dev: 0.001",
)


@pytest.mark.parametrize("given", [ROS2_CANOPEN_DEFAULTS, ("channels: [{scale_pos_to_dev: 1000}]",)])
def test_a_scale_of_bus_yml_wins_with_the_value_of_the_default_too(servo, given):
    """The examples of ros2_canopen write 1000.0, which its driver uses whatever 0x608F is."""
    bench = servo("params3b", extra="\n  ".join(given))
    bench.start()
    assert bench.joint(2).scale.pos_to_dev == 1000.0
    assert bench.joint(2).scale.vel_to_dev == 1000.0
    assert planned_scales(bench.setup.bus, "drive_one", 0)["pos_to_dev"] == 1000.0
    assert bench.setup.bus.plans["drive_one"].turns[0] == pytest.approx(1000 * math.tau)


def test_the_offsets_of_bus_yml_count_without_a_scale(servo):
    bench = servo("offsets", extra="offset_pos_from_dev: 2.0\n  offset_pos_to_dev: -30.0")
    bench.start()
    scale = bench.joint(2).scale
    assert (scale.pos_to_dev, scale.offset_pos_from_dev, scale.offset_pos_to_dev) == (65536 / math.tau, 2.0, -30.0)


def test_it_asks_only_for_what_the_eds_lists_and_nothing_is_enabled_before_it_is_answered(servo):
    bench = servo("params4")
    observed = []
    bench.robot.observers.append(
        Observer(
            after_cycle=lambda _now: observed.extend(
                joint.parameters.loaded
                for joint in bench.robot.joints.values()
                if joint.machine.state and joint.enabled
            )
        )
    )
    bench.start()
    assert observed
    assert all(observed)
    parameters = bench.joint(2).parameters
    assert parameters.get(0x6502) == 0x3EF
    assert parameters.get(0x607C) is None
    assert parameters.homing_methods == {1, 2, 17, 18, 19, 21, 33, 34, 35, 37}
    assert parameters.failed == []


@pytest.mark.rest
def test_a_drive_that_does_not_answer_is_loaded_without_and_named(servo):
    bench = servo("params5")
    bench.start()
    parameters = bench.joint(2).parameters
    bench.bus.drop(lambda _label, frame: frame.can_id == 0x582)
    parameters.load()
    bench.until(lambda: parameters.loaded, ms=60_000)
    assert "node 2 (drive_one)" in parameters.failed[0]
    assert bench.joint(2).axis.limits.velocity == (1 << 31) - 1


def test_late_answers_of_an_earlier_round_are_not_taken(servo):
    bench = servo("params6")
    bench.start()
    parameters = bench.joint(2).parameters
    parameters.load()
    parameters.forget()
    bench.run(500)
    assert not parameters.loaded
    assert CanFrame(0x602, bytes.fromhex("4002650000000000")) in [frame for _, frame in bench.bus.history]


RPM = "scale_vel_to_dev: 9.549296585513721\n  scale_vel_from_dev: 0.10471975511965977\n  "
GEARED = f"scale_pos_to_dev: {50 * 65536 / math.tau}\n  scale_pos_from_dev: {math.tau / 65536 / 50}"


def test_the_largest_speed_of_the_motor_is_one_of_the_joint_in_the_unit_of_its_velocities(servo):
    """0x6080 is in rpm of the motor; 0x60FF in rpm of the joint, behind a gear of 50."""
    bench = servo("params5", extra=RPM + GEARED, sdo="- {index: 0x6080, sub_index: 0, value: 3000}")
    bench.start()
    axis = bench.joint(2).axis
    assert axis.turn == 65536
    assert axis.rpm_to_dev == pytest.approx(50 * 60 / math.tau)
    assert axis.limits.velocity == pytest.approx(3000 / 50)


@pytest.mark.parametrize(("slope", "reported"), [(255, True), (655_360, False), (0, False)])
@pytest.mark.parametrize("index", [0x6084, 0x6085])
def test_a_ramp_in_the_drive_that_would_take_minutes_is_reported(servo, index, slope, reported):
    sdo = f"- {{index: 0x{index:04X}, sub_index: 0, value: {slope}}}"
    bench = servo("ramps", sdo=sdo, velocity=10.0)
    bench.start()
    texts = [text for text in bench.texts("parameters") if "node 2" in text and "takes" in text]
    words = f"0x{index:04X} is 255, so that braking from the velocity limit of the description takes 409 s"
    assert [words in text for text in texts] == ([True] if reported else [])


def test_the_unit_of_a_ramp_is_doubted_if_velocities_have_their_own_unit(servo):
    """Kinco's velocities are 512 x resolution / 1875 of a rpm, and its ramps have another factor again."""
    units = (
        "scale_pos_to_dev: 1000.0\nscale_pos_from_dev: 0.001\nscale_vel_to_dev: 16000.0\nscale_vel_from_dev: 0.0000625"
    )
    bench = servo("units", sdo="- {index: 0x6084, sub_index: 0, value: 255}", velocity=10.0, modes=units)
    bench.start()
    (text,) = [text for text in bench.texts("parameters") if "node 2" in text and "0x6084" in text]
    assert text.endswith(
        "takes 627 s; if its unit is that of the velocities per s, write a faster ramp under `sdo:` in bus.yml"
    )


@pytest.mark.parametrize(("code", "reported"), [(-1, True), (9, True), (2, False), (0, False), (8, False)])
def test_a_reaction_to_a_quick_stop_that_cia_402_does_not_define_is_reported(servo, code, reported):
    bench = servo("quick")
    bench.start()
    bench.drives[2].store.set(0x605A, 0, code)
    bench.joint(2).parameters.load()
    bench.run(500)
    assert any(f"0x605A is {code}, which" in text for text in bench.texts("parameters")) is reported


@pytest.mark.parametrize(
    "how",
    [
        {},
        {"sdo": "- {index: 0x6091, sub_index: 1, value: 3}"},
        {"sdo": "- {index: 0x608F, sub_index: 1, value: 4096}"},
        {"extra": "scale_pos_to_dev: 500.0\n  scale_pos_from_dev: 0.002"},
        {"extra": "offset_pos_from_dev: 2.0"},
    ],
)
def test_the_planned_scales_are_those_that_the_drive_gets(servo, how):
    bench = servo("planned", **how)
    bench.start()
    assert Scale(**planned_scales(bench.setup.bus, "drive_one", 0)).pos_to_dev == bench.joint(2).scale.pos_to_dev
