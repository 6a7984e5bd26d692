import pytest
from support.busfile import with_node
from support.robots import copy_robby, split_robby

from canopen_control.errors import ConfigError, RobotConfigError
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot, required_objects, unit_quirks

ROBBY = find_robot("robby")


def test_without_a_choice_the_first_controller_that_is_not_a_broadcaster_runs():
    setup = read_robot(ROBBY)
    assert setup.to_activate == ("joint_state_broadcaster", "robby_forward_controller")
    assert setup.channels == {"can": "local:robby"}
    assert setup.cycle_ns == 20_000_000


def test_a_chosen_controller_runs_alongside_the_broadcasters():
    assert read_robot(ROBBY, controllers=["robby_base_controller"]).to_activate == (
        "joint_state_broadcaster",
        "robby_base_controller",
    )


def test_an_unknown_controller_is_named_with_its_file_and_the_nearest():
    with pytest.raises(RobotConfigError, match=r"ros2_controllers\.yaml.*did you mean 'robby_forward_controller'"):
        read_robot(ROBBY, controllers=["robby_forward_controler"])


def test_channels_are_given_for_the_bus_or_by_its_name():
    assert read_robot(ROBBY, can=["vcan0"]).channels == {"can": "vcan0"}
    assert read_robot(ROBBY, can=["can=can1"]).channels == {"can": "can1"}
    with pytest.raises(RobotConfigError, match="no bus 'left'"):
        read_robot(ROBBY, can=["left=can0"])


def test_the_name_is_the_folders_or_given():
    assert read_robot(ROBBY).name == "robby"
    setup = read_robot(ROBBY, name="other")
    assert (setup.name, setup.channels["can"]) == ("other", "local:other")


def test_errors_of_any_of_the_three_files_are_configuration_errors(tmp_path):
    for which, old, new in (
        ("bus", "node_id: 3", "node_id: 300"),
        ("controllers", "update_rate: 50", "update_rate: fast"),
        ("description", "</robot>", "</robo>"),
    ):
        folder = tmp_path / which
        folder.mkdir()
        with pytest.raises(ConfigError, match=r"bus\.yml|ros2_controllers\.yaml|urdf"):
            read_robot(find_robot(str(copy_robby(folder, **{which: {old: new}}))))


def test_without_sync_the_cycle_is_the_controllers_rate(tmp_path):
    config = copy_robby(
        tmp_path, bus={"sync_period: 20000": "sync_period: 0"}, controllers={"update_rate: 50": "update_rate: 100"}
    )
    assert read_robot(find_robot(str(config))).cycle_ns == 10_000_000


def test_each_bus_has_a_channel_by_option_by_its_file_or_its_own_embedded_one(tmp_path):
    config = split_robby(tmp_path)
    files = find_robot(str(config))
    setup = read_robot(files)
    assert list(setup.buses) == ["can", "right"]
    assert setup.channels == {"can": "local:robby", "right": "local:robby_right"}
    assert read_robot(files, can=["can0", "right=can1"]).channels == {"can": "can0", "right": "can1"}
    path = config / "bus_right.yml"
    path.write_text(path.read_text().replace("node_id: 1\n", "node_id: 1\n  channel: vcan3\n", 1))
    assert read_robot(files).channels["right"] == "vcan3"
    assert read_robot(files, can=["right=can1"]).channels["right"] == "can1"


def test_two_buses_on_one_channel_would_be_two_masters_on_it(tmp_path):
    with pytest.raises(RobotConfigError, match="the buses can and right are both on can0"):
        read_robot(find_robot(str(split_robby(tmp_path))), can=["can0", "right=can0"])


@pytest.mark.parametrize(
    ("written", "rate"), [("update_rate: 10", 10), ("update_rate: 50", 50), ("update_rate: 100", 50), ("", 50)]
)
def test_controllers_run_at_the_managers_update_rate_and_at_most_in_every_cycle(written, rate, tmp_path):
    config = copy_robby(tmp_path, controllers={"update_rate: 50": written})
    assert read_robot(find_robot(str(config))).update_rate == rate


def test_buses_of_different_sync_periods_and_doubled_names_are_not_robot(tmp_path):
    config = split_robby(tmp_path)
    path = config / "bus_right.yml"
    text = path.read_text()
    path.write_text(text.replace("sync_period: 20000", "sync_period: 10000"))
    with pytest.raises(RobotConfigError, match="all buses of a robot must have the same SYNC period"):
        read_robot(find_robot(str(config)))
    path.write_text(text.replace("right_drive:", "left_drive:"))
    with pytest.raises(RobotConfigError, match=r"bus_right\.yml:\d+: a node named left_drive is also in .*bus\.yml"):
        read_robot(find_robot(str(config)))


