"""Configuration of a robot, read from its files and checked before a channel is opened.

All errors that can be detected before the first frame are reported here (exit code 2); the three files are also
compared with each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.channel import ChannelKind, may_host_virtual_drives, name_and_channel, parse_channel
from canopen_control.cia402.objects import SI_UNIT_VELOCITY
from canopen_control.controllers.types import is_broadcaster, moves_joints
from canopen_control.errors import RobotConfigError, nearest
from canopen_control.hardware.axis_parameters import add_plugin_interfaces
from canopen_control.hardware.plugins import PluginKind, kind_of
from canopen_control.master.config import read_bus
from canopen_control.master.event_log import Level
from canopen_control.master.plan_identity import compared_values
from canopen_control.od.indices import IDENTITY
from canopen_control.runtime.default_description import (
    controllers_of,
    default_warnings,
    description_of,
    with_free_drives,
)
from canopen_control.runtime.robot_bus import is_simulated
from canopen_control.runtime.robot_files import MAIN_BUS
from canopen_control.runtime.sync_choice import SyncChoice, SyncSender, choose_sync
from canopen_control.urdf.description import DescriptionReader

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from canopen_control.controllers.controllers_file import ControllersFile
    from canopen_control.master.config import BusConfig
    from canopen_control.master.plan import NodePlan
    from canopen_control.od.model import Address
    from canopen_control.runtime.robot_files import RobotFiles
    from canopen_control.urdf.description import UrdfDescription

    _ReadBuses = Callable[[], dict[str, BusConfig]]


BUS_NAME = MAIN_BUS


def unit_quirks(bus: BusConfig, name: str) -> list[str]:
    """Return the virtual-drive quirks for a node whose velocity unit is not one position unit per s.

    The unit follows from the scales in bus.yml. No quirk is needed if the EDS gives the velocity unit (0x60A9).
    """
    units, od, axes = bus.nodes[name].units, bus.dictionaries[name], bus.plans[name].axes
    if any((entry := od.get(SI_UNIT_VELOCITY + offset)) and entry.value for offset in axes):
        return []
    scales = [units.of_axis(axis) for axis in range(len(axes))]
    ratios = [abs(scale["pos_to_dev"] / scale["vel_to_dev"]) for scale in scales]
    return [f"own_velocity_unit={ratio:.9g}@{axis}" for axis, ratio in enumerate(ratios) if ratio != 1.0]


def required_objects(bus: BusConfig, name: str) -> dict[Address, int]:
    """Return the identity and firmware version that bus.yml requires of a node, where its EDS has other values.

    A virtual drive that stands for the node has them instead of those of the EDS. The serial number is always among
    them, because a virtual drive ignores the one of its EDS.
    """
    od = bus.dictionaries[name]
    return {
        address: number
        for _, address, number in compared_values(bus.nodes[name])
        if number != od.number(*address) or address == (IDENTITY, 4)
    }


@dataclass(frozen=True, slots=True)
class RobotSetup:
    """Checked configuration of a robot; `channels` maps bus names to channels, `to_activate` names controllers.

    `sync` maps bus names to SYNC producers; `kernel_sync` is True if the command line requests the kernel.
    `unplaced` are the buses for which neither an option nor bus.yml gives a channel, so that a local bus is used;
    `world` is the world file for a physics simulation.
    """

    name: str
    files: RobotFiles
    buses: dict[str, BusConfig]
    channels: dict[str, str]
    description: UrdfDescription
    controllers: ControllersFile
    to_activate: tuple[str, ...]
    mock: bool
    notes: tuple[str, ...]
    real: bool = False
    kernel_sync: bool = False
    physics: bool = False
    sync: Mapping[str, SyncChoice] = field(default_factory=dict)
    drives: bool = False
    simulate: bool = False
    unplaced: tuple[str, ...] = ()
    world: Path | None = None

    @property
    def reaches_real_drives(self) -> bool:
        """Whether real drives may move: `--real` is given, or a used bus is not virtual."""
        return bool(self.joined) and (self.real or not all(map(may_host_virtual_drives, self.channels.values())))

    def require_places(self, option: str) -> None:
        """Raise RobotConfigError if `option` is used and a bus has no configured channel."""
        if self.unplaced and self.joined:
            which = " ".join(f"--can {name}=can{at}" for at, name in enumerate(self.unplaced))
            example = "--can can0" if self.unplaced == (BUS_NAME,) else which
            raise RobotConfigError(
                f"{option}: where are the drives? Give their channel with {example} "
                "(or vcan0, pcan:PCAN_USBBUS1@500000, ...); canopen-control bus list shows the interfaces"
            )

    @property
    def uncertainties(self) -> tuple[str, ...]:
        """Warnings about nodes of a bus without controllers, with the remedy in bus.yml."""
        return tuple(default_warnings(self.buses)) if self.files.bus_alone else ()

    @property
    def notices(self) -> Iterator[tuple[str, Level, str]]:
        """Notes and warnings about the files, as kind, level and text of events at the start."""
        yield from (("note", Level.INFO, text) for text in self.notes)
        yield from (("bundled", Level.INFO, text) for bus in self.joined.values() for text in bus.substitutes)
        yield from (("doubt", Level.WARNING, text) for text in self.uncertainties)
        yield from (("argument", Level.WARNING, f"{word} {_IDLE}") for word in self.files.idle)
        yield from (("sync", Level.INFO, text) for text in self.sync_notes)

    @property
    def on_drives(self) -> bool:
        """Whether an option replaces the hardware plugins of the description by real or virtual drives."""
        return self.real or self.physics or self.drives

    @property
    def kinds(self) -> list[PluginKind]:
        """Kinds of hardware plugins, in the order of the <ros2_control> tags."""
        tags, real = self.description.hardware, self.on_drives
        return [kind_of(self.description, tag, mock=self.mock, real=real) for tag in tags]

    @property
    def joined(self) -> Mapping[str, BusConfig]:
        """Buses that a run uses; empty if plugins simulate or mock the whole robot."""
        return self.buses if self.files.bus_alone or PluginKind.CANOPEN in self.kinds else {}

    @property
    def bus(self) -> BusConfig:
        """Bus in bus.yml; all other buses have the same SYNC period."""
        return self.buses[BUS_NAME]

    @property
    def runs(self) -> str:
        """Names of the started controllers as text; for a bus without controllers, names of the nodes."""
        nodes = [name for bus in self.buses.values() for name in bus.nodes]
        return ", ".join(nodes if self.files.bus_alone else self.to_activate)

    @property
    def sync_notes(self) -> Iterator[str]:
        """Notes about SYNC by the kernel, or about jerks caused by a late SYNC of this process."""
        for name, choice in self.sync.items() if not self.mock else ():
            if choice.sender is SyncSender.KERNEL:
                yield choice.words
            elif choice.hint and not is_simulated(self.channels[name]):
                yield choice.hint

    @property
    def cycle_ns(self) -> int:
        """Period of the control cycle in ns: the SYNC period if set, else from the controllers' update rate."""
        sync = self.bus.master.sync_period * 1000 if self.buses else 0
        return sync or 1_000_000_000 // self.controllers.update_rate

    @property
    def phase_ns(self) -> int:
        """Delay of the cycle after the followed SYNC, in ns: an eighth of a period, or half with `sync_order: last`."""
        followed = (self.buses[name] for name, choice in self.sync.items() if choice.sender in _OTHERS)
        closely = any(bus.master.follows_closely for bus in followed)
        return self.cycle_ns // (8 if closely else 2)

    @property
    def update_rate(self) -> int:
        """Update rate in Hz: the cycle rate, or update_rate of the controller manager if given and lower."""
        cycle = max(1, round(1e9 / self.cycle_ns))
        return min(self.controllers.update_rate, cycle) if "update_rate" in self.controllers.manager_keys else cycle


