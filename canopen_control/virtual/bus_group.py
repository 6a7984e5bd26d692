"""Virtual drives on several buses in one process and one simulated world: one or several robots.

The file lists the nodes of each bus, and the plant file of each robot; all plant files use one engine:

    engine: mujoco
    world: hall.yml                    # start poses of several robots; a single robot has it in its plant file
    robots:
      robby1:
        plant: robby1/physics.yml
        buses:
          can: {channel: "local:robby1", nodes: {"2": TMCM-1270.eds, "3": TMCM-1270.eds}}

The bus `can` is the main bus of a robot; the plant file names its axes without a bus. Paths are relative to the file.
"""

from __future__ import annotations

import contextlib
import importlib
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final, Literal

from canopen_control.bus.channel import open_port
from canopen_control.errors import ConfigError
from canopen_control.frame import MAX_NODE_ID
from canopen_control.host.reactor import Reactor
from canopen_control.profiles import object_of
from canopen_control.virtual.device import make_devices
from canopen_control.virtual.launch import NodeIdCheck, reopen
from canopen_control.virtual.plant import WORLD_NOTE
from canopen_control.virtual.process import BusNodes, DriveProcess
from canopen_control.yamlfile.convert import position
from canopen_control.yamlfile.node import Node  # noqa: TC001 - the type of a field is looked up at run time
from canopen_control.yamlfile.reader import load

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from canopen_control.bus.port import Port
    from canopen_control.personality import Personality
    from canopen_control.virtual.plant import SharedWorld, World
    from canopen_control.yamlfile.node import Problems


MAIN: Final = "can"
"""Name of the main bus of a robot."""
_ENGINES: Final = {"mujoco": "canopen_control.physics.engine"}  # imported only for a file that needs it

# ruff: noqa: RUF009 - `position` makes a field


class GroupError(ConfigError):
    """Error in a file that defines several buses."""


@dataclass(frozen=True)
class BusFile:
    """Section of the file for one bus: its channel, and the EDS files of its nodes by node-ID.

    `objects` are values such as ``"0x1018:04": 17`` that replace those of the EDS, by node-ID.
    """

    channel: str
    nodes: dict[str, str]
    objects: dict[str, dict[str, int]] = field(default_factory=dict)
    here: Node = position()


@dataclass(frozen=True)
class RobotFile:
    """Section of the file for one robot: its plant file, and its buses by name."""

    plant: str
    buses: dict[str, BusFile]
    here: Node = position()


@dataclass(frozen=True)
class BusGroup:
    """Contents of a file that defines several buses."""

    robots: dict[str, RobotFile]
    engine: Literal["mujoco"] = "mujoco"
    world: str = ""
    here: Node = position()


def read_group(path: Path) -> BusGroup:
    """Read a file that defines several buses; GroupError lists all errors by line."""
    return load(path, BusGroup, error=GroupError, check=_check)


def _check(file: BusGroup, _problems: Problems) -> None:
    if not file.robots:
        file.here.error("robots: at least one robot is required")
    if len(file.robots) > 1 and not file.world:
        file.here.error("world: several robots need the file with their start poses")
    channels = set[str]()
    for _, _, bus in _buses(file):
        if bus.channel in channels or not bus.nodes:
            bus.here.error("a bus needs nodes, and a channel that no other bus uses")
        channels.add(bus.channel)
        for text in bus.nodes:
            if not text.isdigit() or not 1 <= int(text) <= MAX_NODE_ID:
                bus.here.error(f"{text!r} is not a node-ID: 1 to {MAX_NODE_ID}")
        for node, values in bus.objects.items():
            if node not in bus.nodes or not all(map(object_of, values)):
                bus.here.error(f"objects of {node!r}: give a node-ID of `nodes`, and objects such as 0x1018:04")


def run_group(path: Path, report: Callable[[str], None], like: Personality | None = None) -> int:
    """Run the drives of a file, all with the personality `like`, until a signal arrives; return the exit code.

    Raise EdsError or ConfigError if a drive cannot be started, and BusError if a channel cannot be opened.
    """
    file = read_group(path)
    with Reactor() as reactor, contextlib.ExitStack() as cleanup:
        waiting = []
        for _, _, bus in _buses(file):
            label = f"drives {', '.join(bus.nodes)}"
            port = open_port(bus.channel, label=label)
            cleanup.callback(port.close)
            waiting.append((port, label, NodeIdCheck(reactor, port, [int(node) for node in bus.nodes])))
        world = cleanup.enter_context(contextlib.closing(open_world(file, path)))
        for note in world.notes:
            report(f"{WORLD_NOTE}{note}")
        drives = []
        for (name, bus_name, bus), (port, label, check) in zip(_buses(file), waiting, strict=True):
            side = world.side(name if file.world else "", "" if bus_name == MAIN else bus_name)
            drives.append(_nodes(bus, path, port, label, side, report, like))
            check.finish()
        return DriveProcess(reactor, drives, report).run()


def _buses(file: BusGroup) -> list[tuple[str, str, BusFile]]:
    return [(name, bus_name, bus) for name, robot in file.robots.items() for bus_name, bus in robot.buses.items()]


def _nodes(
    bus: BusFile,
    path: Path,
    port: Port,
    label: str,
    world: World,
    report: Callable[[str], None],
    like: Personality | None,
) -> BusNodes:
    eds_files = {int(node): path.parent / eds for node, eds in bus.nodes.items()}
    objects = {
        int(node): {(found[0], found[1]): value for text, value in values.items() if (found := object_of(text))}
        for node, values in bus.objects.items()
    }
    eds = next(iter(eds_files.values()))
    devices = make_devices(list(eds_files), eds, report, eds_files=eds_files, world=world, like=like, objects=objects)
    return BusNodes(port, devices.nodes, partial(reopen, bus.channel, label), world=world)


def open_world(file: BusGroup, path: Path) -> SharedWorld:
    """Open the world that all robots share; `path` is the path from which `file` was read."""
    engine = importlib.import_module(_ENGINES[file.engine])
    plants: Mapping[str, Path] = {name: path.parent / robot.plant for name, robot in file.robots.items()}
    if not file.world:
        alone: SharedWorld = engine.make(next(iter(plants.values())))
        return alone
    shared: SharedWorld = engine.make_shared(plants, path.parent / file.world)
    return shared
