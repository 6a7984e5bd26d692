import pytest

from canopen_control.errors import ConfigError
from canopen_control.host.sockets import close_listener, find_robots, listen, select_robot, socket_path


def test_several_robots_are_named_and_one_must_be_chosen():
    listeners = [listen(socket_path("robot", name)) for name in ("b", "a")]
    assert find_robots() == ["a", "b"]
    with pytest.raises(ConfigError, match="several robots are running: a, b; choose one with --name"):
        select_robot()
    assert select_robot("b") == "b"
    with pytest.raises(ConfigError, match="no robot 'c' is running; running: a, b"):
        select_robot("c")
    with pytest.raises(ConfigError, match=r"no robot 'aa' is running \(did you mean 'a'\?\)"):
        select_robot("aa")
    with pytest.raises(ConfigError, match="is not a valid name"):
        select_robot("../c")
    for listener in listeners:
        close_listener(listener)


def test_without_any_robot_the_advice_starts_one_of_that_name():
    with pytest.raises(ConfigError) as caught:
        select_robot("two")
    assert str(caught.value) == ("no robot 'two' is running; start one: canopen-control run robby --as two")
