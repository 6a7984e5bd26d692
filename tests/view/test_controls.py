import pytest

from canopen_control.errors import RemoteError
from canopen_control.view.controls import DriveControls, StopControls, tell


class Robot:
    def __init__(self):
        self.asked, self.stops, self.answer, self.gone = [], 0, None, False

    def stop(self):
        if self.gone:
            raise RemoteError("BusClosed", "it has died")
        self.stops += 1

    def ask(self, method, params):
        self.asked.append((method, params))
        return self.answer


@pytest.fixture
def robot():
    return Robot()


@pytest.fixture
def stop(server, robot):
    return StopControls(server.gui, robot)


def test_stop_stops_by_click_and_by_the_space_bar(server, robot, stop, parts, hand):
    hand.click(parts()["STOP"])
    assert robot.stops == 1
    (command,) = server.gui._command_handle_from_uuid.values()
    assert (command.label, command.hotkey, command.disabled) == ("STOP", "space", False)
    hand.hotkey(command)
    assert robot.stops == 2


def test_stop_is_a_coroutine_so_that_it_waits_for_no_thread(stop, parts):
    import inspect

    assert all(inspect.iscoroutinefunction(callback) for callback in parts()["STOP"]._impl.update_cb)


def test_stop_is_live_whatever_is_shown(robot, stop, parts, hand):
    for latched in (True, False, True):
        stop.show(latched=latched)
        assert parts()["STOP"].visible
        assert not parts()["STOP"].disabled
        hand.click(parts()["STOP"])
    assert robot.stops == 3


def test_a_stop_that_does_not_reach_the_robot_is_told(robot, stop, parts, hand):
    robot.gone = True
    hand.click(parts()["STOP"])
    assert hand.client.told == [("STOP has not reached the robot", "it has died")]


def test_the_release_is_there_while_it_is_latched(robot, stop, parts, hand):
    assert not parts()["Release STOP"].visible
    stop.show(latched=True)
    assert parts()["Release STOP"].visible
    hand.click(parts()["Release STOP"])
    assert robot.asked == [("release", {})]
    stop.show(latched=False)
    assert not parts()["Release STOP"].visible


def test_each_drive_and_all_of_them_have_their_buttons(server, robot, parts, hand):
    DriveControls(server.gui, robot, ["left", "right"])
    assert set(parts()) == {"all", "left", "right"}
    hand.choose(parts()["left"], "Enable")
    hand.choose(parts()["all"], "Reset fault")
    assert robot.asked == [
        ("axis", {"action": "enable", "node": "left"}),
        ("axis", {"action": "fault-reset", "node": "all"}),
    ]
    assert hand.client.told == []


def test_what_is_refused_is_told_to_who_asked(server, robot, parts, hand):
    robot.answer = "axis enable is refused: STOP is latched"
    DriveControls(server.gui, robot, ["left"])
    hand.choose(parts()["left"], "Enable")
    assert hand.client.told == [("left: enable", robot.answer)]


def test_a_page_that_has_gone_is_told_nothing():
    tell(None, "a", "b")
