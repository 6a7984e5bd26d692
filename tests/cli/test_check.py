"""The verb check: output and exit codes."""

import json

import pytest
from support.robots import copy_robby

from canopen_control.cli.main import main


def test_a_good_robot_is_exit_code_0_with_its_bus_budget(capsys):
    assert main(["check", "robby", "--strict"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "robby: 3 notes"
    assert lines[-2] == (
        "stop of right_wheel_joint (right_drive): the command of robby_forward_controller ends 2.020 s, then ramp of "
        "0x6084 (16000) from an unlimited speed"
    )
    assert lines[-4].endswith("SYNC comes from this program: no joint is commanded in CSP or CSV")
    assert lines[-5] == (
        "bus can: 775 to 935 bits in a cycle of 20 ms, load 4.9% of 1000 kbit/s, shortest possible period 0.94 ms"
    )


@pytest.mark.parametrize("options", [["--no-drives"], ["--name", "x"]])
def test_what_only_means_something_to_run_is_not_an_option(options, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["check", "robby", *options])
    assert stop.value.code == 2
    assert f"unrecognized arguments: {' '.join(options)}" in capsys.readouterr().err


def test_a_cycle_that_cannot_fit_is_exit_code_2(tmp_path, capsys):
    config = copy_robby(tmp_path, bus={"baudrate: 1000": "baudrate: 20"})
    assert main(["check", str(config)]) == 2
    assert "the shortest possible period is 46.75 ms" in capsys.readouterr().out


def test_a_warning_is_good_unless_strict(tmp_path):
    config = copy_robby(tmp_path, bus={"sync_period: 20000": "sync_period: 20000\n  sync_window: 500"})
    assert main(["check", str(config)]) == 0
    assert main(["check", str(config), "--strict"]) == 2


def test_as_json_every_finding_has_its_place_and_every_bus_its_figures(tmp_path, capsys):
    config = copy_robby(tmp_path, bus={"node_id: 3": "node_id: 300"})
    assert main(["check", str(config), "--json"]) == 2
    text = json.loads(capsys.readouterr().out)
    error = next(finding for finding in text["findings"] if finding["severity"] == "error")
    assert error["path"].endswith("bus.yml")
    assert (error["line"] > 0, error["column"] > 0, "300" in error["text"]) == (True, True, True)
    assert text["buses"] == {}
    assert main(["check", "robby", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["buses"]["can"]["worst_bits"] == 935


def test_a_finding_and_a_budget_have_the_stable_json_keys(tmp_path, capsys):
    config = copy_robby(tmp_path, bus={"baudrate: 1000": "baudrate: 20"})
    main(["check", str(config), "--json"])
    finding = json.loads(capsys.readouterr().out)["findings"][0]
    assert list(finding) == ["path", "line", "column", "severity", "text", "fix"]
    main(["check", "robby", "--json"])
    budget = json.loads(capsys.readouterr().out)["buses"]["can"]
    assert (budget["period_s"], budget["shortest_period_s"], budget["fits"]) == (0.02, 0.000935, True)
    assert budget["frames"][0] == {"name": "SYNC", "cob_id": 128, "length": 0, "per_cycle": 1.0}


def test_a_caret_stands_below_the_error(tmp_path, capsys):
    main(["check", str(copy_robby(tmp_path, bus={"node_id: 3": "node_id: 300"}))])
    lines = capsys.readouterr().out.splitlines()
    at = next(number for number, line in enumerate(lines) if line.strip() == "^")
    assert lines[at - 1][lines[at].index("^") :].startswith("300")


def test_without_a_robot_it_suggests_what_to_name(capsys):
    assert main(["check", "no-such-robot"]) == 2
    assert "it is neither a folder nor a bundled robot" in capsys.readouterr().err
    assert main(["check", "robbie"]) == 2
    assert capsys.readouterr().err.endswith("in ROS_PACKAGE_PATH (did you mean 'robby'?)\n")


def test_one_option_accepts_drives_that_nothing_would_stop_and_reports_which(tmp_path, capsys):
    config = copy_robby(tmp_path, bus={"heartbeat_consumer: true": "heartbeat_consumer: false"})
    assert main(["check", str(config)]) == 2
    assert main(["check", str(config), "--allow-unsupervised"]) == 0
    assert "--allow-unsupervised accepts" in capsys.readouterr().out
    assert main(["plan", str(config), "--allow-unsupervised"]) == 0


def test_an_argument_that_the_description_does_not_have_is_an_error_with_the_nearest(capsys):
    assert main(["check", "robby", "--strict", "use_mock_hardware:=true"]) == 0
    assert main(["check", "robby", "use_mok_hardware:=true"]) == 2
    output = capsys.readouterr().out
    assert (
        "robby.urdf.xacro: error: xacro: no argument 'use_mok_hardware' (did you mean 'use_mock_hardware'?)" in output
    )


@pytest.mark.rest
def test_the_longest_stop_of_each_joint_is_reported_and_as_json_every_reason(capsys):
    assert main(["check", "arm6"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("stop of ")]
    assert len(lines) == 6
    assert lines[0] == (
        "stop of joint_1 (joint_1_drive): 0.838 s at most from 2086076 units/s: a node of its group is silent 0.520 s, "
        "ramp of 0x6084 (6.5536e+06) 0.318 s"
    )
    assert main(["check", "arm6", "--json"]) == 0
    stop = json.loads(capsys.readouterr().out)["stops"][0]
    assert (stop["joint"], stop["node_id"], round(stop["longest_s"], 3)) == ("joint_1", 2, 0.838)
    lost = next(item for item in stop["cases"] if item["cause"] == "the master is silent")
    assert (lost["detection_s"], lost["by"].split(" (")[0]) == (0.5, "ramp of 0x6085")
