"""What the plugin of a <ros2_control> tag means here.

The law of the file: the plugin names of other stacks are kept, so that their descriptions run unchanged, and so is the
one line that users change to go from simulation to hardware. `--mock` and `--real` do the same without a change.
"""

from __future__ import annotations

import enum
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canopen_control.errors import RobotConfigError, nearest
from canopen_control.hardware import mock, simulation, system
from canopen_control.hardware.transmitted_system import TransmittedSystem

if TYPE_CHECKING:
    from canopen_control.hardware.interfaces import HardwareComponent
    from canopen_control.hardware.simulation import Engine
    from canopen_control.urdf.description import Description
    from canopen_control.urdf.ros2_control import Ros2ControlSystem

__all__ = ["KNOWN", "Kind", "kind_of", "made_up", "transmitted"]


class Kind(enum.Enum):
    """What stands behind a tag."""

    CANOPEN = "canopen"
    MOCK = "mock"
    SIMULATION = "simulation"


KNOWN: Final = {
    **dict.fromkeys(system.PLUGINS, Kind.CANOPEN),
    **dict.fromkeys(mock.PLUGINS, Kind.MOCK),
    **dict.fromkeys(simulation.PLUGINS, Kind.SIMULATION),
}
"""Plugin name to kind."""


def kind_of(description: Description, tag: Ros2ControlSystem, *, mock: bool = False, real: bool = False) -> Kind:
    """Return what a tag is to be; an unknown plugin is a RobotConfigError with the nearest one, unless overruled."""
    if mock or real:
        return Kind.MOCK if mock else Kind.CANOPEN
    kind = KNOWN.get(tag.plugin)
    if kind is None:
        raise RobotConfigError(
            f"{description.path}:{tag.place.line}: no hardware plugin {tag.plugin!r}{nearest(tag.plugin, KNOWN)}"
        )
    return kind


def made_up(
    description: Description, tag: Ros2ControlSystem, kind: Kind, engine: Engine | None = None
) -> HardwareComponent:
    """Return the component of a tag that needs no bus. A tag that is mocked by option moves its joints."""
    if kind is Kind.SIMULATION:
        return simulation.SimulatedSystem(tag, description.joints, engine=engine)
    if tag.plugin not in mock.PLUGINS:
        tag = replace(tag, parameters={"calculate_dynamics": "true", **tag.parameters})
    return mock.GenericSystem(tag)


def transmitted(component: HardwareComponent, tag: Ros2ControlSystem) -> HardwareComponent:
    """Return a component seen through the transmissions of its tag, where one changes anything."""
    if all(each.trivial for each in tag.transmissions):
        return component
    return TransmittedSystem(component, tag.transmissions)
