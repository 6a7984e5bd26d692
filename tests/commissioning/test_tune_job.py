"""Tuning runs of a page on a drive in virtual time: results, ends, and gains that are set and reverted."""

import contextlib
import math

import pytest
from support.jogbench import NODE_ID, jog_bench
from support.onbus import GENERIC
from support.terminal import in_background
from support.tuneplant import COULOMB, COUNTS, INERTIA, loaded

from canopen_control.cia402.state import State
from canopen_control.cli.support.jog_robot import choose_tuned, own_robot
from canopen_control.cli.support.target import find_eds
from canopen_control.client import RobotClient
from canopen_control.commissioning.jobs import TUNE, JobRun, TuneOptions
from canopen_control.commissioning.jog_motion import JogKind
from canopen_control.commissioning.quantity import Quantity
from canopen_control.commissioning.tune_job import (
    SCALE,
    PagePresence,
    TuneFound,
    TunePlan,
    apply_gains,
    curves_of,
    request_of,
    revert,
    tune,
)
from canopen_control.commissioning.tune_run import TuneTest
from canopen_control.errors import CanopenError, ConfigError, DriveError
from canopen_control.od.eds import read_eds
from canopen_control.rpc.messages.robot import GetNodes, GetStatus, Stop
from canopen_control.runtime.observer import RobotObserver
from canopen_control.scaffold.new_robot import Device
from canopen_control.view.robot_view import NodeJobs


def plan(test=TuneTest.STEP, *, speed=3.0, torque=150.0, **options):
    chosen = TuneOptions(**options)
    request = request_of(test, chosen, 0.01, speed=Quantity(speed, "rad/s", "velocity"), torque=torque, signal="chirp")
    return TunePlan.of(request, chosen, SCALE)


class Page:
    """A page on a robot of the one drive."""

    def __init__(self, bench, client):
        self.bench, self.client = bench, client
        (place,) = client.ask(GetNodes()).nodes
        self.desk, self.work = NodeJobs(client.robot, place), JobRun(TUNE, "Tuning")
        self.presence = PagePresence(lambda: 0.0)

    def run(self, wish):
        tune_found = TuneFound(wish)
        with self.desk.session() as session, RobotClient.connect(self.client.robot) as client:
            reported = tune(session, self.work, client, tune_found, self.presence)
        return reported, tune_found

    @property
    def power(self):
        return self.bench.drive.drives[0].state


@contextlib.contextmanager
def page_for(kind):
    with jog_bench(channel="memory:pagetune", plant=lambda _axis: loaded()) as bench:
        device = Device(NODE_ID, find_eds(GENERIC), read_eds(find_eds(GENERIC), NODE_ID).od)
        robot = choose_tuned(device, kind, 10_000, allow_unsupervised=False)
        with (
            own_robot(robot, robot.joints[0].axis, bench.bus.channel, 100.0, RobotObserver()) as drive,
            RobotClient.connect(drive.robot) as client,
        ):
            yield Page(bench, client)


def test_a_step_is_found_with_its_curves_and_is_in_the_events(private_folders):
    with page_for(JogKind.VELOCITY) as page:
        reported, result = page.run(plan(seconds=1.0))
        events = [event.text for event in page.client.ask(GetStatus()).events]
        assert page.power is not State.OPERATION_ENABLED
    assert reported.endswith("step done, stopped and disabled")
    assert "overshoot" in result.lines[1]
    assert result.curves.names[:3] == ("command", "velocity", "position")
    assert result.curves.shot.rows[-10][1][1] == pytest.approx(3.0, rel=0.02)
    assert any(text.startswith("page: a step to 3.00 rad/s") for text in events)
    assert page.work.done > 90


@pytest.mark.rest
def test_a_plant_is_identified_and_its_gains_are_set_and_taken_back(private_folders):
    with page_for(JogKind.TORQUE) as page:
        _, result = page.run(plan(TuneTest.IDENTIFY, torque=190.0, crossover=10.0))
        value = {line[:19].strip(): float(line[19:].split()[0]) for line in result.lines[:3]}
        assert value["inertia"] == pytest.approx(INERTIA, rel=0.03)
        assert value["Coulomb friction"] == pytest.approx(COULOMB, rel=0.03)
        before = page.bench.get(0x60F9, 1)
        with page.desk.session() as session:
            apply_gains(session, page.work, result.gains, COUNTS * math.tau, stores=False)
        now = page.bench.get(0x60F9, 1)
        assert now * 1e-5 * COUNTS == pytest.approx(result.gains.velocity_p, rel=1e-3)
        with page.desk.session() as session:
            assert "previous gains restored" in revert(session, page.work, stores=False)
        assert page.bench.get(0x60F9, 1) == before != now
        assert any("0x60F9:01" in line for line in page.work.lines)


@pytest.mark.rest
def test_a_page_that_goes_ends_it_at_once(private_folders):
    with page_for(JogKind.VELOCITY) as page:
        seconds = iter([0.0, *[0.0] * 60, *[5.0] * 1000])
        page.presence = PagePresence(lambda: next(seconds))
        with pytest.raises(DriveError, match="the page that started the run was closed: stopped and disabled"):
            page.run(plan(seconds=1.0))
        assert page.power is not State.OPERATION_ENABLED
        assert page.bench.speed == pytest.approx(0.0, abs=200)


@pytest.mark.rest
@pytest.mark.parametrize("end", ["STOP", "button"])
def test_stop_and_the_button_end_it(private_folders, end):
    with page_for(JogKind.VELOCITY) as page:

        def press():
            import time

            while page.bench.speed < 1000:
                time.sleep(0.02)
            if end == "STOP":
                page.client.ask(Stop(source="test"))
            else:
                page.work.end()

        with in_background(press), pytest.raises(CanopenError):
            page.run(plan(seconds=8.0))
        assert page.power is not State.OPERATION_ENABLED
        assert 0 < page.work.done < 700


@pytest.mark.parametrize(
    ("wish", "why"),
    [
        ({"speed": 0.0}, "causes no motion"),
        ({"speed": 9.0}, "exceeds the limit"),
        ({"test": TuneTest.IDENTIFY, "torque": 200.0, "max_current": 100.0}, "exceeds --max-current"),
        ({"test": TuneTest.BODE, "seconds": 0.1}, "too short"),
    ],
)
def test_what_is_beyond_the_limits_is_reported_before_anything_moves(wish, why):
    with pytest.raises(ConfigError, match=why):
        plan(**wish)


def test_what_is_confirmed_reports_what_moves_within_which_limits():
    words = plan(seconds=1.0, max_speed=Quantity(60.0, "rpm", "velocity")).lines(SCALE)
    assert words[0].startswith("excitation: a step to 3.00 rad/s")
    assert words[1] == "limits: 6.28 rad/s (60.0 rpm), 3600.0 deg in each direction,"
    assert words[2].startswith("        current 100 % of the rated current, exceeded for 0.1 s")
    assert curves_of is not None
