import contextlib
import math
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.host import use_private_folders
from support.samples import event_of, sample_of, status_of

from canopen_control.cli import status
from canopen_control.cli.main import main
from canopen_control.cli.status import cause_lines, render
from canopen_control.client import RobotClient
from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.state import RobotEvent, Snapshot, TruePose
from canopen_control.rpc.wire import plain
from canopen_control.version import __version__

LEFT = "node 3 (left_drive)"
RIGHT = "node 2 (right_drive)"
SILENT = "no heartbeat for 0.506 s; is it powered and connected?"
HOT = "EMCY 0x4310 (drive temperature too high)"
BOTH = "stopping left_wheel_joint, right_wheel_joint"


def event(at, kind, text, level="error"):
    return RobotEvent(time=at, kind=kind, node=None, level=level, text=text)


def drive_fault(at):
    return [
        event(at, "emcy", f"{LEFT}: {HOT}, register 0x09, data 00 00 00 00 00", "warning"),
        event(at + 0.02, "fault", f"{LEFT}: fault (statusword 0x0618) while enabled; {HOT}"),
        event(at + 0.02, "stop", f"{BOTH}: {LEFT}: fault (statusword 0x0618) while enabled"),
    ]


FAULT_LINE = (
    f"error: {LEFT}: {HOT}, register 0x09, data 00 00 00 00 00; fault (statusword 0x0618) while enabled; {BOTH}"
)


def loss(at):
    return [
        event(at, "heartbeat_lost", f"{RIGHT}: {SILENT}"),
        event(at, "node_lost", f"{RIGHT}: lost: {SILENT}"),
        event(at, "stop", f"{BOTH}: {RIGHT}: lost: {SILENT}"),
    ]


def test_a_fault_its_emergency_message_and_its_stop_are_one_line():
    assert cause_lines(drive_fault(10.0), {}) == [FAULT_LINE]


def test_what_is_above_as_the_error_of_the_node_is_not_reported_again():
    assert cause_lines(loss(10.0)[:2], {"right_drive": f"{RIGHT}: {SILENT}"}) == []
    assert cause_lines(loss(10.0), {"right_drive": f"{RIGHT}: {SILENT}"}) == [f"error: {RIGHT}: {BOTH}"]
    assert cause_lines(loss(10.0)[:2], {"left_drive": f"{LEFT}: {SILENT}"}) == [f"error: {RIGHT}: {SILENT}"]


def test_what_comes_again_is_counted_with_its_times():
    lines = cause_lines([*drive_fault(0.0), *drive_fault(60.0), *drive_fault(120.0)], {})
    assert len(lines) == 1
    assert lines[0].startswith(f"{FAULT_LINE} (3 times, ")
    assert lines[0].endswith(":02:00)")


def test_each_axis_of_a_node_that_reports_the_same_in_one_cycle_is_reported_once():
    assert cause_lines([event(5.0, "node_lost", f"{LEFT}: lost: {SILENT}")] * 6, {}) == [f"error: {LEFT}: {SILENT}"]


def test_infos_are_left_out_and_other_sentences_stay_as_they_are():
    events = [
        event(1.0, "running", "robby runs", "info"),
        event(2.0, "client_dropped", "client x (pid 7) read too slowly"),
    ]
    assert cause_lines(events, {}) == ["error: client x (pid 7) read too slowly"]


WORDS = [f"{LEFT}: {HOT}", f"{LEFT}: fault; {HOT}", f"{RIGHT}: {SILENT}", f"{BOTH}: {LEFT}: fault", "a: b; c", "c"]


@pytest.mark.rest
@given(st.lists(st.tuples(st.floats(0, 100), st.sampled_from("abc"), st.sampled_from(WORDS)), max_size=12))
def test_whatever_happens_every_clause_is_reported_and_no_line_twice(collected):
    events = [event(at, kind, text) for at, kind, text in sorted(collected)]
    lines = cause_lines(events, {})
    assert len(lines) == len(set(lines))
    for item in events:
        for clause in item.text.rpartition("): ")[2].split("; "):
            assert any(clause in line for line in lines)


