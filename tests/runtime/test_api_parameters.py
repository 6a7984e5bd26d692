"""Parameters over the wire: those of controllers, and those of the manager with what a spawner sets."""

from __future__ import annotations

import pytest
from support.robots import FORWARD

BASE = "robby_base_controller"
KIND = "velocity_controllers/JointGroupVelocityController"


@pytest.fixture
def base(client):
    client.ask("load", controller=BASE)
    return BASE


def read(client, name):
    return {each["name"]: each for each in client.ask("parameters", controller=name)["result"]}


def put(client, controller, **values):
    wanted = [{"name": name.replace("__", "."), "kind": kind, "value": value} for name, (kind, value) in values.items()]
    return client.ask("set_parameters", controller=controller, values=wanted)


def test_a_controllers_parameters_have_types_and_say_what_may_be_set(client, base):
    found = read(client, base)
    assert (found["wheel_radius"]["kind"], found["wheel_radius"]["read_only"]) == ("double", True)
    assert "read_only" not in found["cmd_vel_timeout"]
    assert (found["cmd_vel_timeout"]["low"], found["cmd_vel_timeout"]["high"]) == (0.0, 1e9)
    assert read(client, FORWARD)["interface_name"]["value"] == "velocity"
    assert read(client, FORWARD)["update_rate"]["value"] == 50, "the manager's"


def test_what_is_set_is_read_back_and_reaches_the_controller(robby, client, base):
    assert put(client, base, cmd_vel_timeout=("double", 1.5), linear__x__max_velocity=("double", 0.3))["result"] == {}
    assert read(client, base)["cmd_vel_timeout"]["value"] == 1.5
    assert robby.robot.manager.get(base).life.limit_ns == 1_500_000_000
    client.ask("configure", controller=base)
    assert read(client, base)["cmd_vel_timeout"]["value"] == 1.5, "it is kept when it is configured again"
    client.ask("unload", controller=base)
    client.ask("load", controller=base)
    assert read(client, base)["cmd_vel_timeout"]["value"] != 1.5, "loaded again it is that of the file"


def test_one_that_is_wrong_keeps_all_as_they_were(robby, client, base):
    before = read(client, base)
    answer = put(client, base, cmd_vel_timeout=("double", 1.5), linear__x__max_velocity=("double", -1.0))
    assert "linear.x.max_velocity: -1.0 is out of range" in answer["error"]["message"]
    answer = put(client, base, cmd_vel_timeout=("double", 1.5), wheel_radius=("double", 1.0))
    assert "'wheel_radius' cannot be set because it is read-only" in answer["error"]["message"]
    assert read(client, base) == before
    assert robby.robot.manager.get(base).params.cmd_vel_timeout == before["cmd_vel_timeout"]["value"]


def test_a_limit_is_taken_away_by_a_nan_and_a_text_is_no_number(client, base):
    assert put(client, base, linear__x__min_velocity=("double", ".nan"))["result"] == {}
    assert read(client, base)["linear.x.min_velocity"]["value"] == ".nan"
    assert "'linear.x.max_jerk'" in put(client, base, linear__x__max_jerk=("double", "fast"))["error"]["message"]


def test_a_controller_that_is_not_loaded_has_none(client):
    assert client.ask("parameters", controller="nobody")["error"]["kind"] == "UnknownName"
    assert put(client, "nobody", x=("double", 1.0))["error"]["kind"] == "UnknownName"


def test_the_managers_parameters_are_those_of_its_block_and_the_types(robby, client):
    found = read(client, "controller_manager")
    assert found["update_rate"]["value"] == robby.robot.setup.controllers.update_rate
    assert found[f"{BASE}.type"]["value"] == "diff_drive_controller/DiffDriveController"
    answer = put(client, "controller_manager", update_rate=("integer", 10))
    assert "'update_rate' cannot be set because it is read-only" in answer["error"]["message"]
    answer = put(client, "controller_manager", nonsense=("integer", 10))
    assert "'nonsense' cannot be set because it was not declared" in answer["error"]["message"]


def test_a_spawners_file_makes_a_controller_that_moves(robby, client, tmp_path):
    path = tmp_path / "wheels.yaml"
    path.write_text(
        "wheels:\n  ros__parameters:\n    joints: [left_wheel_joint, right_wheel_joint]\n    command_timeout: 0.5\n"
    )
    assert put(client, "controller_manager", wheels__params_file=("string_array", [str(path)]))["result"] == {}
    assert put(client, "controller_manager", wheels__type=("string", KIND))["result"] == {}
    assert read(client, "controller_manager")["wheels.params_file"]["value"] == [str(path)]
    options = ["-r", "~/commands:=/speeds"]
    put(client, "controller_manager", wheels__node_options_args=("string_array", options))
    assert read(client, "controller_manager")["wheels.node_options_args"]["value"] == options
    assert client.ask("load", controller="wheels")["result"] == {}
    listed = {each["name"]: each for each in client.ask("controllers")["result"]}
    assert (listed["wheels"]["node_options"], listed[FORWARD]["node_options"]) == (options, [])
    assert read(client, "wheels")["command_timeout"]["value"] == 0.5
    client.ask("switch", activate=["wheels"], deactivate=[FORWARD])
    assert "wheels" in robby.robot.manager.active
