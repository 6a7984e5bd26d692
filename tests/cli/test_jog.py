import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import time

import pytest
from support.drive_shapes import SHAPES, write_shape
from support.host import eventually
from support.jogbench import NODE_ID, jog_bench
from support.mockrobot import running
from support.onbus import TMCM
from support.processes import DriveProbe, seconds_until
from support.suspension import suspend_after
from support.terminal import in_background, typed

from canopen_control.cia402.state import State
from canopen_control.cli.main import main
from canopen_control.client import find_robots
from canopen_control.host.signals import LONGEST_SUSPENSION_S
from canopen_control.rpc.messages.robot import CommandController

TURN = 65536  # counts of the generic drive
DEAD_MAN_S = 0.5


@pytest.fixture
def bench(private_folders):
    with jog_bench() as bench:
        yield bench


# -- it turns


def test_a_velocity_for_a_time_turns_and_leaves_the_drive_off(bench, no_terminal, capsys):
    assert bench.jog("--velocity", "60rpm", "--for", "0.5") == 0
    assert bench.drive.drives[0].state is State.SWITCH_ON_DISABLED
    assert 0.2 * TURN < bench.get(0x6064) < 1.5 * TURN
    output = capsys.readouterr().out
    assert "limits: 6.28 rad/s (60.0 rpm), 3600.0 deg in each direction" in output
    assert "dead-man: the drive monitors this computer's heartbeat (0x1016)" in output
    assert "OPERATION ENABLED, " in output
    assert output.endswith("duration elapsed: stopped and disabled\n")


def test_json_names_the_node_and_no_joint_without_a_robot(bench, no_terminal, capsys):
    assert bench.jog("--position", "5deg", "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["node"], document["joint"]) == (str(NODE_ID), None)
    assert document["travelled"] == pytest.approx(0.0873, abs=0.01)


def test_a_position_is_gone_to_from_where_the_drive_is(bench, no_terminal):
    for turned in (1, 2):
        assert bench.jog("--position", "30deg", "--max-speed", "40rpm") == 0
        assert bench.get(0x6064) == pytest.approx(turned * TURN / 12, abs=TURN / 100)


def test_held_keys_turn_it_both_ways_and_their_release_stops_it(bench, monkeypatch, capsys):
    with typed(monkeypatch) as terminal:

        def hold(key, seconds=0.9):
            begin = time.monotonic()
            while time.monotonic() - begin < seconds:
                terminal.write(key)
                time.sleep(0.04)

        def user():
            assert eventually(lambda: bench.drive.drives[0].state is State.OPERATION_ENABLED)
            time.sleep(0.1)
            hold(b"\x1b[C")
            assert bench.speed > 0
            assert seconds_until(lambda: bench.speed == 0, 2.0) < 0.8
            hold(b"\x1b[D")
            assert bench.speed < 0
            terminal.write(b"\x03")

        with in_background(user, terminal.close):
            assert bench.jog("--velocity", "1rad/s") == 0
    assert "ended by a key: stopped and disabled" in capsys.readouterr().out
    assert bench.drive.drives[0].state is State.SWITCH_ON_DISABLED


def test_a_drive_with_unknown_units_is_turned_in_counts(private_folders, no_terminal, capsys):
    with jog_bench(TMCM, "memory:counts") as bench:
        assert bench.jog("--velocity", "500pps", "--for", "0.5") == 0
        assert 0 < bench.get(0x6064) < 500
        assert "counts per turn unknown, as neither EDS nor drive" in capsys.readouterr().out
        assert bench.jog("--velocity", "10rpm", "--for", "1") == 2
        assert "give it with --counts N, or use raw units: pps or counts/s" in capsys.readouterr().err
        assert bench.jog("--velocity", "10rpm", "--for", "0.5", "--counts", "1600") == 0


# -- what it refuses


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--velocity", "nan", "--for", "1"), "'nan' is not a velocity that a drive could reach"),
        (("--velocity", "0", "--for", "1"), "moves nothing; give another value"),
        (("--velocity", "500rpm", "--for", "1"), "500rpm exceeds the limit of 6.28 rad/s (60.0 rpm); if safe"),
        (("--position", "20turns"), "20turns exceeds the limit of 3600.0 deg; if safe, raise the limit with --max-tr"),
        (("--axis", "3", "--for", "1"), "node 5 has no axis 3; it has 1, counted from 0"),
        ((), "so keys cannot be read; give a duration with --for S"),
    ],
)
def test_what_is_not_a_jog_is_refused_before_anything_moves(bench, no_terminal, capsys, words, why):
    assert bench.jog(*words) == 2
    assert why in capsys.readouterr().err
    assert bench.drive.drives[0].state is State.SWITCH_ON_DISABLED


def test_another_device_than_the_eds_describes_is_refused(bench, no_terminal, capsys):
    assert bench.jog("--for", "1", eds=TMCM) == 2
    assert "node 5 is not the device of TMCM-1270.eds: vendor 0x00000286 in the EDS, 0x" in capsys.readouterr().err
    assert bench.jog("--for", "1", eds="generic_cia401.eds") == 2
    assert "so the device is not a CiA 402 drive" in capsys.readouterr().err


