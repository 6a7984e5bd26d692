"""The flight recorder with a whole robot: content of its file, the cause on the page, and no effect on the robot."""

import json
import os
import signal

import pytest
from support.host import eventually
from support.localbus import hub_status
from support.processes import GONE_S, seconds_until

from canopen_control.host.files import state_dir
from canopen_control.trace.flight import WINDOW_NS
from canopen_control.trace.flight_file import AFTER_NS, newest, read_flight

LEFT = 3
LEFT_TPDO, RIGHT_TPDO, SYNC = 0x183, 0x182, 0x80
SPEED = 10 / 0.003926990816987242  # microsteps/s at 10 rad/s


def folder(name):
    return state_dir(name) / "flight"


def recorded(name):
    """Wait for the file of a robot and read it."""
    assert eventually(lambda: newest(folder(name)) is not None)
    return read_flight(newest(folder(name)))


def listening(name):
    """Wait until the recorder has heard half a second of the bus."""

    def heard():
        members = hub_status(name).members
        return any(max(member.rx, member.tx) > 200 for member in members if member.label.startswith("flight recorder"))

    return eventually(heard)


def seconds(file, can_id):
    return [time_ns / 1e9 for time_ns, _, frame in file.frames if frame.can_id == can_id]


def test_a_killed_drive_leaves_a_file_with_what_came_before_and_after_and_a_page_that_names_it(stage):
    robot = stage.robby("flown")
    assert listening("flown")
    os.kill(stage.pid_of("--node-id 3"), signal.SIGKILL)
    path = robot.until("flight recording: ").split("flight recording: ")[1].split(" (")[0]
    assert robot.running
    file = recorded("flown")
    assert str(newest(folder("flown"))) == path
    lost = next(event for event in file.events if event.kind == "heartbeat_lost")
    assert (lost.node, lost.level) == ("left_drive", "error")
    assert file.meta.reason.time <= lost.time
    died, end = seconds(file, LEFT_TPDO)[-1], file.meta.written
    assert seconds(file, LEFT_TPDO)[0] < died < lost.time
    assert end - lost.time + 0.1 >= AFTER_NS / 1e9  # the reaction is in it
    assert seconds(file, RIGHT_TPDO)[-1] > lost.time
    syncs = seconds(file, SYNC)
    answers = seconds(file, RIGHT_TPDO)
    answered = [time for time in syncs if answers[0] - 0.01 < time < answers[-1]]
    assert len(answers) == pytest.approx(len(answered), rel=0.05)  # no frame is missing
    assert file.states[0].time < died < lost.time < file.states[-1].time
    assert seconds(file, 0x000)[0] < syncs[0] + 0.1  # from the master's first words on
    assert min(seconds(file, 0x600 + LEFT)) < min(seconds(file, LEFT_TPDO))  # the whole boot
    assert any(event.kind == "ready" for event in file.events)
    assert set(file.eds) == {"TMCM-1270.eds"}
    page = stage.call("report", "-o", stage.place / "page.html")
    assert page.wait() == 0, page
    assert "left_drive" in "\n".join(page.out.splitlines()[:2])
    assert "left_drive" in (stage.place / "page.html").read_text().split("<h2>")[0]
    assert robot.end() == 1, robot  # a drive that is gone is not known to be disabled


def test_a_recorder_that_is_killed_changes_nothing_for_the_robot(stage, probe):
    robot = stage.robby("alone")
    assert listening("alone")
    stage.start("command", "robby_forward_controller", 10, 10, "--name", "alone")
    drive = probe("alone", LEFT)
    assert eventually(lambda: abs(drive.speed) == pytest.approx(SPEED, rel=0.01))
    os.kill(stage.pid_of("trace.flight"), signal.SIGKILL)
    robot.until("process flight")
    assert abs(drive.speed) == pytest.approx(SPEED, rel=0.01)
    status = json.loads(stage.call("status", "--json", "--name", "alone").out)
    assert status["state"] == "running"
    assert [event["kind"] for event in status["events"] if event["level"] == "error"] == ["process_ended"]
    assert robot.end() == 0, robot


def test_a_runtime_that_is_killed_is_a_fault_and_the_drives_reaction_is_recorded(stage):
    for node_id in (3, 2):
        stage.drive("crash", node_id)
    robot = stage.robby("crash", "--no-drives")
    assert listening("crash")
    robot.end(signal.SIGKILL)
    file = recorded("crash")
    assert file.meta.reason.kind == "died"
    died = file.meta.reason.time
    emergencies = [time for node_id in (2, 3) for time in seconds(file, 0x80 + node_id) if time > died]
    assert len(emergencies) >= 2  # both said 0x8130, the lost heartbeat
    assert seconds_until(lambda: "trace.flight" not in str(stage.survivors()), GONE_S) < GONE_S


def test_a_run_that_fails_reports_where_the_recording_is_although_it_has_ended(stage, tmp_path):
    robot = stage.robby("nohub")
    assert listening("nohub")
    os.kill(hub_status("nohub").pid, signal.SIGKILL)
    assert robot.wait() == 1
    assert f"flight recording: {newest(folder('nohub'))}" in robot.out
    assert recorded("nohub").meta.reason.kind == "bus_lost"


def test_a_run_without_faults_leaves_no_file_and_one_without_recorder_no_process(stage):
    robot = stage.robby("calm", "--for", 3)
    assert listening("calm")
    assert robot.wait() == 0
    assert newest(folder("calm")) is None
    robot = stage.robby("without", "--no-flight-recorder", "--for", 2)
    assert robot.wait() == 0
    assert not (state_dir("without") / "flight.log").exists()


def test_the_window_is_a_minute():
    assert WINDOW_NS == 60_000_000_000
