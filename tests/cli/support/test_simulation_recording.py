"""A simulation that is recorded, and its recording that is simulated."""

import pytest

from canopen_control.cli.main import main
from canopen_control.trace.flight_file import read_flight
from canopen_control.trace.report_build import facts_of

#: its acts are in the middle of a cycle of 20 ms: at an edge the clocks that a seed draws decide which cycle takes one
SCENARIO = """for: 8s
seed: 3
steps:
  - {at: 1009ms, do: command, target: robby_forward_controller, values: [5, 4], for: 1s}
  - {at: 1509ms, node: 3, fault: heartbeat_lost, for: 600ms}
  - {at: 2509ms, do: axis, name: fault-reset}
  - {at: 2809ms, do: axis, name: enable}
  - {at: 3209ms, do: activate, target: robby_base_controller}
  - {at: 3509ms, do: command, target: robby_base_controller, values: [0.3, 0.2], for: 2s}
  - {at: 4509ms, node: 2, fault: short_circuit, for: 500ms}
  - {at: 5509ms, do: axis, name: fault-reset}
  - {at: 6009ms, do: axis, name: enable}
  - {at: 6409ms, do: command, target: robby_base_controller, values: [-0.3, 0.1], for: 500ms}
"""


def faults(file):
    return [(event.kind, event.node) for event in file.events if event.level == "error"]


@pytest.mark.rest
def test_a_recording_of_a_simulation_does_the_same_again(tmp_path, capsys):
    (tmp_path / "bug.yml").write_text(SCENARIO)
    first, second, seed = tmp_path / "first.zip", tmp_path / "second.zip", tmp_path / "seed.yml"
    assert main(["simulate", "robby", "--scenario", str(tmp_path / "bug.yml"), "--record", str(first), "--json"]) == 0
    assert main(["simulate", "robby", "--recording", str(first), "--record", str(second), "--out", str(seed)]) == 0
    was, became = read_flight(first), read_flight(second)
    assert faults(was) == faults(became)
    assert {node for _, node in faults(was)} == {"left_drive", "right_drive"}
    for joint, reading in was.states[-1].joints.items():
        assert abs(reading.position) > 3.0
        assert became.states[-1].joints[joint].position == pytest.approx(reading.position, abs=0.05)
    assert [(request.method, bytes(request.params)) for request in was.requests] == [
        (request.method, bytes(request.params)) for request in became.requests
    ]
    capsys.readouterr()
    assert main(["simulate", "robby", "--scenario", str(seed), "--json"]) == 0
    assert facts_of(was).fault is not None  # a page of it


@pytest.mark.rest
def test_frames_alone_report_what_went_wrong(tmp_path, capsys):
    (tmp_path / "bug.yml").write_text("for: 3s\nsteps:\n  - {at: 1s, node: 3, fault: short_circuit, for: 500ms}\n")
    assert (
        main(["simulate", "robby", "--scenario", str(tmp_path / "bug.yml"), "--record", str(tmp_path / "a.zip")]) == 0
    )
    log, seed = tmp_path / "a.log", tmp_path / "seed.yml"
    from canopen_control.bus.recordings import line_of

    log.write_text("".join(line_of(now, bus, frame) for now, bus, frame in read_flight(tmp_path / "a.zip").frames))
    capsys.readouterr()
    assert main(["simulate", "robby", "--recording", str(log), "--out", str(seed)]) == 0
    assert "do: fault, target: 3, name: short_circuit" in seed.read_text()
    assert "0x2320" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--record", "run.log"], "as run.zip"),
        (["--recording", "/nowhere.zip"], "/nowhere.zip"),
        (["--recording", "/nowhere.log"], "recording /nowhere.log does not exist"),
        (["--recording", "a.zip", "--scenario", "b.yml"], "give only one of them"),
        (["--recording", "a.zip", "--faults", "all"], "give only one of them"),
        (["--recording", "a.zip", "--seeds", "3"], "--recording is for a single simulation"),
        (["--record", "/nowhere/a.zip", "--for", "100ms"], "/nowhere/a.zip"),
    ],
)
def test_what_cannot_be_is_reported(capsys, words, text):
    assert main(["simulate", "robby", *words]) == 2
    assert text in capsys.readouterr().err


def test_a_log_of_one_bus_is_not_a_recording_of_several(tmp_path, capsys):
    log = tmp_path / "a.log"
    log.write_text("(1700000000.000000) can0 080#\n")
    assert main(["simulate", "robby", "--recording", str(log)]) == 0


def test_a_log_of_two_buses_is_refused(tmp_path, capsys):
    log = tmp_path / "a.log"
    log.write_text("(1700000000.000000) can0 080#\n(1700000000.010000) can1 080#\n")
    assert main(["simulate", "robby", "--recording", str(log)]) == 2
    assert "contains the frames of 2 buses (can0, can1); keep those of one" in capsys.readouterr().err