STATE = {
    "state": "running",
    "latched": False,
    "latched_by": None,
    "cycle": {"period_s": 0.02, "count": 7, "missed": 0},
    "nodes": {
        "left_drive": {
            "node_id": 3,
            "nmt_state": "OPERATIONAL",
            "age_s": 0.0123,
            "error": None,
            "axes": [{"joint": "left_wheel_joint", "cia402_state": "OPERATION_ENABLED"}],
        },
        "gone": {"node_id": 4, "nmt_state": None, "age_s": None, "error": "node 4 (gone): no answer", "axes": []},
    },
    "joints": {"left_wheel_joint": {"command": 10.0, "velocity": 9.998, "position": 1.0, "effort": None}},
    "controllers": {"forward": "active", "base": "inactive"},
}


def test_a_line_for_the_robot_one_for_each_axis_and_the_errors_in_words():
    lines = render(sample_of(STATE))
    assert lines[0] == "running, cycle 7 of 20 ms, 0 missed, active: forward"
    assert "left_drive (3)" in lines[2]
    assert "OPERATION ENABLED" in lines[2]
    assert lines[2].split()[-4:] == ["10.000", "9.998", "1.000", "12"]
    assert lines[3].split()[2:] == ["-"] * 7
    assert lines[4] == "  node 4 (gone): no answer"


def test_a_simulated_base_is_reported_with_what_odometry_is_off_by():
    truth = TruePose(time=0.0, x=1.0, y=-0.25, heading=math.pi / 2, error=(0.003, -0.004, -math.pi / 180))
    assert render(Snapshot(true_pose=truth))[1] == (
        "true pose 1.000, -0.250 m, 90.0 deg; odometry is off by 5.0 mm and 1.00 deg"
    )
    alone = TruePose(time=0.0, x=1.0, y=-0.25, heading=0.0)
    assert render(Snapshot(true_pose=alone))[1] == "true pose 1.000, -0.250 m, 0.0 deg"


def test_mock_hardware_has_joints_without_nodes():
    lines = render(sample_of({**STATE, "nodes": {}}))
    assert any(line.split()[:5] == ["no", "drive", "-", "-", "left_wheel_joint"] for line in lines)


def test_outputs_that_are_void_are_named_also_when_their_node_is_back():
    node = {**STATE["nodes"]["left_drive"], "node_id": 5, "axes": [], "void_outputs": ["do0", "ao1"]}
    lines = render(sample_of({**STATE, "nodes": {"io": node}}))
    assert lines[-1] == "  node 5 (io): outputs void since the node was lost: do0, ao1; command them again"


def test_a_drive_that_nothing_stops_has_a_mark_and_a_line():
    node = {**STATE["nodes"]["left_drive"], "node_id": 5, "axes": [], "unsupervised": "it has no 0x1016"}
    lines = render(sample_of({**STATE, "nodes": {"left_drive": node}}))
    assert any(line.startswith("left_drive (5) !  ") for line in lines)
    assert lines[-1] == (
        "  left_drive (5) !: NOTHING stops this drive when the robot's program ends (allow_unsupervised): "
        "it has no 0x1016"
    )


@pytest.mark.parametrize(
    ("mode", "target"), [("PV", "10.000 rad/s"), ("CSP", "10.000 rad"), ("CST", "10.000 Nm"), (None, "10.000 ")]
)
def test_a_target_has_the_unit_of_its_mode(mode, target):
    axes = [{"joint": "left_wheel_joint", "cia402_state": "OPERATION_ENABLED", "mode": mode}]
    lines = render(sample_of({**STATE, "nodes": {"left_drive": {**STATE["nodes"]["left_drive"], "axes": axes}}}))
    assert f"  {target}  " in lines[2]


