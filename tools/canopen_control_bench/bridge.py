"""`bridge`: the cost of ROS in addition to the runtime: CPU per set of messages at 50 Hz, and the latency of a command.

A robot on mock hardware runs its diff drive controller, its bridge shows it, and another ROS process listens. The CPU
of the bridge, all threads, is divided by the sets of JointState, Odometry and TF that the listener got; the peer is a
node that does nothing but publish the same three messages with a timer of rclpy. The latency is from just before
`publish` in another process to the command's arrival in the runtime, by the one clock of this host; commands come
slower than the robot's cycle, since the bridge hands over one in each.
"""

from __future__ import annotations

import json
import statistics
import time
from typing import TYPE_CHECKING, Any

from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.sockets import list_sockets
from canopen_control.ros.installation import require_ros
from canopen_control_bench.figure import Figure, compared, limited, percentile, percentiles
from canopen_control_bench.machine import cpu_ns
from canopen_control_bench.stage import TIMEOUT_S, Program, Stage, stage

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control_bench.runner import Options


ROUNDS = 3
SECONDS, QUICK_SECONDS = 20.0, 6.0  # duration of publishing in all rounds together, for this package and for the peer
COMMANDS, QUICK_COMMANDS = 400, 60
COMMAND_HZ = 25.0
CPU_LIMIT = 3.0  # multiple of the cost of publishing alone: JSON is parsed, and transforms are computed
LATENCY_LIMIT_MS = 5.0  # a quarter of robby's cycle
ROBOT = "bench"
_POLL_S = 0.05


def measure(options: Options) -> list[Figure]:
    """Measure both; without ROS 2, report that they cannot be measured."""
    try:
        require_ros()
    except ConfigError as error:
        options.say(f"bridge: left out; {error}")
        return []
    seconds = (options.seconds or (QUICK_SECONDS if options.quick else SECONDS)) / ROUNDS
    with stage() as played:
        bench = BridgeBench(played)
        rounds = [(bench.bridge_us(seconds), bench.plain_us(seconds)) for _ in range(ROUNDS)]
        latencies = bench.latencies_s(QUICK_COMMANDS if options.quick else COMMANDS)
    cost = compared(
        "CPU for each JointState+Odometry+TF",
        "us",
        rounds,
        peer_name="rclpy, publishing alone",
        limit=CPU_LIMIT,
        absolutes={"at 50 Hz, % of a core": round(50e-4 * statistics.median(ours for ours, _ in rounds), 2)},
    )
    told = {f"{name} us": round(value) for name, value in percentiles(latencies, 1e6).items()}
    median = [percentile(latencies, 0.5) * 1000]
    latency = limited("topic to runtime, p50", "ms", median, limit=LATENCY_LIMIT_MS, absolutes=told)
    return [cost, latency]


class BridgeBench:
    """The robot, its bridge, a node that publishes the same messages, and a listener to both."""

    def __init__(self, played: Stage) -> None:
        self._subject = played.start("canopen_control_bench.bridge_subject", ROBOT)
        _read(self._subject)
        self._bridge = played.start("canopen_control.ros.bridge", "--name", ROBOT, ros=True)
        self._plain = played.start("canopen_control_bench.peers.rclpy_topics", "publish", ros=True)
        self._listener = played.start("canopen_control_bench.peers.rclpy_topics", "listen", ros=True)
        for program in (self._plain, self._listener):
            _read(program)
        self._await(lambda: all(min(count.values()) > 0 for count in self._counts().values()))

    def bridge_us(self, seconds: float) -> float:
        """Return the CPU time of the bridge per set of messages."""
        return self._cpu_us(self._bridge, "bridge", seconds)

    def plain_us(self, seconds: float) -> float:
        """Return the same for the node that only publishes."""
        return self._cpu_us(self._plain, "plain", seconds)

    def latencies_s(self, count: int) -> list[float]:
        """Command the base the given number of times, and return the latency of each command."""
        _ask(self._listener, {"command": count, "hz": COMMAND_HZ})
        got: list[float] = _ask(self._subject, "latencies")
        if len(got) < count / 2:
            raise CanopenError(f"only {len(got)} of {count} commands have reached the runtime")
        return got

    def _cpu_us(self, program: Program, who: str, seconds: float) -> float:
        """Measure one of the publishers while the other is running too, as in each round."""
        before, cpu = self._counts()[who], cpu_ns(program.pid)
        time.sleep(seconds)
        after, used = self._counts()[who], cpu_ns(program.pid) - cpu
        sets = min(after[topic] - before[topic] for topic in after)
        if sets <= 0:
            raise CanopenError(f"no messages of the {who} have come within {seconds:g} s")
        return used / sets / 1000

    def _counts(self) -> dict[str, dict[str, int]]:
        """Return how many messages of each topic the listener has received, by publisher."""
        counts: dict[str, dict[str, int]] = _ask(self._listener, "counts")
        return counts

    def _await(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + TIMEOUT_S
        while not condition():
            if time.monotonic() > deadline:
                raise CanopenError(f"the bridge shows nothing; robots: {list_sockets('robot')}, got {self._counts()}")
            time.sleep(_POLL_S)


def _read(program: Program) -> Any:  # noqa: ANN401 - as JSON has it
    return json.loads(program.line())


def _ask(program: Program, order: object) -> Any:  # noqa: ANN401 - as JSON has it
    program.tell(json.dumps(order))
    return _read(program)
