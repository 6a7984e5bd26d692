"""`latency`: from a command to its RPDO on the wire, by API and by ROS topic, and from a TPDO to `/joint_states`.

The robot cycles at 1 kHz. Every command has a value of its own; its time ends when a listener on the bus reads the RPDO
with that value. The ROS side is `canopen_control_bench.peers.ros_latency`, an rclpy program of its own.
"""

from __future__ import annotations

import json
import select
import struct
import time
from typing import TYPE_CHECKING

from canopen_control.bus.channel import open_port
from canopen_control.client.robot_client import RobotClient
from canopen_control.errors import CanopenError
from canopen_control.frame import frames_of
from canopen_control.rpc.messages.robot import CommandController
from canopen_control_bench.clients import has_ros
from canopen_control_bench.cycle import ROBOT, Arena
from canopen_control_bench.figure import Figure, limited, percentiles
from canopen_control_bench.fleet import CONTROLLER, FIRST_NODE, SCALE
from canopen_control_bench.stage import TIMEOUT_S, stage

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.bus.port import Port
    from canopen_control_bench.runner import Options


TOPIC_LIMIT_MS = 3.0
PERIOD_US = 1000
COMMANDS = 500
_ROUNDS = 5
_PAUSE_S = 0.0037  # no multiple of the cycle
_TIMEOUT_S = 2.0
_PAIR = struct.Struct("<ii")


def measure(options: Options) -> list[Figure]:
    """Measure by API, and by ROS if it is installed; a quick run is too unsteady to measure this."""
    if options.quick:
        return []
    count, figures = COMMANDS, []
    with stage() as played:
        arena = Arena(played, 2, PERIOD_US, base=False)
        ours = arena.ours()
        client = RobotClient.connect(ROBOT)

        def command(value: float) -> None:
            client.notify(CommandController(controller=CONTROLLER, values=[value, value], source="bench"))

        rounds = [command_latencies(arena.channel, command, count) for _ in range(_ROUNDS)]
        figures.append(_figure("API command to RPDO", rounds, played.cpu_s()))
        client.close()
        if has_ros():
            bridge = played.start("canopen_control.ros.bridge", "--name", ROBOT, ros=True)
            words = ("canopen_control_bench.peers.ros_latency", arena.channel, str(count), str(_ROUNDS))
            found = json.loads(played.start(*words, ros=True).line(5 * TIMEOUT_S))
            used = played.cpu_s()
            bridge.end()
            figures.append(_figure("ROS topic to RPDO", found["commands"], used, TOPIC_LIMIT_MS))
            figures.append(_figure("TPDO to /joint_states", [found["states"]], used))
        ours.leave()
    return figures


def command_latencies(channel: str, command: Callable[[float], None], count: int) -> list[float]:
    """Send commands with distinct values, and return the time of each until its RPDO in ms."""
    found = []
    port = open_port(channel, label="listener")
    try:
        for number in range(count):
            value = 5.0 + number * 0.01
            time.sleep(_PAUSE_S)
            port.receive()
            begin = time.monotonic_ns()
            command(value)
            found.append((rpdo_with(port, value) - begin) / 1e6)
    finally:
        port.close()
    return found


def rpdo_with(port: Port, value: float) -> int:
    """Return when the RPDO with a velocity in rad/s was on the wire; raises CanopenError if it does not arrive."""
    wanted = (round(value * SCALE), int(value * SCALE))
    end = time.monotonic() + _TIMEOUT_S
    while time.monotonic() < end:
        if not select.select([port], [], [], _TIMEOUT_S)[0]:
            break
        records, now = port.receive(), time.monotonic_ns()
        for frame in frames_of(records):
            if frame.can_id == 0x300 + FIRST_NODE and _PAIR.unpack(frame.data)[1] in wanted:
                return now
    raise CanopenError(f"no RPDO with {value:g} rad/s ({wanted[0]}) within {_TIMEOUT_S:g} s of its command")


def _figure(
    name: str, rounds: Sequence[Sequence[float]], used: Mapping[str, float], limit: float | None = None
) -> Figure:
    everything = [sample for one in rounds for sample in one]
    absolutes = {f"{key} ms": round(value, 3) for key, value in percentiles(everything).items()} | dict(used)
    return limited(f"{name}: p99", "ms", [percentiles(one)["p99"] for one in rounds], limit=limit, absolutes=absolutes)