_IDLE = "is used neither by the description nor by a file of this robot, so it has no effect"
_OTHERS = (SyncSender.KERNEL, SyncSender.NODE)


def read_robot(
    files: RobotFiles,
    *,
    name: str | None = None,
    can: Sequence[str] = (),
    controllers: Sequence[str] = (),
    mock: bool = False,
    real: bool = False,
    strict: bool = False,
    peer_merge: bool = False,
    allow_unsupervised: bool = False,
    kernel_sync: bool = False,
    physics: bool = False,
    drives: bool = False,
    simulate: bool = False,
    world: Path | None = None,
    reader: DescriptionReader | None = None,
) -> RobotSetup:
    """Read and check the files of a robot; ConfigError lists the errors.

    `mock` and `real` override the hardware plugins of the description. With `strict`, suspicious settings in
    ros2_controllers.yaml are errors. `peer_merge` lets `defaults` in bus.yml override the nodes. `allow_unsupervised`
    accepts drives that do not stop when the NMT master is lost. `kernel_sync` lets the kernel send SYNC. `physics` lets
    virtual drives move the robot in a physics simulation; `drives` replaces simulation plugins by drives; `simulate`
    lets the simulation plugins move the robot, in the `world` if given. `reader` has already started to read the
    description. The hardware options in the user's arguments (`files.hardware`) have the effect of `can` and `real`.
    """
    name = name or files.name
    real = files.hardware.is_real(option=real)
    if real and mock:
        raise RobotConfigError(f"{files.hardware.real_word} contradicts --mock; omit one of them")
    on_drives = real or physics or drives
    read = partial(_buses, files, peer_merge, allow_unsupervised)
    buses, description, control, buses_expected = _contents(
        files, name, read, reader, controllers, mock=mock, strict=strict, real=on_drives
    )
    can = files.hardware.channels(can, buses)
    channels = _channels(name, buses, can)
    sync = _choose_sync(buses, channels, description, kernel_sync=kernel_sync, mock=mock)
    notes = tuple(_file_notes(buses, control, description, mock=mock, real=on_drives))
    unplaced = _unplaced(buses, can)
    parts = buses, channels, description, control, buses_expected
    return RobotSetup(
        name, files, *parts, mock, notes, real, kernel_sync, physics, sync, drives, simulate, unplaced, world
    )


