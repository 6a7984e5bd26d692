"""Assembly of a robot's buses, nodes, hardware components and joints from its configuration files.

No channel is opened and nothing moves. Buses are created only if the description uses them; a tag without an
implementation is refused with its line.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.params import LoopGains
from canopen_control.controllers.pid import Pid
from canopen_control.errors import ConfigError, RobotConfigError, nearest
from canopen_control.hardware.driverless_system import PHYSICS_PLUGIN
from canopen_control.hardware.interfaces import InterfaceRegistry
from canopen_control.hardware.plugins import PluginKind, busless_component, transmitted
from canopen_control.hardware.system import CanopenSystem
from canopen_control.master.event_log import Event
from canopen_control.physics import require_physics
from canopen_control.runtime.physics_plant import sensed_world
from canopen_control.runtime.robot_bus import RobotBus
from canopen_control.runtime.sync_choice import SyncSender
from canopen_control.yamlfile.convert import convert
from canopen_control.yamlfile.reader import tree

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.errors import BusError
    from canopen_control.hardware.axis_statechart import StopGroup
    from canopen_control.hardware.driverless_system import Engine, WorldSensors
    from canopen_control.hardware.joint import JointDrive
    from canopen_control.host.reactor import Reactor
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.physics.scene_file import WorldDescription
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.urdf.ros2_control import Ros2ControlSystem
    from canopen_control.yamlfile.node import Node


# The `pids_config_file` of mujoco_ros2_control: gains of PID loops that compute an effort from a position or velocity.
#
#  |  /**:
#  |    ros__parameters:
#  |      pid_gains:
#  |        position:
#  |          joint_1: {p: 400.0, i: 20.0, d: 15.0, u_clamp_max: 80.0, u_clamp_min: -80.0}
#  |        velocity:
#  |          wheel: {p: 2.0, i: 5.0, i_clamp_max: 3.0, i_clamp_min: -3.0}
#
# The gains have the names of control_toolbox. A joint without gains keeps its default servo loop.


Loops = dict[str, dict[str, Pid]]
"""PID loops by joint and by commanded interface."""
_PARAMETERS: Final = "ros__parameters"
_GAINS: Final = "pid_gains"
_INTERFACES: Final = ("position", "velocity")


def read_pids(path: Path, tag: Ros2ControlSystem) -> Loops:
    """Read the PID loops of a tag's joints from a `pids_config_file`; RobotConfigError lists all errors by line."""
    root, loops = tree(path, error=RobotConfigError), Loops()
    blocks = [gains for node in _parameters(root) if (gains := node.get(_GAINS)) is not None]
    if not blocks:
        root.error(f"no {_GAINS}; write it below /**: {_PARAMETERS}:")
    commands = {part.name: tuple(part.command_interfaces) for part in tag.joints}
    for block in blocks:
        for interface, joints in _mapping(block, "position: and velocity:"):
            if interface not in _INTERFACES:
                block.keys()[interface].error(f"no gains of {interface!r} are known{nearest(interface, _INTERFACES)}")
                continue
            for joint, node in _mapping(joints, "gains by joints, as in joint_1: {p: 2.0}"):
                _check(joints.keys()[joint], joint, interface, commands)
                gains = convert(node, LoopGains, None)
                if gains is not None:
                    loops.setdefault(joint, {})[interface] = Pid(gains.pid())
    root.problems.raise_if_any(RobotConfigError)
    return loops


def _mapping(node: Node, key: str) -> list[tuple[str, Node]]:
    """Return the entries of a mapping node; report an error that suggests `key` for any other node."""
    if node.kind != "mapping":
        node.error(f"write {key}")
    return node.items()


def _parameters(root: Node) -> list[Node]:
    """Return the `ros__parameters` section of each ROS node in the file."""
    nodes = [value for _, value in root.items()]
    return [section for node in nodes if node.kind == "mapping" and (section := node.get(_PARAMETERS)) is not None]


def _check(place: Node, joint: str, interface: str, commands: dict[str, tuple[str, ...]]) -> None:
    """Report a joint that the description lacks, or that lacks the command interface."""
    if joint not in commands:
        place.error(f"no joint {joint!r} in the description's <ros2_control>{nearest(joint, commands)}")
    elif interface not in commands[joint]:
        has = ", ".join(commands[joint]) or "none"
        place.error(f"joint {joint} has no command interface {interface!r}; it has {has}")


# The mechanics of simulated joints: physics if it is installed, else simple motors.
#
# A description with MuJoCo's plugin, or a world file given by the user, requires physics: if physics is not possible,
# that is an error. A description with Gazebo's plugin then runs on simple motors, and an event reports why. The
# plugin's parameters `mujoco_model` (an MJCF file) and `pids_config_file` are relative to the description's folder.


_MODEL: Final = "mujoco_model"
_PIDS: Final = "pids_config_file"