def test_a_fault_is_reported_and_reset_only_on_demand_which_moves_nothing(bench, no_terminal, capsys):
    axis = bench.drive.drives[0]
    bench.bus.call(lambda: axis.fault(0x3220, bench.bus.reactor.now()))
    assert bench.jog("--for", "1") == 1
    error_output = capsys.readouterr().err
    assert "node 5 has a fault: 0x3220" in error_output
    assert "--fault-reset" in error_output
    assert bench.jog("--fault-reset") == 0
    assert axis.state is State.SWITCH_ON_DISABLED
    assert bench.jog("--fault-reset") == 1
    assert "nothing was reset, because node 5 " in capsys.readouterr().err
    assert bench.get(0x6064) == 0
    assert bench.jog("--for", "0.3") == 0


def test_a_drive_that_a_dead_program_left_enabled_is_refused_with_the_command_that_disables_it(
    bench, no_terminal, capsys
):
    assert main(["nmt", "start", "5", "--can", bench.bus.channel]) == 0
    for index, value in ((0x6060, "3"), (0x6040, "6"), (0x6040, "7"), (0x6040, "15")):
        assert main(["sdo", "write", "5", f"0x{index:04X}", value, *bench.words]) == 0
    axis = bench.drive.drives[0]
    assert axis.state is State.OPERATION_ENABLED
    assert bench.jog("--for", "0.3") == 1
    error = capsys.readouterr().err
    assert "another program has enabled it" in error
    command = error.split("disable the drive with: canopen-control ")[1].split()
    assert main(command) == 0
    assert axis.state is State.READY_TO_SWITCH_ON
    assert bench.jog("--for", "0.3") == 0


def test_a_drive_that_its_robot_commands_is_left_to_it(private_folders, no_terminal, capsys):
    with running():
        assert main(["jog", "2", "--for", "1"]) == 2
    assert "has no node '2'" in capsys.readouterr().err  # mock hardware has none


# -- it stops, whatever happens


@pytest.mark.parametrize(
    ("number", "code", "why"),
    [
        (signal.SIGINT, 130, "interrupted by a signal"),
        (signal.SIGTERM, 130, "interrupted by a signal"),
        (signal.SIGHUP, 0, "the terminal was closed"),
        (signal.SIGCONT, 1, "this program was suspended"),
    ],
)
def test_a_signal_without_a_terminal_ends_it_and_is_reported(
    bench, no_terminal, monkeypatch, capsys, number, code, why
):
    requested = suspend_after(monkeypatch, CommandController, 2, LONGEST_SUSPENSION_S + 0.1, number)
    assert bench.jog("--velocity", "60rpm", "--for", "60") == code
    assert capsys.readouterr().out.endswith(f"{why}: stopped and disabled\n")
    assert not any(value for item in requested[2:] for value in item.values)
    assert bench.drive.drives[0].state is State.SWITCH_ON_DISABLED


@contextlib.contextmanager
def jog_on_a_terminal(stage, channel, eds=TMCM):
    """Start `jog` on a terminal of its own; yield the process and that terminal's end, a file that may be closed."""
    number, slave = pty.openpty()
    words = ["jog", str(NODE_ID), "--can", channel, "--eds", str(eds), "--velocity", "650pps"]
    code = (
        "import fcntl, sys, termios\nfrom canopen_control.cli.main import main\nfcntl.ioctl(0, termios.TIOCSCTTY, 0)\n"
    )
    with os.fdopen(number, "r+b", buffering=0) as master:
        process = subprocess.Popen(
            [sys.executable, "-c", f"{code}sys.exit(main({words!r}))"],
            cwd=stage.place,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
        )
        os.close(slave)
        try:
            yield process, master
        finally:
            process.kill()
            process.wait(60)


def held_until(master, condition, seconds=30.0):
    """Hold the arrow key down until `condition`."""
    os.set_blocking(master.fileno(), False)
    begin = time.monotonic()
    while not condition():
        assert time.monotonic() - begin < seconds
        master.write(b"\x1b[C")  # None, and no error, without a reader
        master.read(65536)
        time.sleep(0.03)
    return time.monotonic() - begin


@pytest.mark.process
@pytest.mark.timed
@pytest.mark.parametrize("end", ["terminal", "SIGKILL"])
def test_it_turns_soon_and_stops_by_itself_when_its_terminal_or_the_program_dies(stage, end):
    stage.drive("desk", NODE_ID)
    with (
        contextlib.closing(DriveProbe("desk", NODE_ID)) as drive,
        jog_on_a_terminal(stage, "local:desk") as (process, master),
    ):
        assert held_until(master, lambda: drive.speed > 300) < 30.0
        if end == "terminal":
            master.close()
        else:
            process.send_signal(signal.SIGKILL)
        assert seconds_until(lambda: drive.speed == 0, 5.0) < DEAD_MAN_S
        assert eventually(lambda: drive.power != "OPERATION_ENABLED")
        assert process.wait(60) == (0 if end == "terminal" else -signal.SIGKILL)
    assert find_robots() == []


@pytest.mark.process
@pytest.mark.timed
def test_a_drive_that_is_guarded_alone_stops_by_itself_when_the_program_is_killed(stage, tmp_path):
    eds = write_shape(tmp_path, SHAPES["node guarding, no heartbeat"][0]())
    stage.start("drive", "--node-id", NODE_ID, "--eds", eds, "--can", "local:desk").until("ready on")
    with (
        contextlib.closing(DriveProbe("desk", NODE_ID)) as drive,
        jog_on_a_terminal(stage, "local:desk", eds) as (process, master),
    ):
        held_until(master, lambda: drive.speed > 300)
        process.send_signal(signal.SIGKILL)
        assert seconds_until(lambda: drive.speed == 0, 5.0) < DEAD_MAN_S
        assert eventually(lambda: drive.power != "OPERATION_ENABLED")