def _contents(
    files: RobotFiles,
    name: str,
    read: _ReadBuses,
    reader: DescriptionReader | None,
    names: Sequence[str],
    *,
    mock: bool,
    strict: bool,
    real: bool,
) -> tuple[dict[str, BusConfig], UrdfDescription, ControllersFile, tuple[str, ...]]:
    """Read all files, add controllers for drives without a joint, and select the controllers to activate."""
    if files.bus_alone:
        _refuse_for_a_bus(files, mock=mock)
        buses = read()
        description = description_of(name, str(files.bus), buses)
        control = controllers_of(str(files.bus), description)
        free = tuple(control.controllers)
        return buses, description, control, (*started_controllers(files, control, description, names), *free)
    with reader or DescriptionReader(files.description, mappings=files.mappings(mock=mock)) as begun:
        buses = read()  # while xacro runs
        control = files.read_controllers(strict=strict)
        description = add_plugin_interfaces(begun.result(), plans_of(buses))
    complete, all_controllers, free = description, control, tuple[str, ...]()
    if not mock:
        complete, all_controllers, free = with_free_drives(description, control, buses)
    _require_bus(files, buses, complete, mock=mock, real=real)
    return buses, complete, all_controllers, (*started_controllers(files, control, description, names), *free)


def _unplaced(buses: Mapping[str, BusConfig], can: Sequence[str]) -> tuple[str, ...]:
    """Return the buses whose channel neither `--can` nor bus.yml gives."""
    named = {name_and_channel(text)[0] or BUS_NAME for text in can}
    return tuple(name for name, bus in buses.items() if name not in named and not bus.master.channel)


