"""Builds a robot from its files: buses with their nodes, hardware components, joints.

The law of this file: nothing is opened and nothing moves. Buses are made only where something of the description is on
one; a tag that nobody can build is refused with the line it stands at.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.errors import RobotConfigError
from canopen_control.hardware.interfaces import InterfaceRegistry
from canopen_control.hardware.plugins import Kind, made_up, transmitted
from canopen_control.hardware.system import CanopenSystem
from canopen_control.master.event_log import Event
from canopen_control.runtime.robot_bus import RobotBus
from canopen_control.runtime.simulation_engine import simulation_engine
from canopen_control.runtime.sync_choice import SyncSender
from canopen_control.runtime.world_sensing import sensed_world

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.errors import BusError
    from canopen_control.hardware.joint import JointDrive
    from canopen_control.hardware.sensed_world import SensedWorld
    from canopen_control.hardware.stop_group import StopGroup
    from canopen_control.host.reactor import Reactor
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.urdf.ros2_control import Ros2ControlSystem

__all__ = ["Assembly"]


@dataclass(slots=True)
class Assembly:
    """The parts by their names; RobotConfigError for what cannot be built.

    `systems` are the components on buses, `sensed` those that a world tells. `report` takes the events of nodes and
    joints, `on_lost` the end of a bus, `lead` the SYNCs that somebody else sends.
    """

    setup: RobotSetup
    reactor: Reactor
    report: Callable[[Event], None]
    on_lost: Callable[[BusError], None]
    lead: Callable[[int], None]
    registry: InterfaceRegistry = field(default_factory=InterfaceRegistry)
    buses: dict[str, RobotBus] = field(default_factory=dict)
    nodes: dict[str, RemoteNode] = field(default_factory=dict)
    bus_by_node: dict[str, RobotBus] = field(default_factory=dict)
    joints: dict[str, JointDrive] = field(default_factory=dict)
    systems: list[CanopenSystem] = field(default_factory=list)
    sensed: list[SensedWorld] = field(default_factory=list)
    _groups: dict[str, StopGroup[JointDrive]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        setup = self.setup
        if not setup.description.hardware and not setup.files.bus_alone:
            raise RobotConfigError(
                f"{setup.files.description}: no <ros2_control> tag; it says which drive moves which joint"
            )
        kinds = setup.kinds
        self._add_buses()
        engine = None if Kind.SIMULATION not in kinds else simulation_engine(setup, kinds, self._tell_once_it_runs)
        for tag, kind in zip(setup.description.hardware, kinds, strict=True):
            if kind is Kind.CANOPEN:
                self._add_system(tag)
                if (sensed := sensed_world(setup, tag)) is not None:
                    self.registry.register(sensed)
                    self.sensed.append(sensed)
            else:
                self.registry.register(made_up(setup.description, tag, kind, engine))

    def _tell_once_it_runs(self, kind: str, text: str) -> None:
        """Report what was found while it is built: nobody listens yet."""
        self.reactor.call_soon(lambda: self.report(Event(self.reactor.now(), kind, "", text)))

    def _add_buses(self) -> None:
        setup = self.setup
        for name, config in setup.joined.items():
            bus = RobotBus(
                name,
                setup.channels[name],
                config,
                self.reactor,
                cycle_ns=setup.cycle_ns,
                report=self.report,
                on_lost=self.on_lost,
            )
            # all buses have one period, and one of them leads the cycle
            sender = setup.sync[name].sender
            lead = None if any(each.follows_sync for each in self.buses.values()) else self.lead
            if sender is SyncSender.KERNEL and (setup.kernel_sync or self._kernel_can(bus)):
                bus.leave_sync_to_kernel(lead)
            elif sender is SyncSender.NODE:
                bus.follow_sync(lead)
            self.buses[name] = bus
            self.nodes.update(bus.network.nodes)
            self.bus_by_node.update(dict.fromkeys(bus.network.nodes, bus))

    def _kernel_can(self, bus: RobotBus) -> bool:
        """Whether the kernel can send SYNC on a bus; where it lacks something, that is told."""
        why = bus.why_no_kernel_sync()
        if why:
            text = f"{why}; this program sends it, as evenly as the machine lets it"
            self.report(Event(self.reactor.now(), "sync", "", text))
        return why is None

    def _add_system(self, tag: Ros2ControlSystem) -> None:
        nodes = {name: (node, self.bus_by_node[name].network.image) for name, node in self.nodes.items()}
        try:
            system = CanopenSystem(tag, nodes, self.report, self._groups)
        except RobotConfigError as error:
            place = f"{self.setup.files.description}:{tag.place.line}"
            raise RobotConfigError("\n".join(f"{place}: {each}" for each in str(error).splitlines())) from error
        self.systems.append(system)
        ratios = {each.joint: 1.0 / each.reduction for each in tag.transmissions}
        for joint in system.joints:
            described = self.setup.description.joints.get(joint.joint)  # a drive on a bus alone has none
            if described is not None:
                joint.axis.limits.described = described.limits.speed / abs(ratios.get(joint.joint, 1.0))
            late = self.bus_by_node[joint.node.name].sends_sync_first
            joint.tracking.pace(self.setup.cycle_ns / 1e9, late=late, factor=ratios.get(joint.joint, 1.0))
        self.joints.update((joint.joint, joint) for joint in system.joints)
        self.registry.register(transmitted(system, tag))
