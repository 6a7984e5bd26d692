import cmath
import json
import math
import signal

import pytest
from support.jogbench import jog_bench
from support.onbus import GENERIC, TMCM
from support.suspension import suspend_after
from support.tuneplant import COULOMB, COUNTS, INERTIA, VISCOUS, loaded

from canopen_control.cia402.state import State
from canopen_control.cli.main import main
from canopen_control.commissioning.tune_gains import CascadeGains, PlantModel, phase_margin
from canopen_control.rpc.messages.robot import CommandController

TURN = 65536
TRUE_PLANT = PlantModel(INERTIA, VISCOUS, COULOMB, 0.0, 0.0, 1.0)  # of the motor; `tune` does not get it


@pytest.fixture
def bench(private_folders):
    with jog_bench(channel="memory:tune", plant=lambda _axis: loaded()) as bench:
        yield bench


def gains_in(bench):
    """Return the gains that the drive has, of the shaft in rad."""
    p, i = (bench.get(0x60F9, sub) * 1e-5 * COUNTS for sub in (1, 2))
    return CascadeGains(p, p / i, bench.get(0x60FB, 1) * 1e-3, 0.0, 0.0)


def value_of(said, words):
    line = next(line for line in said.splitlines() if line.startswith(words))
    return float(line.removeprefix(words).split()[0])


@pytest.mark.rest
def test_a_step_is_measured_and_leaves_the_drive_off(bench, no_terminal, capsys, tmp_path):
    file = tmp_path / "step.csv"
    assert bench.verb("tune", "--step", "30rpm", "--for", "1", "--yes", "-o", str(file)) == 0
    output = capsys.readouterr().out
    assert "velocity in CSV, a sample every 10 ms" in output
    assert "excitation: a step to 3.14 rad/s (30.0 rpm) for 1 s" in output
    assert 0 <= value_of(output, "rise (10 to 90 %)") < 200
    assert "settled to 2 %" in output
    assert bench.drive.drives[0].state is State.SWITCH_ON_DISABLED
    rows = file.read_text().splitlines()
    assert rows[0] == "time_s,command,position_rad,velocity_rad_s,torque_permille"
    assert len(rows) > 100


@pytest.mark.parametrize(
    ("number", "why"), [(signal.SIGINT, "interrupted by a signal"), (signal.SIGCONT, "this program was suspended")]
)
def test_a_signal_ends_the_run_without_a_result(bench, no_terminal, monkeypatch, capsys, number, why):
    suspend_after(monkeypatch, CommandController, 3, 0.2, number)
    assert bench.verb("tune", "--step", "30rpm", "--for", "5", "--yes") == 1
    assert f"{why}: stopped and disabled; an incomplete run has no result" in capsys.readouterr().err
    assert bench.drive.drives[0].state is State.SWITCH_ON_DISABLED


@pytest.mark.rest
def test_inertia_and_friction_are_identified_and_gains_proposed(bench, no_terminal, capsys):
    assert bench.verb("tune", "--identify", "190", "--yes", "--crossover", "10") == 0
    output = capsys.readouterr().out
    assert value_of(output, "inertia") == pytest.approx(INERTIA, rel=0.03)
    assert value_of(output, "Coulomb friction") == pytest.approx(COULOMB, rel=0.03)
    assert value_of(output, "viscous friction") == pytest.approx(VISCOUS, rel=0.03)
    assert "for a crossover of 10 Hz and a phase margin of 60 degrees" in output
    assert value_of(output, "position P") == pytest.approx(15.71, rel=0.01)


@pytest.mark.rest
def test_programs_get_json_and_a_picture_of_the_response(bench, no_terminal, capsys, tmp_path):
    file = tmp_path / "bode.png"
    assert bench.verb("tune", "--bode", "--for", "2", "--yes", "--json", "-o", str(file)) == 0
    output = capsys.readouterr()
    reported = json.loads(output.out)
    assert reported["bode"]["points"][0]["frequency"] > 0.0
    assert f"written: {file}" in output.err
    assert file.read_bytes().startswith(b"\x89PNG")


