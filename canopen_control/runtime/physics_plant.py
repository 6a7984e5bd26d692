"""Plant file for virtual drives with physics: assigns a joint and a scale to every axis.

The file is generated from the robot's description and the scales of bus.yml, and written to the folder of the robot's
logs, where users can read and change it, and pass it to `drive --plant`.
"""

from __future__ import annotations

import contextlib
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.channel import may_host_virtual_drives, parse_channel
from canopen_control.controllers.types import roller_wheels
from canopen_control.errors import RobotConfigError
from canopen_control.hardware.device_parts import device_of
from canopen_control.hardware.driverless_system import WorldSensors
from canopen_control.host.files import state_dir, telling, write_whole
from canopen_control.runtime.robot_files import MAIN_BUS
from canopen_control.runtime.setup import required_objects
from canopen_control.urdf.robot_model import WheelGeometry

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from canopen_control.hardware.joint import JointDrive
    from canopen_control.physics.physics_file import SensorSettings
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem


# The <sensor> tags that a physics simulation measures, for a robot on virtual drives.
#
# A tag with the name of a device in bus.yml always belongs to that device. The other tags have interfaces only with
# `--physics`: on real drives, and without physics, such a tag has no interfaces.


def sensed_parts(setup: RobotSetup, tag: Ros2ControlSystem) -> list[ControlJoint]:
    """Return the sensors of a tag that physics simulates (without a device in bus.yml), or [] without physics."""
    if not setup.physics:
        return []
    nodes = {name: node.node_id for bus in setup.buses.values() for name, node in bus.nodes.items()}
    return [part for part in tag.sensors if device_of(part, nodes) is None]


def world_sensors(setup: RobotSetup) -> dict[str, SensorSettings]:
    """Return the settings of all simulated sensors by name; raise PhysicsError if one is invalid."""
    return _sensors(setup, setup.description.hardware)


def _sensors(setup: RobotSetup, tags: Iterable[Ros2ControlSystem]) -> dict[str, SensorSettings]:
    description = setup.description
    parts = [part for tag in tags for part in sensed_parts(setup, tag)]
    if not parts:
        return {}
    from canopen_control.physics.urdf_sensors import urdf_sensors  # most robots are run without physics

    return urdf_sensors(parts, description.links, description.model.root, description.path)


def sensed_world(setup: RobotSetup, tag: Ros2ControlSystem) -> WorldSensors | None:
    """Return a hardware component with the simulated sensors of a tag, or None if the tag has none.

    Raise PhysicsError if a sensor is invalid.
    """
    sensors = _sensors(setup, [tag])
    parts = [part for part in tag.sensors if part.name in sensors]
    return WorldSensors(f"{tag.name}_world", parts) if parts else None


class SensedValues:
    """Simulated sensor values, distributed to the hardware components that have these sensors."""

    def __init__(self, components: Sequence[WorldSensors], sensors: Mapping[str, SensorSettings]) -> None:
        self._components = components
        self._names = {name: _interfaces_of(name, sensor) for name, sensor in sensors.items()}

    @property
    def needed(self) -> bool:
        return bool(self._components)

    def take(self, measured: Mapping[str, tuple[float, ...]]) -> None:
        """Update the hardware components with measured values by sensor name."""
        values: dict[str, float] = {}
        for name, numbers in measured.items():
            values.update(zip(self._names.get(name, ()), numbers, strict=False))
        for component in self._components:
            component.take(values)


def _interfaces_of(name: str, sensor: SensorSettings) -> list[str]:
    from canopen_control.physics.urdf_sensors import INTERFACES

    return [f"{name}/{interface}" for interface in INTERFACES[sensor.kind]]


PLANT_FILE, BUSES_FILE = "physics.yml", "buses.yml"
_ROLLER = 45.0  # degrees
_URDF = "physics.urdf"


def check_physics(setup: RobotSetup) -> None:
    """Raise RobotConfigError if a robot cannot use `--physics`, PhysicsError if the world file is invalid."""
    if setup.real or setup.mock:
        option = "--real" if setup.real else "--mock"
        raise RobotConfigError(f"--physics is for virtual drives; omit {option}")
    if setup.files.bus_alone:
        raise RobotConfigError(f"--physics: {setup.files.bus} has no description, so nothing can be moved")
    for channel in setup.channels.values():
        if not may_host_virtual_drives(channel):
            raise RobotConfigError(f"--physics: real drives may be on {channel}; use --can local:NAME, or vcan0")
        if parse_channel(channel).kind.in_process:
            raise RobotConfigError(
                f"--physics: the drives on {channel} do not run in a process of their own; use --can local:NAME"
            )
    if setup.world is not None:
        from canopen_control.physics.scene_file import read_world_description  # most robots are run without physics

        read_world_description(setup.world)  # its errors are reported before anything is started


def write_plant(
    setup: RobotSetup, joints: Mapping[str, JointDrive], world: Path | None = None, folder: Path | None = None
) -> Path:
    """Write the plant file and a copy of the URDF; return the path of the plant file.

    `folder` defaults to the folder of the robot's logs. Raise CanopenError on failure.
    """
    if not joints:
        raise RobotConfigError(f"--physics: no joint of {setup.description.path} is moved by a drive of bus.yml")
    folder = state_dir(setup.name) if folder is None else folder
    _make_folder(folder)
    write_whole(folder / _URDF, setup.description.urdf_xml.encode())
    path = folder / PLANT_FILE
    write_whole(path, plant_text(setup, joints.values(), world).encode())
    return path


