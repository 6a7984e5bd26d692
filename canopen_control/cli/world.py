"""Show the true pose in a physics simulation, and inject payloads, pushes, blocked joints and friction.

Without an action it prints the true pose of the robot. `payload` adds kg to a link (negative: removes them), `push`
applies a force in N along the axes of the world, `block` blocks a joint that a drive moves, `friction` changes the
friction of the floor.

A robot that a simulation plugin of ros2_control moves, without drives, can also be paused: `pause`, `step` by a number
of cycles, `play`, and `reset` to its start or to a key frame of its MJCF, which undoes all events in its world.
Commands from before `play` or `reset` are dropped.

Exit codes: 0 done; 1 nothing simulated runs, or refused; 2 wrong usage, no physics, or no such link or joint.
"""

from __future__ import annotations

import contextlib
import math
from typing import TYPE_CHECKING

from canopen_control.bus.channel import parse_channel
from canopen_control.cli.support.arguments import seconds
from canopen_control.cli.support.known_nodes import known_nodes
from canopen_control.cli.support.output import json_line
from canopen_control.client import RobotClient
from canopen_control.client.drive_client import DriveClient
from canopen_control.errors import CanopenError, ConfigError, RemoteError
from canopen_control.host.sockets import drive_name, list_sockets
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, GetWorld, PushRobot, SetGrip
from canopen_control.rpc.messages.simulation import (
    MAX_STEPS,
    GetSimulation,
    PauseSimulation,
    ResetSimulation,
    StepSimulation,
)

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.drive import BasePose, WorldAct, WorldState
    from canopen_control.rpc.messages.simulation import Simulation

    Acts = dict[str, Callable[[str | None], Request[Simulation]]]


# Actions of `world` on a robot that a simulation plugin moves: pause, play, step, reset and disturbances.
#
# Such a robot has no drives and no bus; its own process simulates the world, so its own socket gets the requests.


_TIMEOUT_S = 600.0  # enough for `MAX_STEPS`


def _pause(value: str | None) -> Request[Simulation]:
    return _without(value, "pause", PauseSimulation(paused=True))


def _play(value: str | None) -> Request[Simulation]:
    return _without(value, "play", PauseSimulation(paused=False))


def _without(value: str | None, title: str, request: Request[Simulation]) -> Request[Simulation]:
    if value is not None:
        raise ConfigError(f"world {title} {value}: {title} takes no value")
    return request


def _step(value: str | None) -> Request[Simulation]:
    count = int(value) if value is not None and value.isascii() and value.isdigit() else 1 if value is None else 0
    if not 1 <= count <= MAX_STEPS:
        raise ConfigError(f"world step {value}: a number of cycles from 1 to {MAX_STEPS}")
    return StepSimulation(steps=count)


def _reset(value: str | None) -> Request[Simulation]:
    return ResetSimulation(keyframe=value or "")


SIMULATION_ACTS: Acts = {"pause": _pause, "play": _play, "step": _step, "reset": _reset}
"""Actions on a simulation by name, with the functions that make the requests."""


def act_on_simulation(args: argparse.Namespace) -> int:
    """Pause, resume, step or reset the simulation, and print its state."""
    request = SIMULATION_ACTS[args.what](args.value)
    with RobotClient.connect(args.name) as robot:
        return _report(robot.ask(request, _TIMEOUT_S), args)


def act_in_simulation(args: argparse.Namespace, act: WorldAct) -> bool:
    """Disturb the simulated world of the robot; return False if no robot with a simulation plugin is running."""
    with contextlib.ExitStack() as stack:
        try:
            robot = stack.enter_context(RobotClient.connect(args.name))
            robot.ask(GetSimulation())
        except CanopenError:
            return False
        robot.ask(act)
        _report(robot.ask(GetSimulation()), args)
    return True


def print_simulation(args: argparse.Namespace) -> bool:
    """Print the state of the robot's simulation; return False if no robot with a simulation plugin is running."""
    try:
        with RobotClient.connect(args.name) as robot:
            _report(robot.ask(GetSimulation()), args)
    except CanopenError:
        return False
    return True


def _report(simulation: Simulation, args: argparse.Namespace) -> int:
    if args.json:
        print(json_line(simulation))
        return 0
    state = "paused; resume with: canopen-control world play" if simulation.paused else "running"
    print(f"{simulation.seconds:.6g} s simulated, in cycles of {1000.0 * simulation.period:g} ms, {state}")
    return 0