def test_a_latched_stop_is_reported_with_the_remedy():
    hint = "STOP is latched (by view): canopen-control stop --release"
    lines = render(sample_of({**STATE, "state": "disabled", "latched": True, "latched_by": "view", "hint": hint}))
    assert lines[0].startswith("disabled, cycle 7")
    assert lines[1] == hint


@pytest.mark.parametrize(
    ("event", "text"),
    [
        (None, "canopen-control: robot gone has closed the connection\n"),
        (event_of({"time": 1.0, "kind": "stopped"}), ""),
    ],
)
def test_a_watch_reports_that_the_robot_has_died_but_not_that_it_was_ended(monkeypatch, capsys, event, text):
    class Robot:
        def ask(self, _request):
            return Done()

        def messages(self, _timeout):
            yield sample_of(STATE)
            if event is not None:
                yield event
            raise RemoteError("BusClosed", "robot gone has closed the connection")

    monkeypatch.setattr(RobotClient, "connect", lambda _name: contextlib.nullcontext(Robot()))
    assert main(["status", "--watch"]) == (1 if text else 0)
    output = capsys.readouterr()
    assert output.out.startswith("running, cycle 7")
    assert output.err == text


def serve(monkeypatch, document):
    """Let `status` find a robot with this status, whichever client asks; return the methods that were asked for."""
    requests = []

    def request(_robot, method):
        requests.append(method)
        return SimpleNamespace(**plain(status_of(document)))

    def typed(_request):
        requests.append("typed")
        return status_of(document)

    monkeypatch.setattr(status, "select_robot", lambda name: name or "robby")
    monkeypatch.setattr(status, "request_plain", request)
    monkeypatch.setattr(RobotClient, "connect", lambda _name: contextlib.nullcontext(SimpleNamespace(ask=typed)))
    return requests


def test_the_table_is_the_same_without_the_types_of_messages(monkeypatch, capsys):
    tracking = {"interface": "position", "error_max": 0.00123, "repeated": 2}
    joint = {**STATE["joints"]["left_wheel_joint"], "tracking": tracking}
    event = {"time": 1.0, "kind": "emcy", "node": "left_drive", "level": "warning", "text": f"{LEFT}: {HOT}"}
    document = {
        **STATE,
        "version": __version__,
        "joints": {**STATE["joints"], "left_wheel_joint": joint},
        "boot": [{"node": "left_drive", "step": "identify", "seconds": 0.5}],
        "buses": {"can0": {"sync": "from the robot every 20 ms"}},
        "missing_programs": {"view": "it has ended"},
        "events": [event],
    }
    requested = serve(monkeypatch, document)
    assert main(["status", "--name", "robby"]) == 0
    quick = capsys.readouterr().out
    assert requested == ["status"]
    assert status.run(SimpleNamespace(json=False, watch=False, name=None)) == 0
    assert requested == ["status", "typed"]
    assert capsys.readouterr().out == quick
    assert all(text in quick for text in ("left_drive", "tracking error", "every 20 ms", "it has ended", HOT))


@pytest.mark.parametrize(
    ("changes", "options"),
    [
        ({"version": "1.2.3"}, []),
        ({"true_pose": {"time": 1.0, "x": 0.0, "y": 0.0, "heading": 0.0}}, []),
        ({}, ["--json"]),
        ({}, ["--name=robby"]),
    ],
)
def test_the_types_of_messages_are_asked_where_plain_fields_are_not_enough(monkeypatch, capsys, changes, options):
    requested = serve(monkeypatch, {**STATE, "version": __version__, **changes})
    assert main(["status", *options]) == 0
    assert requested[-1] == "typed"
    assert capsys.readouterr().out


