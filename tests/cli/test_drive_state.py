from __future__ import annotations

from canopen_control.cli.drive import quality_lines, state_lines
from canopen_control.rpc.messages.drive import AxisState, DriveState, PlantState, SetPointQuality, Spread

QUALITY = SetPointQuality(
    taken=1000,
    missed=2,
    doubled=1,
    velocity=Spread(0.0, 1600.0, 3200.0),
    velocity_ripple=0.1412,
    acceleration=123456.7,
    acceleration_ripple=0.02,
    phase_us=Spread(150.0, 1204.5, 2900.0),
)


def axis(quality=None):
    plant = PlantState(0.0, 0.0, 250.0)
    return AxisState(
        axis=0,
        state="OPERATION_ENABLED",
        statusword=0x1237,
        controlword=15,
        mode="CSP",
        position=-5,
        velocity=1600,
        plant=plant,
        set_points=quality,
    )


def drive(*axes, errors=(), faults=()):
    return DriveState(
        node_id=3,
        name="servo",
        nmt_state="OPERATIONAL",
        error_register=0,
        errors=[*errors],
        faults=[*faults],
        axes=axes,
    )


def test_a_node_and_its_axes_have_a_line_each():
    assert [*state_lines(drive(axis()))] == [
        "node 3, servo: OPERATIONAL",
        "  axis 0: OPERATION_ENABLED, CSP, position -5, velocity 1600, torque 25 %",
    ]


def test_what_is_wrong_stands_alongside_the_node():
    (line,) = state_lines(drive(errors=[0x8611], faults=["rpdo_late"]))
    assert line == "node 3, servo: OPERATIONAL, error 0x8611; active faults: rpdo_late"


def test_the_quality_of_set_points_has_its_counts_ripple_and_phase():
    assert [*quality_lines(QUALITY)] == [
        "set-points: 1000 taken, 2 missed, 1 doubled, 0 overwritten",
        "velocity demand: 1600 (0 to 3200), ripple 14.1 %",
        "acceleration ripple: 1.235e+05 units/s^2, in relation to the velocity 2.0 %",
        "RPDO after SYNC: 1204.5 (150 to 2900) us",
    ]
    assert [*state_lines(drive(axis(QUALITY)))][2].startswith("    set-points: 1000 taken")