EXAMPLE = """canopen-control world
         canopen-control world payload 12 --on base_link --at 0,0,0.1
         canopen-control world push 0,30,0 --for 0.3
         canopen-control world block left_wheel_joint
         canopen-control world block left_wheel_joint off
         canopen-control world friction 0.2
         canopen-control world pause
         canopen-control world step 10
         canopen-control world reset
         canopen-control world play"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "what",
        nargs="?",
        choices=sorted({**_ACTS, **SIMULATION_ACTS}),
        help="the event (default: print the pose of the robot)",
    )
    parser.add_argument("value", nargs="?", metavar="VALUE", help="amount, joint, or number of cycles")
    parser.add_argument("state", nargs="?", choices=["on", "off"], help="block or release the joint (default: on)")
    parser.add_argument(
        "--on", default="", metavar="LINK", help="with payload, push: the link (default: the heaviest one)"
    )
    parser.add_argument("--at", default="0,0,0", metavar="X,Y,Z", help="with payload: position on the link, in m")
    parser.add_argument(
        "--for", type=seconds, default=0.2, dest="seconds", metavar="S", help="with push: duration in s (default: 0.2)"
    )
    parser.add_argument(
        "--can", metavar="CHANNEL", help="channel of the drives (default: channel of the running robot)"
    )
    parser.add_argument("--name", help="name of the robot, if it has no drives (default: the only one running)")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    if args.what in SIMULATION_ACTS:
        return act_on_simulation(args)
    if args.what is None and args.can is None and print_simulation(args):
        return 0
    if args.what is not None and args.value is None:
        raise ConfigError(f"world {args.what}: give {_NEEDS[args.what]}")
    if args.state is not None and args.what != "block":
        raise ConfigError(f"world {args.what} {args.value} {args.state}: only block takes on or off")
    act = None if args.what is None else _ACTS[args.what](args)
    if act is not None and args.can is None and act_in_simulation(args, act):
        return 0
    channel, node_id = _drive(args.can)
    with DriveClient.connect(channel, node_id) as client:
        if act is not None:
            client.ask(act)
        world = client.ask(GetWorld())
    print(json_line(world) if args.json else _world_text(world))
    return 0


def _payload(args: argparse.Namespace) -> WorldAct:
    return AddPayload(mass=_numbers(args.value, 1, "KG")[0], on=args.on, position=_three(args.at))


def _push(args: argparse.Namespace) -> WorldAct:
    return PushRobot(force=_three(args.value), on=args.on, seconds=args.seconds)


def _block(args: argparse.Namespace) -> WorldAct:
    return BlockJoint(joint=args.value, on=args.state != "off")


def _friction(args: argparse.Namespace) -> WorldAct:
    return SetGrip(friction=abs(_numbers(args.value, 1, "a number, such as 0.2")[0]))


_ACTS: dict[str, Callable[[argparse.Namespace], WorldAct]] = {
    "payload": _payload,
    "push": _push,
    "block": _block,
    "friction": _friction,
}
_NEEDS = {
    "payload": "the mass in kg, as in 12",
    "push": "the force in N along the axes of the world, as in 0,30,0",
    "block": "the name of the joint",
    "friction": "the coefficient, as in 0.2",
}


def _three(text: str) -> tuple[float, float, float]:
    x, y, z = _numbers(text, 3, "X,Y,Z, as in 0,30,0")
    return x, y, z


def _numbers(text: str, count: int, names: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ConfigError(f"{text!r}: write {names}")
    return numbers


def _drive(can: str | None) -> tuple[str, int]:
    """Return the channel and node-ID of a virtual drive in the world; every drive reports the whole world."""
    nodes = known_nodes(can)
    sockets = list_sockets("drive")
    for node in nodes:
        if drive_name(node.channel, node.node_id) in sockets:
            return node.channel, node.node_id
    if can is not None:
        channel = str(parse_channel(can))
        for node_id in range(1, 128):
            if drive_name(channel, node_id) in sockets:
                return channel, node_id
    hint = " (name their bus with --can CHANNEL)" if can is None else f" on {can}"
    raise RemoteError("BusClosed", f"no virtual drives run{hint}; start them with: canopen-control run ROBOT --physics")


def _world_text(world: WorldState) -> str:
    """Return the true pose of the robot and the values of its sensors as text."""
    sensors = [f"{name}: {' '.join(f'{value:.4g}' for value in values)}" for name, values in world.sensors.items()]
    return "\n".join([_pose(world.base), *sensors])


def _pose(base: BasePose | None) -> str:
    if base is None:
        return "the robot is fixed to the ground, or its drives have no physics: run it with --physics"
    heading = math.degrees(base.heading)
    tilt = f"roll {math.degrees(base.roll):.1f} deg, pitch {math.degrees(base.pitch):.1f} deg"
    return f"x {base.x:.4f} m, y {base.y:.4f} m, z {base.z:.4f} m, heading {heading:.2f} deg, {tilt}"
