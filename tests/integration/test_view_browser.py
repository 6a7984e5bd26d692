"""The page in a real browser: robby on virtual drives, with the view as a separate process.

What is said of the robot is confirmed past the page and past the runtime: by a bare listener on the bus (the `canopen`
package) and by what three.js draws. Pictures of every test are kept in CANOPEN_CONTROL_ARTEFACTS (build/pictures).
"""

import functools
import http.server
import json
import math
import os
import signal
import threading
import time
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from support.arm6 import ENDS, JOINTS, copy_arm, planned
from support.browser import LEFT_WHEEL, RIGHT_WHEEL, RobotPage, without_webgl
from support.floor import plant_text
from support.host import eventually
from support.pages import AXIS, NODE, state
from support.robotview import DIFF_DRIVE

import canopen_control
from canopen_control.client import RobotClient, find_robots
from canopen_control.rpc.messages.robot import GetStatus
from canopen_control.view.words import axis_rows, drive_table, joint_table

pytestmark = pytest.mark.browser

PAGE_STYLE = Path(canopen_control.__file__).parent / "view" / "elements" / "page.css"
SOCKET = "_nicegui_ws/socket.io/?EIO=4&transport=websocket"


def turned(before, after):
    """Return by how many radians a world matrix has turned against another."""
    trace = sum(before[4 * row + column] * after[4 * row + column] for row in range(3) for column in range(3))
    return math.acos(max(-1.0, min(1.0, (trace - 1) / 2)))


def test_the_wheels_turn_in_the_scene_without_another_request(show, keep):
    show = show("vturn")
    page = show.page()
    show.ready(page)
    still = [page.transform(wheel) for wheel in (LEFT_WHEEL, RIGHT_WHEEL)]
    page.pictures(30)
    assert [page.transform(wheel) for wheel in (LEFT_WHEEL, RIGHT_WHEEL)] == still  # upright objects are drawn upright
    show.drive(1.0, 1.0)
    before = [page.transform(wheel) for wheel in (LEFT_WHEEL, RIGHT_WHEEL)]
    assert eventually(
        lambda: all(
            turned(was, page.transform(wheel)) > 0.3
            for was, wheel in zip(before, (LEFT_WHEEL, RIGHT_WHEEL), strict=True)
        ),
        10,
    )
    assert [row[12:15] for row in before] == [row[12:15] for row in still]  # about their axles, in their places
    keep(page, "wheels_turn")
    assert "enabled, follows commands" in page.text()
    # No other origin was requested; the check would detect such a request.
    assert page.foreign() == []
    assert any(url.startswith("ws://127.0.0.1") for url in page.requests)
    plain = RobotPage(show.chromium, "http://127.0.0.1/")
    plain.page.set_content("<img src='http://192.0.2.1/pixel.png'>", wait_until="commit")
    assert eventually(lambda: plain.page.wait_for_timeout(20) or plain.foreign() == ["http://192.0.2.1/pixel.png"])
    plain.page.close()
    # Our page could not even if it wanted to: what it may ask is written on it.
    assert eventually(lambda: "Failed to fetch" in page.fetched("http://192.0.2.1/"))
    assert page.foreign() == []


@pytest.mark.rest
def test_one_button_after_another_drives(show):
    show = show("vnext", "--controller", DIFF_DRIVE, teleop=True)
    page = show.page()
    show.ready(page)
    for button in ("Forward", "Left", "Forward"):
        page.press(button)
        show.turning(0.5)
        page.page.wait_for_timeout(600)
        show.turning(0.5)  # while it is held, and again after a renewal that came late on a busy machine
        page.page.mouse.up()
        show.stood_after(time.time())


