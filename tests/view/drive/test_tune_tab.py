"""The Tune tab for a simulated user: nothing moves without a confirmation, and results are shown."""

import contextlib

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from msgspec import structs
from support.pages import FORWARD, TARGET, FakeContext, StubDesk, drive_state, html, settle, state, visited
from support.service_node import NodeStub

from canopen_control.commissioning.frequency_response import Bode, BodePoint
from canopen_control.commissioning.jog_motion import JogLimits
from canopen_control.commissioning.scope_capture import NamedShot, Shot
from canopen_control.commissioning.tune_gains import CascadeGains
from canopen_control.commissioning.tune_job import TuneFound, TunePlan
from canopen_control.commissioning.tune_run import TuneRequest, TuneTest
from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.view.drive.drive_tab import DriveTabContext
from canopen_control.view.drive.tune_tab import TuneTab

OD = read_eds(data_path("eds", "generic_cia402.eds"), 3).od


class Desk(StubDesk):
    """Takes what is begun and runs nothing."""

    def __init__(self):
        super().__init__(NodeStub({}), OD)
        self.begun = []

    def begin(self, work, function):
        self.begun.append((work, function))
        self.work = work


@contextlib.asynccontextmanager
async def played(*, teleop=True, joints=("left",), controllers=None, new=None):
    taking = controllers or [TARGET | {"name": joint, "joints": [joint]} for joint in joints]
    page, desk = FakeContext(teleop=teleop, controllers=taking), Desk()
    desk.place = structs.replace(desk.place, joints=list(joints))

    async with visited(lambda: TuneTab(DriveTabContext(page, desk))) as (user, tab):
        tab.show(page.content(new or drive_state({"cia402_state": "SWITCH_ON_DISABLED"})))
        yield user, tab, page, desk.begun


def found(test=TuneTest.IDENTIFY, **more):
    rows = tuple((n / 100, (1.0, 0.5, 0.1 * n)) for n in range(5))
    curves = NamedShot(Shot(rows), ("command", "velocity", "position"), ("rad/s", "rad/s", "rad"))
    return TuneFound(
        TunePlan(TuneRequest(test, 2.0, 0.01), JogLimits(6.0, 60.0, 1000.0)), curves, lines=["inertia <1>"], **more
    )


@pytest.mark.rest
async def test_a_run_begins_only_once_it_is_confirmed_and_as_it_was_confirmed():
    async with played() as (user, tab, _page, begun):
        tab._speed.value = 2.0
        user.find("Run ...").click()
        words, before = html(user), len(tab._node_jobs.begun)
        tab._speed.value = 5.0
        user.find("Start the motion").click()
        await settle(lambda: bool(tab._node_jobs.begun))
        tab._begin()
        present = tab._presence._props["on"]
    assert "a step to 2.00 rad/s (19.1 rpm) for 2 s" in words
    assert (before, present, len(begun)) == (0, True, 1)


@pytest.mark.rest
async def test_a_page_that_is_left_ends_its_run():
    async with played() as (user, tab, _page, _begun):
        user.find("Run ...").click()
        user.find("Start the motion").click()
        await settle(lambda: bool(tab._node_jobs.begun))
        tab.leave()
        assert (tab._node_jobs.work._ending.is_set(), tab._presence._props["on"]) == (True, False)


async def test_what_is_beyond_the_limits_opens_no_question():
    async with played() as (user, tab, _page, begun):
        tab._speed.value = 50.0
        user.find("Run ...").click()
        tab._begin()
        assert "exceeds the limit of" in html(user)
    assert begun == []


async def test_a_read_only_page_moves_and_sets_nothing():
    async with played(teleop=False) as (_user, tab, page, begun):
        tab._ask()
        tab._begin()
        tab._node_jobs.tuned = found(gains=CascadeGains(1.0, 0.1, 2.0, 60.0, 1.0))
        tab._begin_apply()
        tab._begin_revert()
        tab.show(page.content())
        assert not any(button.enabled for button in (tab._run, tab._apply, tab._revert))
    assert begun == []


async def test_what_was_found_is_shown_and_its_gains_are_set_with_the_units_of_a_turn():
    async with played() as (user, tab, page, begun):
        tab._node_jobs.tuned = found(
            gains=CascadeGains(1.0, 0.1, 2.0, 60.0, 1.0),
            bode=Bode((BodePoint(1.0, 0.0, -5.0, 1.0), BodePoint(10.0, -3.0, -60.0, 0.99))),
        )
        tab.show(page.content())
        lines = html(user)
        user.find("Set the gains").click()
        refused = html(user)
        tab._form.inputs["counts"].value = "65536"
        user.find("Set the gains").click()
        await settle(lambda: bool(tab._node_jobs.begun))
        first, phase = tab._chart.options["series"][0]["name"], tab._bode.options["series"][1]["data"]
    assert "inertia &lt;1&gt;" in lines
    assert "enter the counts per revolution" in refused
    assert (first, phase) == ("command", [(1.0, -5.0), (10.0, -60.0)])
    assert begun[0][1].keywords["counts"] == 65536.0


async def test_each_test_shows_what_it_has():
    async with played() as (_user, tab, _page, _begun):
        shown = {}
        for test in TuneTest:
            tab._test.value = test.name
            inputs = (tab._speed, tab._signal, tab._torque, tab._form.inputs["crossover"])
            shown[test] = [item.visible for item in inputs], tab._plan().request.seconds

    assert shown[TuneTest.STEP] == ([True, False, False, False], 2.0)
    assert shown[TuneTest.BODE] == ([False, True, False, False], 8.0)
    assert shown[TuneTest.IDENTIFY] == ([False, False, True, True], 8.0)


async def test_of_a_drive_with_several_axes_one_is_chosen_and_named():
    async with played(joints=("shoulder", "elbow")) as (user, tab, _page, _begun):
        shown = tab._axis.visible
        tab._axis.value = 1
        user.find("Run ...").click()
        words = html(user)
        user.find("Start the motion").click()
        await settle(lambda: bool(tab._node_jobs.begun))
        axis = tab._plan().axis
    assert (shown, axis) == (True, 1)
    assert "Move left_drive, axis 1?" in words


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ({"controllers": [FORWARD]}, "forward commands left, and only one client may move it"),
        ({"controllers": [TARGET | {"state": "inactive"}]}, "No active controller accepts targets for left"),
        ({"joints": (), "controllers": [FORWARD]}, "left_drive moves no joint of pair"),
        ({"new": state(latched=True)}, "STOP is latched: release it"),
    ],
)
async def test_a_run_that_would_be_refused_is_not_offered_and_why_is_reported(how, why):
    async with played(**how) as (user, tab, _page, _begun):
        assert not tab._run.enabled
        assert why in html(user)
