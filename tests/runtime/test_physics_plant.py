import dataclasses
from pathlib import Path

import pytest
from support.robots import Bench, setup_of

from canopen_control.errors import RobotConfigError
from canopen_control.runtime.physics_plant import PLANT_FILE, check_physics, plant_text, write_buses, write_plant
from canopen_control.virtual.bus_group import read_group


@pytest.fixture
def robot():
    made = Bench("physics-plant")
    yield made
    made.close()


def test_each_axis_moves_its_joint_by_the_scale_of_bus_yml(robot):
    text = plant_text(robot.setup, robot.robot.joints.values())
    assert text.splitlines()[1:] == [
        "engine: mujoco",
        "urdf: physics.urdf",
        "axes:",
        '  "3": {joint: "left_wheel_joint", scale_pos_to_dev: -254.64790894703253}',
        '  "2": {joint: "right_wheel_joint", scale_pos_to_dev: 254.64790894703253}',
    ]


def test_mecanum_wheels_have_their_rollers():
    robot = Bench("physics-mecanum", config="mecanum", drives=())
    try:
        text = plant_text(robot.setup, robot.robot.joints.values())
    finally:
        robot.close()
    angles = {
        line.split('"')[3].removesuffix("_wheel_joint"): line.split("roller: ")[1] for line in text.splitlines()[4:]
    }
    assert angles == {"front_left": "-45}", "front_right": "45}", "rear_right": "-45}", "rear_left": "45}"}


def test_a_world_is_named_where_one_is_given(robot):
    lines = plant_text(robot.setup, robot.robot.joints.values(), Path("/worlds/my hall.yml")).splitlines()
    assert lines[3:5] == ['world: "/worlds/my hall.yml"', "axes:"]


def test_it_is_written_with_the_description_beside_the_logs(robot, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    path = write_plant(robot.setup, robot.robot.joints)
    assert path == tmp_path / "canopen_control" / "robby" / PLANT_FILE
    assert (path.parent / "physics.urdf").read_text() == robot.setup.description.urdf_xml


def test_the_axes_of_a_second_bus_are_named_with_it_and_so_is_the_bus(robot, tmp_path):
    main = robot.setup.bus
    right = dataclasses.replace(main, nodes={"right_drive": main.nodes["right_drive"]})
    left = dataclasses.replace(main, nodes={"left_drive": main.nodes["left_drive"]})
    setup = dataclasses.replace(
        robot.setup, buses={"can": left, "second": right}, channels={"can": "local:a", "second": "local:b"}
    )
    check_physics(setup)
    axes = [line.split(":  ")[0] for line in plant_text(setup, robot.robot.joints.values()).splitlines()[4:]]
    assert [axis.strip().split(": {")[0] for axis in axes] == ['"3"', '"second:2"']
    buses = read_group(write_buses(tmp_path, [(setup, tmp_path / PLANT_FILE)])).robots["robby"].buses
    assert {name: (bus.channel, list(bus.nodes)) for name, bus in buses.items()} == {
        "can": ("local:a", ["3"]),
        "second": ("local:b", ["2"]),
    }


def test_without_joints_on_drives_there_is_nothing_to_move(robot):
    with pytest.raises(RobotConfigError, match=r"--physics: no joint of .* is moved by a drive"):
        write_plant(robot.setup, {})


def test_a_simulation_plugin_gives_way_to_drives():
    setup = setup_of("diffbot_sim", "memory:gives-way", physics=True)
    assert setup.on_drives
    assert not dataclasses.replace(setup, physics=False).on_drives


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"real": True}, "leave --real away"),
        ({"mock": True}, "leave --mock away"),
        ({"channels": {"can": "memory:a"}}, "use --can local:NAME"),
        ({"channels": {"can": "can0"}}, "real drives may be on can0"),
    ],
)
def test_what_physics_cannot_do_is_told(changes, words):
    setup = dataclasses.replace(setup_of("robby", "local:physics-cannot"), **changes)
    with pytest.raises(RobotConfigError, match="--physics") as caught:
        check_physics(setup)
    assert words in str(caught.value)


def test_a_robot_on_one_local_bus_can():
    check_physics(setup_of("robby", "local:physics-can"))