@pytest.mark.rest
def test_a_foreign_page_may_not_come_in(show, tmp_path):
    show = show("vdoor")
    page = show.page()
    (tmp_path / "evil.html").write_text(
        f"<script>const socket = new WebSocket('{show.url.replace('http', 'ws')}{SOCKET}');"
        "socket.onopen = () => { document.title = 'open'; }; socket.onclose = () => { document.title = 'refused'; };"
        "</script>"
    )
    handler = functools.partial(QuietHandler, directory=str(tmp_path))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            evil = show.chromium.new_page()
            answers = []
            evil.on("response", lambda response: answers.append((response.url, response.status)))
            evil.goto(f"http://127.0.0.1:{server.server_port}/evil.html")
            evil.wait_for_function("document.title !== ''")
            assert evil.title() == "refused"
            status = evil.evaluate(
                "url => fetch(url, {mode: 'no-cors'}).then(answer => answer.type, error => 'failed')", show.url
            )
            assert status in ("opaque", "failed")  # nothing of it can be read
        finally:
            server.shutdown()
            thread.join()
    import urllib.error
    import urllib.request

    for headers in ({"Origin": "http://evil.example"}, {"Host": "evil.example"}):
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(urllib.request.Request(show.url, headers=headers), timeout=5)
    assert "node 3 · left_wheel_joint" in page.text()  # our own page is in


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@pytest.mark.rest
def test_a_robot_that_is_started_again_is_on_the_same_page(show):
    show = show("vagain")
    page = show.page()
    show.run.send(signal.SIGINT)
    assert show.run.wait() == 0
    page.page.get_by_text("not connected", exact=True).wait_for()
    assert "enabled, follows commands" not in page.text()
    show.stage.robby("vagain")
    page.page.get_by_text("not connected", exact=True).wait_for(state="hidden")
    page.page.get_by_text("enabled, follows commands").first.wait_for()
    assert not page.page.evaluate("document.documentElement.classList.contains('cc-no-robot')")


@pytest.mark.rest
def test_a_robot_that_hangs_is_shown_as_dead_until_it_sends_again(show, keep):
    show = show("vhang")
    page = show.page()
    os.kill(show.run.pid, signal.SIGSTOP)
    try:
        page.page.get_by_text("has sent nothing for").wait_for()
        assert "enabled, follows commands" not in page.text()
        page.press("STOP")
        page.page.get_by_text("STOP has not reached the robot").wait_for()
        keep(page, "robot_hangs")
    finally:
        os.kill(show.run.pid, signal.SIGCONT)
    page.page.get_by_text("not connected", exact=True).wait_for(state="hidden")
    page.page.get_by_text("STOP is latched").wait_for()  # it was sent, and heard when it could be


@pytest.mark.rest
def test_a_page_whose_server_has_died_reports_this_and_continues_when_it_is_back(show, keep):
    show = show("vserver")
    page = show.page()
    port = urlsplit(show.url).port
    show.view.send(signal.SIGKILL)
    page.page.get_by_text("The page has lost its server.").wait_for()
    page.press("STOP")
    page.page.get_by_text("STOP has not reached the robot").wait_for()
    keep(page, "server_is_dead")
    show.stage.start("view", "--name", "vserver", "--port", port).until("view: http")
    page.page.get_by_text("The page has lost its server.").wait_for(state="hidden")
    page.page.get_by_text("node 3 · left_wheel_joint").wait_for()
    page.press("STOP")
    page.page.get_by_text("Latched (by view)").wait_for()
    assert "STOP has not reached the robot" not in page.text()


@pytest.mark.rest
def test_without_webgl_everything_but_the_picture_is_there(show, keep):
    show = show("vflat", "--controller", DIFF_DRIVE, teleop=True)
    with without_webgl(show.chromium) as flat:
        page = RobotPage(flat, show.url).open(scene=False)
        page.page.get_by_text("This browser cannot draw 3D").wait_for()
        show.ready(page)
        page.press("Forward")
        show.turning(3.0)
        keep(page, "without_webgl")
        page.page.mouse.up()
        page.page.keyboard.press("Space")
        page.page.get_by_text("Latched (by view)").wait_for()
        assert "This browser cannot draw 3D" in page.text()