def _file_notes(
    buses: Mapping[str, BusConfig],
    control: ControllersFile,
    description: UrdfDescription,
    *,
    mock: bool,
    real: bool,
) -> Iterator[str]:
    """Yield warnings about suspicious or ineffective entries in the files."""
    for bus in buses.values():
        yield from bus.notes
    yield from control.warnings
    yield from description.notes
    yield from _sim_time(control, [kind_of(description, tag, mock=mock, real=real) for tag in description.hardware])


def _refuse_for_a_bus(files: RobotFiles, *, mock: bool) -> None:
    """Raise RobotConfigError for `--mock` or xacro arguments, which a bus without controllers does not support."""
    if mock:
        raise RobotConfigError(f"--mock: {files.bus} is a bus without controllers; omit the option")
    if files.arguments:
        arguments = ", ".join(f"{name}:=" for name in files.arguments)
        raise RobotConfigError(f"{arguments}: a bus without controllers has no description; omit the arguments")


def _buses(files: RobotFiles, peer_merge: bool, allow_unsupervised: bool) -> dict[str, BusConfig]:
    """Read all buses; raise RobotConfigError for contradictions between buses."""
    buses = {
        name_of_bus: read_bus(path, peer_merge=peer_merge, allow_unsupervised=allow_unsupervised)
        for name_of_bus, path in files.buses.items()
    }
    if problems := clashes_of(buses):
        raise RobotConfigError("\n".join(problems))
    return buses


def plans_of(buses: Mapping[str, BusConfig]) -> list[NodePlan]:
    """Return the plans of all nodes on all buses."""
    return [plan for bus in buses.values() for plan in bus.plans.values()]


def _sim_time(control: ControllersFile, kinds: Sequence[PluginKind]) -> list[str]:
    """Return a warning if `use_sim_time` is set but no part of the robot is simulated."""
    settings = [controller.params.flat.get("use_sim_time") for controller in control.controllers.values()]
    configured = control.manager.use_sim_time or any(
        setting is not None and setting.value is True for setting in settings
    )
    if not configured or PluginKind.SIMULATION in kinds:
        return []
    return [
        f"{control.path}: use_sim_time has no effect: no part of this robot is simulated, so its stamps are this "
        "computer's time; start the other nodes without use_sim_time or, if a program publishes /clock, the bridge "
        "with --ros-args -p use_sim_time:=true"
    ]


def clashes_of(buses: Mapping[str, BusConfig]) -> list[str]:
    """Return error texts about contradictions between buses: different SYNC periods, node names used twice."""
    owner: dict[str, str] = {}
    first = next(iter(buses.values()), None)
    differing = [
        f"{bus.path}: sync_period is {bus.master.sync_period}, but {first.master.sync_period} in {first.path}; "
        "all buses of a robot must have the same SYNC period"
        for bus in buses.values()
        if first is not None and bus.master.sync_period != first.master.sync_period
    ]
    doubled = [
        f"{bus.path}:{node.line}: a node named {node.name} is also in {owner[node.name]}; rename one of them"
        for bus in buses.values()
        for node in bus.nodes.values()
        if owner.setdefault(node.name, bus.path) != bus.path
    ]
    return differing + doubled


def _require_bus(
    files: RobotFiles, buses: Mapping[str, BusConfig], description: UrdfDescription, *, mock: bool, real: bool
) -> None:
    """Raise RobotConfigError if the description has CANopen drives but bus.yml is missing."""
    for tag in () if buses else description.hardware:
        if kind_of(description, tag, mock=mock, real=real) is PluginKind.CANOPEN:
            named = tag.parameters.get("bus_config", "").strip().strip("\"'")
            problem = f"its bus_config {named} is not a file" if named else f"{files.controllers.parent} has no bus.yml"
            candidates = sorted(Path(named).parent.glob("bus*.y*ml")) if named else []  # as bus.yaml instead of bus.yml
            remedy = f"give --bus {candidates[0]}" if candidates else "write a bus.yml, give --bus"
            place = f"{description.path}:{tag.place.line}"
            raise RobotConfigError(f"{place}: {tag.name} moves CANopen drives, but {problem}; {remedy}, or use --mock")