def simulation_engine(
    setup: RobotSetup, kinds: Sequence[PluginKind], report: Callable[[str, str], None]
) -> Engine | None:
    """Return the physics engine for a robot's simulated tag, or None without simulation or physics.

    Raise ConfigError if the robot requires physics and there is none. `report` receives the kind and the text of
    events: notes of the engine, or the reason why there is no physics.
    """
    tags = [tag for tag, kind in zip(setup.description.hardware, kinds, strict=True) if kind is PluginKind.SIMULATION]
    is_needed = setup.world is not None or any(tag.plugin == PHYSICS_PLUGIN for tag in tags)
    if not setup.simulate:
        return None
    try:
        require_physics()
        if len(tags) > 1:
            raise RobotConfigError(
                f"{setup.description.path}: physics moves one <ros2_control> tag, and there are {len(tags)}"
            )
        return _engine(setup, tags[0], report)
    except ConfigError as error:
        if is_needed:
            raise
        report("physics", f"simple motors move {setup.name}, since there is no physics: {error}")
        return None


def _engine(setup: RobotSetup, tag: Ros2ControlSystem, report: Callable[[str, str], None]) -> Engine:
    """Create the physics engine of a tag; raise RobotConfigError if a file has errors."""
    from canopen_control.physics.plugin_robot import make_simulated

    folder = Path(setup.description.path).parent
    model, pids = (tag.parameters.get(key, "").strip() for key in (_MODEL, _PIDS))
    loops = read_pids(folder / pids, tag) if pids else {}
    world = None if setup.world is None else _world(setup.world)
    engine = make_simulated(setup.description, tag, folder / model if model else None, loops, world)
    if problems := [f"{setup.world}:{problem}" for problem in engine.problems()]:
        raise RobotConfigError("\n".join(problems))
    for note in engine.notes:
        report("physics", note)
    return engine


def _world(path: Path) -> WorldDescription:
    """Read a world file for a single robot; raise RobotConfigError if the file defines robots."""
    from canopen_control.physics.scene_file import read_world_description

    world = read_world_description(path)
    if world.robots:
        raise RobotConfigError(f"{path}: it has robots of its own: canopen-control run --world {path}")
    return world


@dataclass(slots=True)
class Assembly:
    """Buses, nodes, joints and hardware components of a robot; RobotConfigError if a part cannot be built.

    `systems` are the hardware components on buses, `sensed` the components with sensors of a physics world. `report`
    receives the events of nodes and joints, `on_lost` the error of a lost bus, `lead` the times of SYNC messages
    from other producers.
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
    sensed: list[WorldSensors] = field(default_factory=list)
    _groups: dict[str, StopGroup[JointDrive]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        setup = self.setup
        if not setup.description.hardware and not setup.files.bus_alone:
            raise RobotConfigError(
                f"{setup.files.description}: no <ros2_control> tag; add one that assigns the drives to joints"
            )
        kinds = setup.kinds
        self._add_buses()
        engine = None if PluginKind.SIMULATION not in kinds else simulation_engine(setup, kinds, self._report_later)
        for tag, kind in zip(setup.description.hardware, kinds, strict=True):
            if kind is PluginKind.CANOPEN:
                self._add_system(tag)
                if (sensed := sensed_world(setup, tag)) is not None:
                    self.registry.register(sensed)
                    self.sensed.append(sensed)
            else:
                self.registry.register(busless_component(setup.description, tag, kind, engine))

    def _report_later(self, kind: str, text: str) -> None:
        """Report an event in the next iteration of the reactor, after the observers are registered."""
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
            # all buses have the same period, and only one of them paces the cycle
            sender = setup.sync[name].sender
            lead = None if any(bus.follows_sync for bus in self.buses.values()) else self.lead
            if sender is SyncSender.KERNEL and (setup.kernel_sync or self._kernel_can(bus)):
                bus.leave_sync_to_kernel(lead)
            elif sender is SyncSender.NODE:
                bus.follow_sync(lead)
            self.buses[name] = bus
            self.nodes.update(bus.network.nodes)
            self.bus_by_node.update(dict.fromkeys(bus.network.nodes, bus))

    def _kernel_can(self, bus: RobotBus) -> bool:
        """Whether the kernel can send SYNC on a bus; if not, the reason is reported."""
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
            raise RobotConfigError("\n".join(f"{place}: {line}" for line in str(error).splitlines())) from error
        self.systems.append(system)
        ratios = {transmission.joint: 1.0 / transmission.reduction for transmission in tag.transmissions}
        for joint in system.joints:
            described = self.setup.description.joints.get(joint.joint)  # a drive on a bus alone has none
            if described is not None:
                joint.axis.limits.described = described.limits.speed / abs(ratios.get(joint.joint, 1.0))
            late = self.bus_by_node[joint.node.name].sends_sync_first
            joint.tracking.pace(self.setup.cycle_ns / 1e9, late=late, factor=ratios.get(joint.joint, 1.0))
        self.joints.update((joint.joint, joint) for joint in system.joints)
        self.registry.register(transmitted(system, tag))