def test_the_kernel_sends_sync_only_where_there_is_one(tmp_path):
    files = find_robot(str(copy_robby(tmp_path, bus={"sync_period: 20000": "sync_period: 0"})))
    assert read_robot(files, can=["vcan0"]).kernel_sync is False
    with pytest.raises(RobotConfigError, match=r"bus\.yml has no sync_period, so no SYNC can be sent"):
        read_robot(files, can=["vcan0"], kernel_sync=True)
    setup = read_robot(find_robot("robby"), can=["vcan0"], kernel_sync=True)
    reported = "SYNC is sent by the kernel, and the cycle follows it: --kernel-sync"
    assert (setup.kernel_sync, list(setup.sync_notes)) == (True, [reported])


def test_peer_merge_reaches_the_plan(tmp_path):
    changed = {"  left_drive:\n    node_id: 3\n": "  left_drive:\n    node_id: 3\n    heartbeat_producer: 50\n"}
    files = find_robot(str(copy_robby(tmp_path, bus=changed)))
    assert read_robot(files).bus.nodes["left_drive"].supervision.heartbeat_producer == 50
    assert read_robot(files, peer_merge=True).bus.nodes["left_drive"].supervision.heartbeat_producer == 100


def test_one_option_accepts_drives_that_nothing_would_stop(tmp_path):
    files = find_robot(str(copy_robby(tmp_path, bus={"heartbeat_consumer: true": "heartbeat_consumer: false"})))
    with pytest.raises(ConfigError, match="or --allow-unsupervised"):
        read_robot(files)
    setup = read_robot(files, allow_unsupervised=True)
    assert all(node.supervision.allow_unsupervised for node in setup.bus.nodes.values())
    assert any("nothing stops this drive when the master is lost" in note for note in setup.notes)


@pytest.mark.parametrize("where", ["controller_manager", "robby_base_controller"])
def test_use_sim_time_without_a_simulation_is_reported_to_do_nothing(tmp_path, where):
    head = f"{where}:\n  ros__parameters:\n"
    folder = copy_robby(tmp_path, controllers={head: f"{head}    use_sim_time: true\n"})
    (note,) = [item for item in read_robot(find_robot(str(folder))).notes if "use_sim_time has" in item]
    assert "if a program publishes /clock, the bridge with" in note
    assert not [item for item in read_robot(ROBBY).notes if "use_sim_time" in item]


def test_use_sim_time_of_a_simulated_robot_is_as_it_should_be():
    setup = read_robot(find_robot("diffbot_sim"))
    assert setup.controllers.manager.use_sim_time
    assert not [note for note in setup.notes if "use_sim_time" in note]


def test_a_robot_is_on_its_buses_where_drives_move_it():
    assert list(read_robot(find_robot("robby")).joined) == ["can"]
    assert not read_robot(find_robot("robby"), mock=True).joined
    assert not read_robot(find_robot("diffbot_sim")).joined
    assert list(read_robot(find_robot("diffbot_sim"), real=True).joined) == ["can"]


UNITS = "scale_pos_to_dev: {0}, scale_pos_from_dev: {1}, scale_vel_to_dev: {2}, scale_vel_from_dev: {3}"


@pytest.mark.parametrize(
    ("position", "velocity", "quirks"),
    [
        (210, 32.5, ["own_velocity_unit=6.46153846@0"]),
        (-210, -105, ["own_velocity_unit=2@0"]),
        (210, 210, []),
    ],
)
def test_a_virtual_drive_has_the_velocity_unit_of_bus_yml(tmp_path, position, velocity, quirks):
    scales = UNITS.format(position, 1 / position, velocity, 1 / velocity)
    assert unit_quirks(with_node(tmp_path, scales), "right_drive") == quirks


@pytest.mark.parametrize(
    ("keys", "objects"),
    [
        ("", {}),
        ("vendor_id: 0x286, product_code: 0x4F6", {}),
        ("vendor_id: 0, product_code: 0, revision_number: 0, serial_number: 0", {}),
        ("vendor_id: 0x287, product_code: 1", {(0x1018, 1): 0x287, (0x1018, 2): 1}),
        ("revision_number: 5, serial_number: 77", {(0x1018, 3): 5, (0x1018, 4): 77}),
        ("software_version: 0x10002", {(0x1F56, 1): 0x10002}),
    ],
)
def test_a_virtual_drive_has_the_identity_that_bus_yml_requires(tmp_path, keys, objects):
    assert required_objects(with_node(tmp_path, keys), "right_drive") == objects