@pytest.mark.rest
def test_on_a_phone_stop_state_and_pad_are_in_sight_and_stop_under_the_thumb(show, keep):
    show = show("vphone", "--controller", DIFF_DRIVE, teleop=True, size=(390, 844))
    page = show.page()
    for name in ("STOP", "Forward", "Left", "Back", "Right"):
        box = page.page.get_by_role("button", name=name, exact=True).bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 390
        assert box["y"] + box["height"] <= 844
        assert box["y"] > 844 / 2 - 60, name  # where a thumb gets to
        assert min(box["width"], box["height"]) >= 44  # and hits
    show.ready(page)
    assert page.page.get_by_text("running", exact=True).bounding_box()["y"] < 80
    assert page.page.evaluate("document.documentElement.scrollWidth") == 390
    page.page.evaluate("scrollTo(0, 99999)")
    keep(page, "phone")
    page.press("STOP")
    page.page.get_by_text("Latched (by view)").wait_for()
    assert "STOP has not reached the robot" not in page.text()


@pytest.mark.rest
def test_run_shows_the_page_and_a_dead_page_does_not_affect_the_robot(stage, chromium):
    run = stage.robby("vrun", "--view", "--controller", DIFF_DRIVE)
    url = run.until("view: http").split()[-1]
    page = RobotPage(chromium, url).open()
    os.kill(stage.pid_of("canopen_control view"), signal.SIGKILL)
    run.until("process view")
    assert "was ended by signal 9" in run.out
    status = stage.call("status", "--name", "vrun")
    assert "running" in status.out
    page.page.close()
    assert run.end(signal.SIGINT) == 0


@pytest.mark.rest
def test_a_trajectory_is_previewed_standing_then_played_until_the_page_is_closed(stage, chromium, keep, tmp_path):
    points = [
        {"positions": point.positions, "velocities": point.velocities, "time_from_start": point.time / 1e9}
        for point in planned([0.0] * 6, ENDS, 20.0).points
    ]
    wave = tmp_path / "wave.json"
    wave.write_text(json.dumps({"joint_names": JOINTS, "points": points}))
    stage.start("run", str(copy_arm(tmp_path)), "--as", "varm", "--mock")
    assert eventually(lambda: "varm" in find_robots())
    view = stage.start("view", "--name", "varm", "--port", "0", "--teleop")
    page = RobotPage(chromium, view.until("view: http").split()[-1]).open()
    page.page.set_input_files("input[type=file]", wave)
    page.page.get_by_text("point 1 of 50").wait_for()
    page.page.locator(".cc-scrub .q-slider__track-container").focus()
    page.page.keyboard.press("ArrowRight")
    page.page.get_by_text("Preview, the robot does not move: point 2 of 50").wait_for(timeout=15_000)
    with RobotClient.connect("varm") as robot:

        def joints():
            return robot.ask(GetStatus()).joints.values()

        assert {joint.position for joint in joints()} == {0.0}
        still = page.transform("link_3")
        assert eventually(lambda: page.page.evaluate("window.ccScene.place('link_3', true)") not in (None, still))
        keep(page, "trajectory_preview")
        page.click("Play")
        assert eventually(lambda: any(abs(joint.position) > 0.01 for joint in joints()))
        page.page.close()
        assert eventually(lambda: all(abs(joint.velocity) < 1e-6 for joint in joints()))
        assert max(abs(joint.position) for joint in joints()) < 1.0