def test_a_frequency_response_is_a_table_and_a_file(bench, no_terminal, capsys, tmp_path):
    file = tmp_path / "bode.csv"
    assert bench.verb("tune", "--bode", "--for", "2", "--yes", "-o", str(file)) == 0
    assert "bandwidth (-3 dB): " in capsys.readouterr().out
    first = file.read_text().splitlines()[1].split(",")
    assert float(first[1]) == pytest.approx(0.0, abs=1.0)  # dB: a slow velocity is followed


def true_response(gains, cycle):
    """Return the velocity loop's answer to a command of one cycle, sampled in each: 0.5 ms PI on the true motor."""
    step, inertia = 0.0005, INERTIA
    kept = math.exp(-VISCOUS / inertia * step)
    speed = torque = integral = 0.0
    answer = []
    for point in range(400 * round(cycle / step)):
        if point % round(cycle / step) == 0:
            answer.append(speed)
        speed = kept * speed + (1 - kept) / VISCOUS * torque
        missing = (1.0 if point < round(cycle / step) else 0.0) - speed
        integral += gains.velocity_i * missing * step
        torque = gains.velocity_p * missing + integral
    return answer


@pytest.mark.rest
@pytest.mark.parametrize("signal", ["chirp", "prbs"])
def test_the_response_of_drive_and_bus_is_true_within_a_decibel_and_five_degrees(
    bench, no_terminal, capsys, tmp_path, signal
):
    """To a third of the sampling rate; the way over the bus is whole cycles, as many as fit best."""
    for subindex, gain in ((1, 6900), (2, 236_000)):  # of a crossover of about 10 Hz
        assert main(["sdo", "write", "5", f"0x60F9:{subindex}", str(gain), *bench.words]) == 0
    file = tmp_path / "bode.csv"
    assert bench.verb("tune", "--bode", signal, "--for", "4", "--yes", "-o", str(file)) == 0
    points = [[float(cell) for cell in line.split(",")] for line in file.read_text().splitlines()[1:]]
    assert points[-1][0] > 0.9 * 100 / 3
    answer = true_response(gains_in(bench), 0.01)

    def true(hertz):
        turn = -2j * math.pi * hertz * 0.01
        return sum(value * cmath.exp(turn * number) for number, value in enumerate(answer))

    result = [(hertz, true(hertz), gain, phase) for hertz, gain, phase, _ in points]
    assert max(abs(20 * math.log10(abs(truth)) - gain) for _, truth, gain, _ in result) < 1.0

    def off(late):
        """Return by how many degrees each phase is wrong if the bus takes so many cycles."""
        return [
            abs((math.degrees(cmath.phase(truth)) - 3.6 * hertz * late - phase + 180) % 360 - 180)
            for hertz, truth, _, phase in result
        ]

    assert min(max(off(late)) for late in range(5)) < 5.0


