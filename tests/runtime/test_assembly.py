"""Assembly of a robot from its files."""

import dataclasses
import errno
import shutil
import sys

import pytest
from support.configs import changed
from support.robots import setup_of

from canopen_control.bus import kernel_sync
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, RobotConfigError
from canopen_control.hardware.driverless_system import PHYSICS_PLUGIN
from canopen_control.hardware.plugins import PluginKind
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.plugin_robot import DriverlessRobot
from canopen_control.runtime.assembly import Assembly, read_pids, simulation_engine
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem

KINDS = [PluginKind.SIMULATION]


def setup(simulate=True, plugin=None, **parameters):
    result = dataclasses.replace(setup_of("diffbot_sim", "memory:simulation-engine"), simulate=simulate)
    tag = dataclasses.replace(result.description.hardware[0], parameters=parameters)
    if plugin is not None:
        tag = dataclasses.replace(tag, plugin=plugin)
    return dataclasses.replace(result, description=dataclasses.replace(result.description, hardware=(tag,)))


def test_gazebos_plugin_runs_in_physics_and_reports_what_was_guessed():
    events = []
    engine = simulation_engine(setup(), KINDS, lambda *event: events.append(event))
    assert isinstance(engine, DriverlessRobot)
    assert engine.motor("left_wheel_joint") is not None
    assert {kind for kind, _ in events} == {"physics"}
    assert any("left_wheel_joint, right_wheel_joint" in text for _, text in events)


def test_without_a_request_simple_motors_stay():
    assert simulation_engine(setup(simulate=False), KINDS, pytest.fail) is None


def test_without_mujoco_gazebos_plugin_has_simple_motors_and_mujocos_is_an_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    events = []
    assert simulation_engine(setup(), KINDS, lambda *event: events.append(event)) is None
    assert events[0][1].startswith("simple motors move diffbot_sim, since there is no physics: physics needs MuJoCo")
    with pytest.raises(ConfigError, match=r"pip install 'canopen-control\[physics\]'"):
        simulation_engine(setup(plugin=PHYSICS_PLUGIN), KINDS, pytest.fail)


def test_a_scene_that_is_not_there_is_reported_by_mujocos_plugin():
    with pytest.raises(PhysicsError, match=r"scene\.xml: MuJoCo cannot read it"):
        simulation_engine(setup(plugin=PHYSICS_PLUGIN, mujoco_model="scene.xml"), KINDS, pytest.fail)


def world(tmp_path, text, name="hall.yml"):
    path = tmp_path / name
    path.write_text(text)
    return dataclasses.replace(setup(), world=path)


def test_a_robot_of_a_simulation_plugin_is_held_up_by_what_is_in_its_world(tmp_path):
    hall = (
        '<sdf version="1.9"><world name="w"><model name="wall"><static>true</static><pose>0.5 0 0.25 0 0 0</pose>'
        '<link name="l"><collision name="c"><geometry><box><size>0.1 2 0.5</size></box></geometry></collision></link>'
        "</model></world></sdf>"
    )
    free = simulation_engine(setup(), KINDS, lambda *_: None)
    held = simulation_engine(world(tmp_path, hall, "hall.sdf"), KINDS, lambda *_: None)
    for engine in (free, held):
        for _ in range(150):
            for wheel in ("left_wheel_joint", "right_wheel_joint"):
                engine.motor(wheel).follow("velocity", 5.0, 0.02)
            engine.step(0.02)
    ways = [float(engine.data.body("base_link").xpos[0]) for engine in (free, held)]
    assert ways[0] > 1.0
    assert 0.1 < ways[1] < 0.45


def test_a_world_that_cannot_be_is_an_error_whatever_the_plugin(tmp_path):
    with pytest.raises(PhysicsError, match="cannot be read"):
        simulation_engine(dataclasses.replace(setup(), world=tmp_path / "none.sdf"), KINDS, pytest.fail)
    with pytest.raises(ConfigError, match="canopen-control run --world"):
        simulation_engine(world(tmp_path, "robots: [{name: a, robot: robby}]\n"), KINDS, pytest.fail)
    with pytest.raises(ConfigError, match=r"hall\.yml:1:9: no drive moves a joint 'x'"):
        simulation_engine(world(tmp_path, "steps: [{at: 1s, block: x}]\n"), KINDS, lambda *_: None)


TAG = Ros2ControlSystem(
    "arm",
    "system",
    "mujoco_ros2_control/MujocoSystemInterface",
    joints=(
        ControlJoint("shoulder", {}, dict.fromkeys(["position", "velocity"])),
        ControlJoint("wheel", {}, dict.fromkeys(["velocity"])),
    ),
)
HEAD = "/**:\n  ros__parameters:\n    pid_gains:\n"


@pytest.fixture
def read(tmp_path):
    def read(text, head=HEAD):
        path = tmp_path / "pids.yaml"
        path.write_text(head + text)
        return read_pids(path, TAG)

    return read


def test_gains_are_those_of_each_joint_and_interface(read):
    loops = read(
        "      position:\n        shoulder: {p: 400.0, i: 20.0, d: 15.0, u_clamp_max: 80.0, u_clamp_min: -80.0}\n"
        "      velocity:\n        wheel: {p: 2, i_clamp_max: 3.0, i_clamp_min: -3.0}\n"
    )
    assert {joint: list(each) for joint, each in loops.items()} == {"shoulder": ["position"], "wheel": ["velocity"]}
    gains = loops["shoulder"]["position"].gains
    assert (gains.p, gains.i, gains.d, gains.u_max, gains.u_min) == (400.0, 20.0, 15.0, 80.0, -80.0)
    assert loops["wheel"]["velocity"].gains.i_max == 3.0
    assert loops["wheel"]["velocity"].compute(0.5, 0.001) == 1.0