@pytest.mark.process
def test_the_table_imports_neither_options_nor_messages(monkeypatch, tmp_path):
    use_private_folders(monkeypatch, tmp_path)
    code = "import sys; before = {*sys.modules}\n"
    code += "import atexit; atexit.register(lambda: print(*{*sys.modules} - before, file=sys.stderr))\n"
    code += "from canopen_control.cli.main import main; sys.exit(main(['status']))"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2
    assert "no robot is running" in done.stderr
    assert "canopen_control.cli.status" in done.stderr.split()
    assert not {"argparse", "msgspec", "typing", "queue", "textwrap"} & {*done.stderr.split()}


def test_a_failed_boot_step_does_not_report_again_what_is_above(monkeypatch, capsys):
    why = STATE["nodes"]["gone"]["error"]
    steps = [
        {"node": "gone", "step": "identify", "seconds": 0.5, "error": why},
        {"node": "left_drive", "step": "identify", "seconds": 0.5, "error": "another reason"},
    ]
    events = [{"time": 1.0, "kind": "boot_failed", "node": "gone", "level": "error", "text": why}]

    serve(monkeypatch, {**STATE, "boot": steps, "events": events})
    assert main(["status"]) == 0
    output = capsys.readouterr().out
    assert output.count("no answer") == 1
    assert "boot of gone: identify 500.0 ms failed; SDO: 0 read, 0 written, 0 failed\n" in output
    assert "boot of left_drive: identify 500.0 ms failed: another reason" in output