@pytest.mark.rest
@pytest.mark.parametrize(
    ("words", "why", "degrees"),
    [
        (
            ("--max-travel", "20deg"),
            "the travel limit is reached: stopped and disabled; an incomplete run has no result",
            30,
        ),
        # a tenth of a second at 180 degrees in a second, and the ramp of 14 degrees from that
        (
            ("--max-current", "5"),
            "an incomplete run has no result; use a weaker excitation, or raise --max-current if that is safe",
            60,
        ),
    ],
)
def test_a_limit_ends_it_within_the_limit(bench, no_terminal, capsys, words, why, degrees):
    assert bench.verb("tune", "--step", "30rpm", "--yes", *words) == 1
    assert why in capsys.readouterr().err
    assert bench.drive.drives[0].state is State.SWITCH_ON_DISABLED
    assert abs(bench.get(0x6064)) < TURN * degrees / 360


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--step", "30rpm"), "nothing moves unless the limits are confirmed: give --yes"),
        (("--step", "90rpm", "--yes"), "exceeds the limit of 6.28 rad/s"),
        (("--step", "0", "--yes"), "causes no motion"),
        (("--identify", "200", "--max-current", "100", "--yes"), "exceeds --max-current 100"),
        (("--step", "30rpm", "--yes", "-o", "step.txt"), "give NAME.csv"),
        (("--step", "30rpm", "--yes", "--axis", "2"), "node 5 has no axis 2"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_moves(bench, no_terminal, capsys, words, why):
    assert bench.verb("tune", *words) == 2
    assert why in capsys.readouterr().err
    assert bench.drive.drives[0].state is State.SWITCH_ON_DISABLED


def test_without_a_terminal_the_limits_are_reported_that_yes_would_confirm(bench, no_terminal, capsys):
    assert bench.verb("tune", "--step", "30rpm") == 2
    output = capsys.readouterr()
    assert "excitation: a step to 3.14 rad/s (30.0 rpm)" in output.out
    assert "limits: 6.28 rad/s (60.0 rpm)" in output.out
    assert "give --yes" in output.err
    assert bench.drive.drives[0].state is State.SWITCH_ON_DISABLED


def test_an_answer_that_is_not_a_yes_moves_nothing(bench, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda _prompt: "n")
    assert bench.verb("tune", "--step", "30rpm") == 2
    assert "not confirmed; nothing moved" in capsys.readouterr().err


def test_a_drive_without_a_torque_mode_is_reported(private_folders, no_terminal, capsys):
    with jog_bench(TMCM, "memory:tune_stepper") as bench:
        assert bench.verb("tune", "--identify", "100", "--yes") == 2
    assert "its modes are PP, PV, HM, CSP (0x6502)" in capsys.readouterr().err
    assert main(["tune", "5", "--can", "local:nobody", "--eds", GENERIC, "--step", "30rpm", "--yes"]) == 2


@pytest.mark.rest
def test_proposed_gains_are_set_and_taken_back(bench, no_terminal, capsys):
    words = ("--identify", "190", "--yes", "--crossover", "10", "--apply")
    before = [bench.get(0x60F9, 1), bench.get(0x60F9, 2), bench.get(0x60FB, 1)]
    assert bench.verb("tune", *words) == 0
    output = capsys.readouterr().out
    assert f"tune 5 --can {bench.bus.channel} --eds {bench.eds} --revert" in output
    p = value_of(output, "velocity P")
    assert bench.get(0x60F9, 1) * 1e-5 * TURN / math.tau == pytest.approx(p, rel=1e-3)
    assert bench.get(0x60FB, 1) == pytest.approx(15_708, abs=2)
    crossover, margin = phase_margin(TRUE_PLANT, gains_in(bench))
    assert math.degrees(margin) == pytest.approx(60.0, abs=3.0)
    assert crossover == pytest.approx(10 * math.tau, rel=0.03)
    assert bench.verb("tune", "--revert") == 0
    assert "0x60F9:01 Velocity loop proportional gain: " in capsys.readouterr().out
    assert [bench.get(0x60F9, 1), bench.get(0x60F9, 2), bench.get(0x60FB, 1)] == before
    assert bench.verb("tune", "--revert") == 1
    assert "nothing can be reverted" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--step", "30rpm", "--apply"), "--apply sets the gains that --identify proposes"),
        (("--step", "30rpm", "--store"), "--store requires --apply or --revert"),
        (("--step", "30rpm", "--gain", "velocity_p=0x3210:01*1"), "add --apply"),
        (("--identify", "100", "--apply", "--gain", "p=1"), "give the gain, its object"),
        (("--identify", "100", "--apply", "--gain", "velocity_p=0x3210:01*1"), "has no 0x3210:01 in its EDS"),
    ],
)
def test_gains_that_cannot_be_set_are_reported_before_anything_moves(bench, no_terminal, capsys, words, why):
    assert bench.verb("tune", *words, "--yes") == 2
    assert why in capsys.readouterr().err
    assert bench.drive.drives[0].state is State.SWITCH_ON_DISABLED
