"""`record --bag`: a ROS 2 bag of a running robot, until Ctrl-C, for so many seconds, or until the robot ends."""

from __future__ import annotations

import signal
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from canopen_control.client import RobotClient
from canopen_control.errors import ConfigError, RemoteError
from canopen_control.host.signals import on_signals

if TYPE_CHECKING:
    from canopen_control.trace.bag import BagWriter

__all__ = ["MAX_RATE", "RATE", "record_bag", "sentence"]

RATE = 50.0  # Hz of the samples, unless another is asked for
MAX_RATE = 1000.0
_LOOK_S = 0.25  # how often Ctrl-C is looked for while nothing comes
_ENDS = (signal.SIGINT, signal.SIGTERM)  # noted, so that the bag is finished


def record_bag(name: str | None, folder: str, seconds: float | None, rate: float = RATE) -> dict[str, Any]:
    """Write the bag and return {"bag", "robot", "messages", "samples", "events", "seconds"}.

    ConfigError when no robot runs, rosbags is missing, or `folder` is there already.
    """
    if not 0 < rate <= MAX_RATE:
        raise ConfigError(f"--rate {rate:g} Hz: it must be above 0 and at most {MAX_RATE:g}")
    from canopen_control.trace.bag import BagWriter

    stopping = threading.Event()
    with RobotClient.connect(name) as robot:
        controllers, urdf = robot.call("controllers"), robot.call("description")["urdf"]
        writer = BagWriter(Path(folder), robot.robot, controllers=controllers, urdf=urdf)
        with on_signals(_ENDS, stopping.set), writer as bag:
            begin = time.monotonic()  # importing rosbags takes half a second
            counts = _record(robot, bag, rate, stopping, None if seconds is None else begin + seconds)
            took = round(time.monotonic() - begin, 3)
    return {"bag": folder, "robot": robot.robot, "messages": bag.messages, **counts, "seconds": took}


def sentence(recorded: dict[str, Any]) -> str:
    """Return the result for people."""
    return (
        f"{recorded['bag']}: {recorded['messages']} messages of {recorded['robot']} in {recorded['seconds']:.1f} s "
        f"({recorded['samples']} samples, {recorded['events']} events)"
    )


def _record(
    robot: RobotClient, bag: BagWriter, rate: float, stopping: threading.Event, end: float | None
) -> dict[str, int]:
    counts = {"samples": 0, "events": 0}
    robot.call("subscribe", state_rate=rate, events=True)
    try:
        while not stopping.is_set() and (end is None or time.monotonic() < end):
            for message in robot.messages(_LOOK_S if end is None else min(_LOOK_S, max(end - time.monotonic(), 0.0))):
                _write(bag, message, counts)
                if stopping.is_set() or (end is not None and time.monotonic() >= end):
                    break
    except RemoteError as error:  # the robot has ended: what came before is a whole bag
        if error.kind != "BusClosed":
            raise
    return counts


def _write(bag: BagWriter, message: dict[str, Any], counts: dict[str, int]) -> None:
    if "state" in message:
        bag.state(message["state"])
        counts["samples"] += 1
    elif "event" in message:
        bag.event(message["event"])
        counts["events"] += 1