def test_the_last_line_reports_which_build_of_which_version_runs_the_robot(monkeypatch, capsys):
    serve(monkeypatch, {**STATE, "version": "1.2.3", "build": "compiled"})
    assert main(["status"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "canopen_control 1.2.3, compiled"


def test_how_well_joints_follow_stands_below_those_that_have_moved():
    tracking = {
        "interface": "position", "window_s": 10.0, "error_max": 0.00123, "error_rms": 0.0004,
        "error_max_since_enable": 0.02, "error_rms_since_enable": 0.001, "repeated": 2, "skipped": 1,
    }  # fmt: skip
    assert not any("tracking error" in line for line in render(sample_of(STATE)))
    joint = {**STATE["joints"]["left_wheel_joint"], "tracking": tracking}
    lines = render(sample_of({**STATE, "joints": {"left_wheel_joint": joint}}))
    place = next(number for number, line in enumerate(lines) if line.startswith("tracking error"))
    text = "left_wheel_joint 0.0012 rad 0.0004 rad 0.02 rad 0.001 rad 2 1"
    assert lines[place + 1].split() == text.split()


TWO_AXES = [{"joint": f"{side}_wheel_joint", "cia402_state": "QUICK_STOP_ACTIVE"} for side in ("left", "right")]


@pytest.mark.parametrize("axes", [TWO_AXES[:1], TWO_AXES])
@pytest.mark.parametrize("width", [40, 80, 100, 200])
def test_nothing_is_wider_than_the_terminal_and_hidden_columns_are_named(axes, width):
    node = {**STATE["nodes"]["left_drive"], "axes": axes, "error": "EMCY 0x4310: the drive is too hot " * 4}
    joints = {axis["joint"]: STATE["joints"]["left_wheel_joint"] for axis in axes}
    wide, lines = (
        render(sample_of({**STATE, "nodes": {"left_drive": node}, "joints": joints}), item) for item in (None, width)
    )
    assert max(map(len, lines)) <= width
    shown = " ".join(lines)
    for heading in ("node", "NMT", "CiA 402", "joint", "target", "actual rad/s", "position rad", "age ms"):
        assert heading in shown or width == 40, heading
    if width == 200:
        assert [line for line in lines if "EMCY" not in line] == [line for line in wide if "EMCY" not in line]


class Screen:
    """A terminal of some size, as far as a redraw needs one: rows that were written, and where it writes next."""

    def __init__(self, columns, lines):
        self.columns, self.lines = columns, lines
        self.rows, self.at = [], 0

    def isatty(self):
        return True

    def fileno(self):
        return 1

    def flush(self):
        pass

    def write(self, text):
        for up, what in re.findall(r"\x1b\[(\d+)A|([^\n\x1b]*)\n", re.sub(r"\x1b\[[KJ]", "", text)):
            if up:
                self.at -= int(up)
                continue
            for start in range(0, max(len(what), 1), self.columns):
                self.rows[self.at : self.at + 1] = [what[start : start + self.columns]]
                self.at += 1


def test_a_watch_on_a_terminal_of_80_by_24_stands_where_it_stood(monkeypatch):
    nodes = {
        f"drive_{number}": {**STATE["nodes"]["left_drive"], "node_id": number, "error": "EMCY 0x4310 " * 9}
        for number in range(2, 12)
    }

    class Robot:
        def ask(self, _request):
            return Done()

        def messages(self, _timeout):
            for _ in range(3):
                yield sample_of({**STATE, "nodes": nodes})
            raise RemoteError("BusClosed", "robot gone has closed the connection")

    screen = Screen(80, 24)
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setattr(RobotClient, "connect", lambda _name: contextlib.nullcontext(Robot()))
    monkeypatch.setattr("sys.stdout", screen)
    monkeypatch.setattr("os.get_terminal_size", lambda _descriptor: os.terminal_size((80, 24)))
    assert main(["status", "--watch"]) == 1
    assert len(screen.rows) == screen.at == 23
    assert screen.rows[0].startswith("running, cycle 7")
    assert "more lines" in screen.rows[-1]


def test_events_stand_above_the_live_table_in_the_order_in_which_they_came(monkeypatch):
    def warning(text, level="warning", kind="emcy"):
        return RobotEvent(time=1.0, kind=kind, node=None, level=level, text=text)

    class Robot:
        def ask(self, _request):
            return Done()

        def messages(self, _timeout):
            yield sample_of(STATE)
            yield warning("EMCY 0x4310")
            yield warning("x is active", level="info", kind="active")
            yield sample_of(STATE)
            yield warning("flight recording: a.zip", level="info", kind="flight")
            yield sample_of(STATE)
            yield warning("stopping: requested by a client", level="info", kind="stopping")
            yield sample_of(STATE)  # the robot's own process prints from here on
            yield warning("node lost", level="error")

    screen = Screen(120, 30)
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setattr(RobotClient, "connect", lambda _name: contextlib.nullcontext(Robot()))
    monkeypatch.setattr("sys.stdout", screen)
    monkeypatch.setattr("os.get_terminal_size", lambda _descriptor: os.terminal_size((120, 30)))
    assert main(["status", "--watch"]) == 0
    assert screen.rows[:2] == ["EMCY 0x4310", "flight recording: a.zip"]
    assert screen.rows[2].startswith("running, cycle 7")
    assert sum("cycle 7" in row for row in screen.rows) == 1
    assert screen.at == len(screen.rows)


def test_the_advice_of_a_cause_is_its_last_clause():
    lost = event(5.0, "node_lost", f"{LEFT}: lost: {SILENT}")
    stop = event(5.0, "stop", f"stopping a, b: {LEFT}: lost: {SILENT}; to continue: canopen-control axis enable all")
    line = f"error: {LEFT}: stopping a, b; to continue: canopen-control axis enable all"
    assert cause_lines([lost, stop], {"left_drive": f"{LEFT}: {SILENT}"}) == [line]


def test_ctrl_c_is_the_end_of_a_watch(monkeypatch, capsys):
    class Robot:
        def ask(self, _request):
            return Done()

        def messages(self, _timeout):
            yield sample_of(STATE)
            raise KeyboardInterrupt

    monkeypatch.setattr(RobotClient, "connect", lambda _name: contextlib.nullcontext(Robot()))
    assert main(["status", "--watch"]) == 0
    assert capsys.readouterr().out.startswith("running, cycle 7")