def test_a_node_of_any_name_has_them(read):
    assert list(read("    pid_gains: {velocity: {wheel: {p: 1.0}}}\n", "mujoco_node:\n  ros__parameters:\n")) == [
        "wheel"
    ]


@pytest.mark.parametrize(
    ("text", "place", "message"),
    [
        ("      position: {sholder: {p: 1.0}}\n", "4:18", "no joint 'sholder' in the description's <ros2_control>"),
        ("      position: {wheel: {p: 1.0}}\n", "4:18", "joint wheel has no command interface 'position'; it has vel"),
        ("      positon: {shoulder: {p: 1.0}}\n", "4:7", "no gains of 'positon' are known (did you mean 'position'?)"),
        ("      velocity: {wheel: {P: 1.0}}\n", "4:26", "P"),
        ("      velocity: {wheel: {p: much}}\n", "4:29", "much"),
        ("      velocity: {wheel: {p: .nan}}\n", "4:", "p is nan; give a finite number"),
        ("      velocity: {wheel: {u_clamp_min: 2, u_clamp_max: 1}}\n", "4:", "give u_min < u_max"),
        ("      velocity: {wheel: 3}\n", "4:25", "expected a mapping"),
        ("      velocity: 3\n", "4:17", "write gains by joints"),
        ("      - velocity\n", "4:7", "write position: and velocity:"),
        ("      velocity: {wheel: {p: 1.0}\n", "", "expected"),
    ],
)
def test_what_is_wrong_is_reported_with_its_place(read, text, place, message):
    with pytest.raises(RobotConfigError) as reported:
        read(text)
    assert f"pids.yaml:{place}" in str(reported.value)
    assert message in str(reported.value)


def test_a_file_without_gains_or_none_at_all_is_reported(read, tmp_path):
    for text in ("", "controller: {ros__parameters: {update_rate: 50}}\n", "- 1\n", "3\n"):
        with pytest.raises(RobotConfigError, match=r"no pid_gains|mapping"):
            read(text, "")
    with pytest.raises(RobotConfigError, match=r"nothing\.yaml: cannot be read: No such file"):
        read_pids(tmp_path / "nothing.yaml", TAG)


def assemble(config, **how):
    with Reactor(ManualClock()) as reactor:
        return Assembly(read_robot(find_robot(str(config)), **how), reactor, print, print, print)


def test_drives_make_a_bus_nodes_and_joints():
    created = assemble("robby")
    assert list(created.buses) == ["can"]
    assert sorted(created.nodes) == sorted(created.bus_by_node) == ["left_drive", "right_drive"]
    assert sorted(created.joints) == ["left_wheel_joint", "right_wheel_joint"]
    assert len(created.systems) == len(created.registry.components) == 1


@pytest.mark.parametrize(("config", "how"), [("diffbot_sim", {}), ("robby", {"mock": True})])
def test_what_is_on_no_bus_makes_none(config, how):
    created = assemble(config, **how)
    assert (created.buses, created.nodes, created.joints, created.systems) == ({}, {}, {}, [])
    assert len(created.registry.components) == 1


def test_a_drive_that_no_bus_has_is_refused_with_the_line_of_its_tag(tmp_path):
    files = changed(tmp_path, "diffbot_sim", description={">left_drive<": ">lft_drive<"})
    lines = files.description.read_text().splitlines()
    tag = next(number for number, line in enumerate(lines, 1) if "<ros2_control" in line)
    with pytest.raises(RobotConfigError, match=rf"diffbot\.urdf:{tag}: joint .*'lft_drive'.*did you mean 'left_drive'"):
        assemble(files.description.parent, real=True)


def test_a_description_without_hardware_is_refused(tmp_path):
    folder = tmp_path / "r"
    shutil.copytree(data_path("config", "diffbot_sim"), folder)
    (folder / "diffbot.urdf").write_text('<robot name="r"><link name="base_link"/></robot>')
    with pytest.raises(RobotConfigError, match=r"diffbot\.urdf: no <ros2_control> tag"):
        assemble(folder)


@pytest.mark.parametrize(
    ("channel", "error", "follows", "reported"),
    [
        ("can0", None, True, []),
        ("local:x", None, False, []),
        ("can0", errno.EPROTONOSUPPORT, False, ["this kernel has no broadcast manager", "this program sends it"]),
    ],
)
def test_the_kernel_sends_sync_where_it_can_and_bus_yml_wishes_it(
    tmp_path, monkeypatch, channel, error, follows, reported
):
    monkeypatch.setattr(kernel_sync, "_bcm_socket", lambda: Bcm(error))
    files = changed(tmp_path, "robby", bus={"sync_period: 20000": "sync_period: 20000\n  sync_producer: kernel"})
    events = []
    with Reactor(ManualClock()) as reactor:
        assembly = Assembly(read_robot(files, can=[channel]), reactor, events.append, print, print)
        bus = assembly.buses["can"]
        assert bus.follows_sync is follows
        assert ("by the kernel" in bus.sync_words) is follows
    assert all(any(word in event.text for event in events) for word in reported)
    assert len(events) == bool(reported)


class Bcm:
    """A socket of the broadcast manager, or of a kernel that lacks something."""

    def __init__(self, error):
        self._error = error

    def connect(self, address):
        assert address == ("can0",)
        if self._error is not None:
            raise OSError(self._error, "no")

    def close(self):
        pass
