"""The methods behind ros2_control's services, over the wire."""

import pytest
from support.robots import FORWARD, LEFT

BASE = "robby_base_controller"


def states(client):
    return {each["name"]: each["state"] for each in client.ask("controllers")["result"]}


def test_a_controller_is_loaded_switched_and_unloaded(robby, client):
    assert "forward_command_controller/ForwardCommandController" in client.ask("controller_types")["result"]
    assert client.ask("load", controller=BASE)["result"] == {}
    assert states(client)[BASE] == "inactive"
    assert client.ask("switch", activate=[BASE], deactivate=[FORWARD])["result"] == {}
    assert (states(client)[BASE], states(client)[FORWARD]) == ("active", "inactive")
    assert "active" in client.ask("unload", controller=BASE)["error"]["message"]
    client.ask("switch", activate=[FORWARD], deactivate=[BASE])
    assert client.ask("configure", controller=BASE)["result"] == {}
    assert client.ask("unload", controller=BASE)["result"] == {}
    assert BASE not in states(client)


def test_ros_loads_a_controller_before_it_is_configured(client):
    assert client.ask("load", controller=BASE, configure=False)["result"] == {}
    assert states(client)[BASE] == "unconfigured"
    found = {each["name"]: each for each in client.ask("parameters", controller=BASE)["result"]}
    assert (found["wheel_radius"]["value"], found["wheel_radius"]["read_only"]) == (0.035, True)
    assert "it is unconfigured" in client.ask("switch", activate=[BASE], deactivate=[FORWARD])["error"]["message"]
    assert client.ask("configure", controller=BASE)["result"] == {}
    assert states(client)[BASE] == "inactive"


def test_the_hardware_is_listed_with_what_is_claimed(client):
    (component,) = client.ask("hardware")["result"]
    assert component["state"] == "active"
    assert component["plugin"].endswith("RobotSystem")
    claimed = {each["name"]: each["claimed"] for each in component["command_interfaces"]}
    assert claimed == {"left_wheel_joint/velocity": True, "right_wheel_joint/velocity": True}
    assert all(each["available"] for each in component["state_interfaces"])


def test_inactive_hardware_commands_nothing_and_its_controllers_stop(robby, client):
    robby.hold(10.0, 10.0, ms=300)
    name = client.ask("hardware")["result"][0]["name"]
    assert client.ask("set_hardware_state", component=name, state="inactive")["result"] == {"state": "inactive"}
    assert states(client)[FORWARD] == "inactive"
    robby.run(1500)
    assert robby.speed(LEFT) == 0
    assert client.ask("set_hardware_state", component=name, state="active")["result"] == {"state": "active"}
    robby.run(500)
    assert not robby.joint(LEFT).machine.enabled


@pytest.mark.parametrize(
    ("method", "params", "words"),
    [
        ("load", {"controller": "nobody"}, "nobody"),
        ("configure", {"controller": "nobody"}, "nobody"),
        ("set_hardware_state", {"component": "nobody", "state": "active"}, "nobody"),
        ("set_hardware_state", {"component": "robby", "state": "finalized"}, "inactive"),
    ],
)
def test_what_cannot_be_done_is_refused_in_a_sentence(client, method, params, words):
    assert words in client.ask(method, **params)["error"]["message"]


def test_best_effort_leaves_out_names_that_nobody_knows_and_tells_them(robby, client):
    answer = client.ask("switch", activate=["nobody", BASE], deactivate=["nothing", FORWARD], strict=False)
    assert answer["result"] == {}
    assert (states(client)[BASE], states(client)[FORWARD]) == ("active", "inactive")
    robby.run(50)
    assert robby.texts("left_out") == ["a switch leaves out what nobody knows: nobody, nothing; see: controller list"]
    answer = client.ask("switch", activate=["nobody", FORWARD], deactivate=[BASE], strict=True)
    assert "no controller 'nobody'" in answer["error"]["message"]
    assert (states(client)[BASE], states(client)[FORWARD]) == ("active", "inactive"), "a strict one changes nothing"


def test_hardware_is_unconfigured_and_configured_again(robby, client):
    robby.hold(10.0, 10.0, ms=300)
    name = client.ask("hardware")["result"][0]["name"]
    assert client.ask("set_hardware_state", component=name, state="unconfigured")["result"] == {"state": "unconfigured"}
    robby.run(1500)
    assert robby.speed(LEFT) == 0
    assert states(client)[FORWARD] == "inactive"
    (component,) = client.ask("hardware")["result"]
    assert not any(each["available"] for each in component["state_interfaces"])
    assert "must be active" in client.ask("switch", activate=[FORWARD])["error"]["message"]
    assert client.ask("set_hardware_state", component=name, state="inactive")["result"] == {"state": "inactive"}
    assert client.ask("set_hardware_state", component=name, state="active")["result"] == {"state": "active"}
    assert client.ask("switch", activate=[FORWARD])["result"] == {}
