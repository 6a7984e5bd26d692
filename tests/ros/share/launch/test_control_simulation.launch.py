from __future__ import annotations

from support.launch_stub import launched

ROBBY = ["canopen-control", "run", "robby", "--ros", "--mock", "--controller", "robby_base_controller"]


def test_robby_runs_on_mock_hardware_with_the_diff_drive_controller():
    assert launched("control_simulation") == ([ROBBY], [])


def test_rviz_is_started_where_it_is_installed_and_requested():
    assert launched("control_simulation", ["rviz2"]) == ([ROBBY], ["rviz2"])
    assert launched("control_simulation", ["rviz2"], gui="false") == ([ROBBY], [])