def _what_nobody_sees_is_not_drawn(page):
    """Take the picture out of sight, move the robot in it, and bring it back."""
    place = "document.querySelector('.cc-middle canvas').parentElement.style"
    move = "x => window.dispatchEvent(new CustomEvent('cc-scene', { detail: { pose: [x, 0, 0] } }))"
    two_frames = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    page.page.evaluate(f"{place}.display = 'none'")
    page.page.wait_for_function("() => !window.ccScene.visible()")
    page.page.evaluate(two_frames)  # what was asked for while it was in sight is drawn in the next one
    drawn = page.page.evaluate("window.ccScene.drawn()")
    for step in range(10):
        page.page.evaluate(move, step / 10)
    page.page.evaluate(two_frames)
    assert page.page.evaluate("window.ccScene.drawn()") == drawn
    page.page.evaluate(f"{place}.display = ''")
    assert eventually(lambda: page.page.evaluate("window.ccScene.drawn()") > drawn)


@pytest.mark.rest
def test_a_simulated_base_has_its_own_way_alongside_that_of_odometry(show, stage, keep):
    (stage.place / "floor.yml").write_text(plant_text(track=1.3))
    show = show("vtruth", "--controller", DIFF_DRIVE, "--plant", stage.place / "floor.yml")
    page = show.page()
    show.ready(page)
    stage.start("twist", DIFF_DRIVE, 0.25, 0.6, "--for", 4, "--name", "vtruth").wait()

    def way(name):
        return page.page.evaluate("name => window.ccScene.trail(name)", name)

    assert eventually(lambda: len(way("truth")) > 50)
    believed, true = way("trail"), way("truth")
    assert math.dist(believed[0], true[0]) < 0.03
    assert math.dist(believed[-1], true[-1]) > 0.1
    assert "odometry is off by" in page.text()
    turned = [math.cos(math.pi / 8), 0, 0, math.sin(math.pi / 8)]
    box = {"shape": "box", "size": [0.3, 0.2, 0.4], "position": [1.0, 0.0, 0.2], "wxyz": turned, "moves": True}
    world = {"place": [0.5, 1.0, math.pi / 2], "shapes": [box]}
    page.page.evaluate("world => window.dispatchEvent(new CustomEvent('cc-world', { detail: world }))", world)
    assert page.page.evaluate("window.ccScene.world()[0]") == pytest.approx([0.5, 2.0, 0.2])
    keep(page, "true_pose")
    _what_nobody_sees_is_not_drawn(page)
    page.page.reload()
    assert eventually(lambda: len(page.page.evaluate("window.ccScene?.trail('truth') || []")) > 50)


@pytest.mark.parametrize("width", [390, 1100, 1440])
def test_the_tables_stay_within_their_cards(chromium, width):
    states = ("OPERATION_ENABLED", "READY_TO_SWITCH_ON", "FAULT_REACTION_ACTIVE", "QUICK_STOP_ACTIVE")
    names = [f"front_left_steering_{number}" for number in range(len(states))]
    nodes = {
        name: NODE | {"node_id": 100, "axes": [AXIS | {"joint": name, "cia402_state": each}]}
        for name, each in zip(names, states, strict=True)
    }
    tracking = {"interface": "position", "error_max": 0.0123, "error_rms": 0.00345, "skipped": 123, "repeated": 1234}
    joint = {"position": -12345.6, "velocity": -1234.5, "effort": -123.4, "command": -1234.5, "tracking": tracking}
    shown = state(nodes=nodes, joints=dict.fromkeys(names, joint))
    tables = {
        "drives": drive_table(axis_rows(shown)),
        "joints": joint_table(shown.joints, frozenset(), dict.fromkeys(names, "velocity")),
    }
    panels = "".join(f"<section class='cc-panel cc-p-{key}'>{table}</section>" for key, table in tables.items())
    page = chromium.new_page(viewport={"width": width, "height": 900})
    page.set_content(f"<style>{PAGE_STYLE.read_text()}</style><main class='cc-page'><p></p><p></p>"
                     f"<div class='cc-right'>{panels}</div></main>")  # fmt: skip
    wider = "[...document.querySelectorAll('.cc-panel')].map(each => each.scrollWidth - each.clientWidth)"
    assert page.evaluate(wider) == [0, 0]
    assert page.evaluate("document.documentElement.scrollWidth") == width
    page.close()
