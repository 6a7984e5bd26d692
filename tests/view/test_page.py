"""A whole page of robby, made of what a robot on mock hardware says of itself."""

import copy

import pytest
from support.mockrobot import running

from canopen_control.view.link import Link
from canopen_control.view.page import Page
from canopen_control.view.scene import BASE

DRIVE = {
    "bus": "can", "node_id": 3, "nmt_state": "OPERATIONAL", "ready": True, "age_s": 0.01, "error": None,
    "axes": [{"joint": "left_wheel_joint", "cia402_state": "OPERATION_ENABLED", "mode": "PV", "error": None}],
}  # fmt: skip


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """Return what robby says: welcome, and a sample of the stream."""
    folder = tmp_path_factory.mktemp("p")
    folder.chmod(0o700)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        patch.setenv("XDG_STATE_HOME", str(folder))
        with running():
            link = Link("mock")
            welcome, controllers = link.welcome(), link.controllers()
            link.subscribe(50.0)
            state = None
            while state is None:
                state = next((each["state"] for each in link.messages() if "state" in each), None)
            link.close()
    welcome.status["nodes"]["left_drive"] = copy.deepcopy(DRIVE)
    return welcome, controllers, state | {"nodes": {"left_drive": DRIVE}}


class Robot:
    def stop(self):
        pass

    def ask(self, method, params):
        pass

    def hold(self, page, motion, told):
        pass


@pytest.fixture
def make(server, said):
    def make(**how):
        page = Page(server, said[0], Robot(), **({"teleop": False} | how))
        page.controllers(said[1])
        return page

    return make


@pytest.fixture
def state(said):
    return copy.deepcopy(said[2])


def test_everything_is_on_the_page(server, make, parts, state):
    page = make()
    page.state(state, seen=True)
    assert {"STOP", "Release STOP", "left_drive", "Camera follows"} <= set(parts())
    assert server.scene.get_handle_by_name(f"{BASE}/base_footprint/base_link/left_wheel") is not None
    assert "enabled, follows commands" in page._table._handle.content
    assert "running" in page._head._handle.content
    assert page.notes == []


def test_driving_is_there_with_teleop_alone(server, make, parts):
    make()
    assert "Hold to drive" not in parts()
    server.gui.reset()
    make(teleop=True)
    assert "Hold to drive" in parts()


def test_wheels_turn_with_every_sample_and_the_base_with_the_odometry(server, make, state):
    page = make()
    wheel = server.scene.get_handle_by_name(f"{BASE}/base_footprint/base_link/left_wheel")
    state["joints"]["left_wheel_joint"]["position"] = 3.14159
    page.state(state, seen=True)
    assert wheel.wxyz[2] == pytest.approx(1.0, abs=1e-4)
    assert tuple(server.scene.get_handle_by_name(BASE).position) == (0, 0, 0)
    state["odometry"] = {"base": {"x": 1.0, "y": 2.0, "heading": 0.0}}
    page.state(state, seen=True)
    assert tuple(server.scene.get_handle_by_name(BASE).position) == (1, 2, 0)


def test_while_nobody_looks_only_the_plots_remember(server, make, state):
    page = make()
    wheel = server.scene.get_handle_by_name(f"{BASE}/base_footprint/base_link/left_wheel")
    state["joints"]["left_wheel_joint"] |= {"position": 1.0, "velocity": 7.0}
    page.state(state, seen=False)
    assert wheel.wxyz[2] == 0.0
    assert page._plots.history.columns(["left_wheel_joint actual"])[1].tolist() == [7.0]


def test_a_latched_stop_and_its_way_out_are_shown(make, parts, state):
    page = make()
    page.state(state | {"latched": True, "latched_by": "view"}, seen=True)
    assert "Latched by view" in page._alarm._handle.content
    assert parts()["Release STOP"].visible


def test_a_fault_is_red_in_table_and_scene(server, make, state):
    page = make()
    state["nodes"]["left_drive"]["axes"][0] |= {"cia402_state": "FAULT", "error": "overtemperature"}
    page.state(state, seen=True)
    assert "overtemperature" in page._table._handle.content
    tyre = server.scene.get_handle_by_name(f"{BASE}/base_footprint/base_link/left_wheel/visual_0")
    assert tuple(tyre.color) == (214, 40, 40)


def test_events_are_shown_with_the_next_update(make, state):
    page = make()
    page.event({"time": state["time"], "kind": "x", "node": None, "level": "warning", "text": "something happened"})
    page.state(state, seen=True)
    assert "something happened" in page._log._handle.content


def test_what_repeats_itself_stands_there_once(make, state):
    page = make()
    for _ in range(3):
        page.event({"time": 1.0, "kind": "sync_overrun", "node": None, "level": "warning", "text": "1 cycle left out"})
    page.event({"time": 2.0, "kind": "state", "node": None, "level": "info", "text": "one"})
    page.event({"time": 2.0, "kind": "state", "node": None, "level": "info", "text": "two"})
    page.state(state, seen=True)
    html = page._log._handle.content
    assert html.count("1 cycle left out") == 1
    assert "(3 times)" in html
    assert "one" in html


def test_a_lost_connection_is_said(make):
    page = make()
    assert "enabled" in page._table._handle.content
    page.lost("it has died")
    assert "enabled" not in page._table._handle.content  # what was is not what is
    assert "No connection" in page._alarm._handle.content
    assert "it has died" in page._alarm._handle.content
