import pytest

from canopen_control.view.model import Joint, Model
from canopen_control.view.teleop_panel import TeleopPanel

BASE = {"name": "base", "state": "active", "topic": "cmd_vel", "joints": ["l", "r"], "interface": "velocity"}
ARM = {"name": "arm", "state": "inactive", "topic": "commands", "joints": ["l", "r"], "interface": "position"}
STATES = {"name": "jsb", "state": "active", "topic": None, "joints": [], "interface": None}


class Driver:
    def __init__(self):
        self.held, self.asked, self.answer = [], [], None

    def hold(self, page, motion, told):
        self.held.append((page, motion))

    def ask(self, method, params):
        self.asked.append((method, params))
        return self.answer


@pytest.fixture
def driver():
    return Driver()


@pytest.fixture
def panel(server, driver):
    joints = (Joint("l", "revolute", "a", "b", lower=-1.0, upper=2.0, velocity=5.0), Joint("r", "continuous", "a", "c"))
    return TeleopPanel(server.gui, driver, Model("m", "a", joints))


def test_a_base_has_a_pad_whose_buttons_drive_while_they_are_held(panel, driver, parts, hand):
    panel.show([BASE, STATES])
    assert {"Forward", "Left", "Right", "Back", "speed m/s", "turn rad/s"} <= set(parts())
    hand.choose(parts()["speed m/s"], 0.5)
    for button in ("Forward", "Back", "Left", "Right"):
        hand.hold(parts()[button])
    moving = [(motion.moving["linear"], motion.moving["angular"]) for _, motion in driver.held]
    assert moving == [(0.5, 0.0), (-0.5, 0.0), (0.0, 0.8), (0.0, -0.8)]
    assert all(motion.resting == {"controller": "base", "linear": 0.0, "angular": 0.0} for _, motion in driver.held)
    assert {page for page, _ in driver.held} == {hand.client.client_id}


def test_nothing_moves_by_a_click_or_a_slider_alone(panel, driver, parts, hand):
    panel.show([BASE | {"topic": "commands"}])
    hand.choose(parts()["l"], 3.0)
    hand.click(parts()["Hold to drive"])
    assert driver.held == []
    hand.hold(parts()["Hold to drive"])
    assert driver.held[0][1].moving == {"controller": "base", "values": [3.0, 0.0]}
    assert driver.held[0][1].resting == {"controller": "base", "values": [0.0, 0.0]}


def test_sliders_end_where_the_description_says(panel, parts):
    panel.show([BASE | {"topic": "commands"}])
    assert (parts()["l"].min, parts()["l"].max) == (-5.0, 5.0)
    assert (parts()["r"].min, parts()["r"].max) == (-10.0, 10.0)
    panel.show([ARM | {"state": "active"}])
    assert (parts()["l"].min, parts()["l"].max) == (-1.0, 2.0)


def test_position_joints_start_and_rest_where_they_are(panel, driver, parts, hand):
    panel.follow({"l": 1.5, "r": 0.25})
    panel.show([ARM | {"state": "active"}])
    assert parts()["l"].value == 1.5
    panel.follow({"l": 1.6, "r": 0.3})
    hand.hold(parts()["Hold to drive"])
    assert driver.held[0][1].moving["values"] == [1.6, 0.3]
    assert driver.held[0][1].resting["values"] == [1.6, 0.3]


def test_a_slider_that_is_set_moves_its_own_joint_alone(panel, driver, parts, hand):
    """The others are where somebody else has put them since the page was opened: they must not go back."""
    panel.show([ARM | {"state": "active"}])
    hand.choose(parts()["l"], 0.5)
    panel.follow({"l": 1.6, "r": 0.3})
    hand.hold(parts()["Hold to drive"])
    assert driver.held[0][1].moving["values"] == [0.5, 0.3]
    assert driver.held[0][1].resting["values"] == [1.6, 0.3]


def test_another_controller_can_be_chosen(panel, driver, parts, hand):
    panel.show([BASE, ARM])
    assert parts()["controller"].value == "base"
    driver.answer = "it is refused"
    hand.choose(parts()["controller"], "arm")
    assert driver.asked == [("switch", {"activate": ["arm"], "deactivate": ["base"]})]
    assert hand.client.told == [("arm is not active", "it is refused")]


def test_it_follows_the_controllers_and_keeps_what_has_not_changed(panel, parts):
    panel.show([BASE])
    before = parts()["Forward"]
    panel.show([BASE])
    assert parts()["Forward"] is before
    panel.show([BASE | {"state": "inactive"}, ARM])
    assert "Forward" not in parts()
    assert parts()["controller"].value == "none"