def _choose_sync(
    buses: Mapping[str, BusConfig],
    channels: Mapping[str, str],
    description: UrdfDescription,
    *,
    kernel_sync: bool,
    mock: bool,
) -> dict[str, SyncChoice]:
    """Return the SYNC producer of each bus; raise RobotConfigError if the kernel is requested and cannot be used."""
    if kernel_sync:
        _require_kernel_sync(buses, channels, mock=mock)
    return {
        name: choose_sync(config, channels[name], description, by_option=kernel_sync) for name, config in buses.items()
    }


def _require_kernel_sync(buses: Mapping[str, BusConfig], channels: Mapping[str, str], *, mock: bool) -> None:
    """Raise RobotConfigError for `--kernel-sync` without a bus, or if a bus has no SYNC or no SocketCAN interface."""
    if mock or not buses:
        raise RobotConfigError("--kernel-sync: the robot uses no bus; omit the option")
    for name, config in buses.items():
        if not config.master.sync_period:
            raise RobotConfigError(f"--kernel-sync: {config.path} has no sync_period, so no SYNC can be sent")
        if parse_channel(channels[name]).kind is not ChannelKind.SOCKETCAN:
            raise RobotConfigError(
                f"--kernel-sync: the kernel cannot send SYNC on {channels[name]}; "
                "omit the option, so that this program sends SYNC, or use a SocketCAN interface such as --can vcan0"
            )


def _channels(name: str, buses: Mapping[str, BusConfig], can: Sequence[str]) -> dict[str, str]:
    """Return the channel of each bus: by `--can`, else by bus.yml, else a local bus named after the robot.

    Raise RobotConfigError for an unknown bus, or for two buses on one channel.
    """
    channels = {
        bus_name: bus.master.channel
        or (f"local:{name}" if bus_name == BUS_NAME else f"local:{f'{name}_{bus_name}'[:32]}")
        for bus_name, bus in buses.items()
    }
    for text in can:
        bus, channel = name_and_channel(text)
        bus = bus or BUS_NAME
        if bus not in channels:
            raise RobotConfigError(f"--can {text}: the robot has no bus {bus!r}{nearest(bus, channels)}")
        channels[bus] = channel
    for bus, channel in channels.items():
        if (other_bus := next(bus_name for bus_name in channels if channels[bus_name] == channel)) != bus:
            raise RobotConfigError(
                f"the buses {other_bus} and {bus} are both on {channel}; give one another channel with --can {bus}="
            )
    return channels


def started_controllers(
    files: RobotFiles, control: ControllersFile, description: UrdfDescription, names: Sequence[str]
) -> tuple[str, ...]:
    """Return the controllers to activate at the start, in order; raise RobotConfigError for an unknown name.

    These are all controllers that move no joints, and the requested `names`, or without names the first controller that
    moves joints. Without names, the controllers that a launch file spawns replace them all; a bus alone has none. If
    no controller can command the robot, this also raises RobotConfigError.
    """
    for name in names:
        if name not in control.controllers:
            raise RobotConfigError(f"{files.controllers}: no controller {name!r}{nearest(name, control.controllers)}")
    if files.bus_alone:
        return ()
    if not names and files.spawned:
        return tuple(name for name in files.spawned if name in control.controllers)
    types = {name: config.type for name, config in control.controllers.items()}
    parts = [part for tag in description.hardware for part in (*tag.joints, *tag.sensors, *tag.gpios)]
    commanded = any(part.command_interfaces for part in parts)
    if not names and all(map(is_broadcaster, types.values())) and (commanded or not types):
        raise RobotConfigError(f"{files.controllers}: it has only broadcasters, so nothing can command the robot")
    moving = [name for name, type_name in types.items() if moves_joints(type_name)]
    parallel = [name for name in types if name not in moving]
    return tuple(dict.fromkeys([*parallel, *(names or moving[:1])]))