def plant_text(setup: RobotSetup, joints: Iterable[JointDrive], world: Path | None = None) -> str:
    """Return the text of the plant file for the joints of a robot."""
    rollers = _rollers(setup)
    ratios = {
        transmission.joint: transmission.reduction
        for tag in setup.description.hardware
        for transmission in tag.transmissions
    }
    lines = [f"# of {setup.description.path} and bus.yml", "engine: mujoco", f"urdf: {_URDF}"]
    lines += [f"urdf_source: {json.dumps(source)}" for source in _copied_from(setup.description)]
    lines += [] if world is None else [f"world: {json.dumps(str(world))}"]
    lines += [*_sensor_lines(setup), "axes:"]
    for joint in joints:
        axis, bus = joint.axis.number, _bus_of(setup, joint.node.name)
        address = f"{bus}{joint.node.node_id}/{axis}" if axis else f"{bus}{joint.node.node_id}"
        scale = joint.scale.pos_to_dev * ratios.get(joint.joint, 1.0)
        roller = "" if joint.joint not in rollers else f", roller: {rollers[joint.joint]:g}"
        lines.append(f'  "{address}": {{joint: {json.dumps(joint.joint)}, scale_pos_to_dev: {scale!r}{roller}}}')
    if encoders := list(_encoders(setup)):
        lines += ["encoders:", *encoders]
    return "\n".join(lines) + "\n"


def _copied_from(description: UrdfDescription) -> Iterator[str]:
    """Yield the path of the description if the written URDF is a copy of it and not the output of xacro."""
    path = Path(description.path)
    with contextlib.suppress(OSError, UnicodeDecodeError):
        if path.read_text(encoding="utf-8") == description.urdf_xml:
            yield str(path.absolute())


def _sensor_lines(setup: RobotSetup) -> list[str]:
    """Return the lines of the plant file about simulated sensors."""
    sensors = world_sensors(setup)
    lines = [
        f"  {json.dumps(name)}: {{kind: {sensor.kind}, link: {json.dumps(sensor.link)}, noise: {sensor.noise!r}, "
        f"reach: {sensor.reach!r}, seed: {sensor.seed}}}"
        for name, sensor in sensors.items()
    ]
    return ["sensors:", *lines] if lines else []


def _bus_of(setup: RobotSetup, node: str) -> str:
    """Return the bus prefix of a node's address in the plant file; "" for the main bus."""
    bus = next(name for name, bus in setup.buses.items() if node in bus.nodes)
    return "" if bus == MAIN_BUS else f"{bus}:"


def _encoders(setup: RobotSetup) -> Iterator[str]:
    """Yield the encoder lines of the plant file, for nodes whose joints have no command interfaces."""
    nodes = {name: node.node_id for bus in setup.buses.values() for name, node in bus.nodes.items()}
    for part in (joint for tag in setup.description.hardware for joint in tag.joints):
        device = part.parameters.get("device_name", "")
        if device in nodes and not part.command_interfaces:
            yield f'  "{_bus_of(setup, device)}{nodes[device]}": {{joint: {json.dumps(part.name)}}}'


def buses_of(setup: RobotSetup, plant: Path) -> list[str]:
    """Return the lines about one robot for the buses file (format in `virtual.bus_group`)."""
    lines = [f"  {json.dumps(setup.name)}:", f"    plant: {json.dumps(str(plant))}", "    buses:"]
    for name, channel in setup.channels.items():
        eds = {
            str(node.node_id): str(setup.buses[name].eds_paths[node.name]) for node in setup.buses[name].nodes.values()
        }
        required = {
            str(node.node_id): {f"0x{index:04X}:{subindex:02X}": value for (index, subindex), value in objects.items()}
            for node in setup.buses[name].nodes.values()
            if (objects := required_objects(setup.buses[name], node.name))
        }
        more = f", objects: {json.dumps(required)}" if required else ""
        lines.append(f"      {name}: {{channel: {json.dumps(channel)}, nodes: {json.dumps(eds)}{more}}}")
    return lines


def write_buses(folder: Path, robots: Iterable[tuple[RobotSetup, Path]], world: Path | None = None) -> Path:
    """Write the buses file for robots with their plant files; return the path."""
    lines = ["engine: mujoco", *([] if world is None else [f"world: {json.dumps(str(world))}"]), "robots:"]
    lines += [line for setup, plant in robots for line in buses_of(setup, plant)]
    _make_folder(folder)
    path = folder / BUSES_FILE
    write_whole(path, ("\n".join(lines) + "\n").encode())
    return path


def _make_folder(folder: Path) -> None:
    with telling(folder, "nothing was started"):
        folder.mkdir(parents=True, exist_ok=True)


def _rollers(setup: RobotSetup) -> dict[str, float]:
    """Return the roller angles of mecanum wheels in degrees, by joint: 45 or -45 depending on the corner.

    This is the usual way of mounting, and the way that the kinematics of the mecanum controller assumes.
    """
    configs = ((roller_wheels(config.type), config.params.flat) for config in setup.controllers.controllers.values())
    keys, params = next((candidate for candidate in configs if candidate[0]), ((), None))
    if params is None:
        return {}
    geometry, places = WheelGeometry(setup.description.model), {}
    for key in keys:
        name = params.get(key)
        if name is not None and (place := geometry.place(str(name.value))) is not None:
            places[str(name.value)] = place[1]
    middle = [sum(place[axis] for place in places.values()) / max(1, len(places)) for axis in range(2)]
    return {
        joint: math.copysign(_ROLLER, -(place[0] - middle[0]) * (place[1] - middle[1]))
        for joint, place in places.items()
    }
