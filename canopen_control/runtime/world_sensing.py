"""The <sensor> tags of a robot on virtual drives with physics: which the world measures, and what it tells of them.

A tag that stands for a device of bus.yml is that device's, with physics and without. What is measured here is there
with `--physics` alone: on real drives, and without physics, such a tag has no interfaces.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.hardware.device_parts import device_of
from canopen_control.hardware.sensed_world import SensedWorld

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from canopen_control.physics.physics_file import SensorSettings
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem

__all__ = ["SensedValues", "sensed_parts", "sensed_world", "world_sensors"]


def sensed_parts(setup: RobotSetup, tag: Ros2ControlSystem) -> list[ControlJoint]:
    """Return the sensors of a tag that the world measures: with physics, those that no device is."""
    if not setup.physics:
        return []
    nodes = {name: node.node_id for bus in setup.buses.values() for name, node in bus.nodes.items()}
    return [part for part in tag.sensors if device_of(part, nodes) is None]


def world_sensors(setup: RobotSetup) -> dict[str, SensorSettings]:
    """Return what the world is to measure, by name; PhysicsError with what is wrong of it."""
    return _sensors(setup, setup.description.hardware)


def _sensors(setup: RobotSetup, tags: Iterable[Ros2ControlSystem]) -> dict[str, SensorSettings]:
    description = setup.description
    parts = [part for tag in tags for part in sensed_parts(setup, tag)]
    if not parts:
        return {}
    from canopen_control.physics.tag_sensors import tag_sensors  # most robots are run without physics

    return tag_sensors(parts, description.links, description.model.root, description.path)


def sensed_world(setup: RobotSetup, tag: Ros2ControlSystem) -> SensedWorld | None:
    """Return the component of a tag's sensors that the world measures, None without; PhysicsError as above."""
    found = _sensors(setup, [tag])
    parts = [part for part in tag.sensors if part.name in found]
    return SensedWorld(f"{tag.name}_world", parts) if parts else None


class SensedValues:
    """Hands what a world measures to the components that show it."""

    def __init__(self, components: Sequence[SensedWorld], sensors: Mapping[str, SensorSettings]) -> None:
        self._components = components
        self._names = {name: _interfaces_of(name, each) for name, each in sensors.items()}

    @property
    def wanted(self) -> bool:
        """Whether there is anything to show."""
        return bool(self._components)

    def take(self, measured: Mapping[str, tuple[float, ...]]) -> None:
        """Show the numbers of the sensors by their names."""
        values: dict[str, float] = {}
        for name, numbers in measured.items():
            values.update(zip(self._names.get(name, ()), numbers, strict=False))
        for component in self._components:
            component.take(values)


def _interfaces_of(name: str, sensor: SensorSettings) -> list[str]:
    from canopen_control.physics.tag_sensors import INTERFACES

    return [f"{name}/{interface}" for interface in INTERFACES[sensor.kind]]
