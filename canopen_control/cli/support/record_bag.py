"""`record --bag`: a ROS 2 bag of a running robot, until Ctrl-C, for so many seconds, or until the robot ends."""

from __future__ import annotations

import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.client import RobotClient
from canopen_control.client.subscriptions import outpaced, stream_rate
from canopen_control.errors import ConfigError, RemoteError
from canopen_control.host.signals import on_signals
from canopen_control.rpc.messages.robot import MAX_RATE, GetDescription, GetStatus, ListControllers, Subscribe
from canopen_control.rpc.messages.state import RobotEvent, StateSample

if TYPE_CHECKING:
    from canopen_control.rpc.messages.robot import RobotPush
    from canopen_control.trace.bag import BagWriter

__all__ = ["MAX_RATE", "RecordedBag", "record_bag"]

_LOOK_S = 0.25  # how often Ctrl-C is looked for while nothing comes
_ENDS = (signal.SIGINT, signal.SIGTERM)  # noted, so that the bag is finished


@dataclass(slots=True)
class RecordedBag:
    """What became of a bag: `messages` are in it, of so many samples of the state and events.

    `left_out` says of which controllers not every publication is in it, None if all are.
    """

    bag: str
    robot: str
    messages: int = 0
    samples: int = 0
    events: int = 0
    seconds: float = 0.0
    left_out: str | None = None

    def sentence(self) -> str:
        """Return it for people."""
        text = (
            f"{self.bag}: {self.messages} messages of {self.robot} in {self.seconds:.1f} s "
            f"({self.samples} samples, {self.events} events)"
        )
        return text if self.left_out is None else f"{text}; {self.left_out}: --rate asks for more"


def record_bag(name: str | None, folder: str, seconds: float | None, rate: float | None = None) -> RecordedBag:
    """Write the bag and return what became of it; `rate` of the samples in Hz, by default as controllers publish.

    ConfigError when no robot runs, rosbags is missing, or `folder` is there already.
    """
    if rate is not None and not 0 < rate <= MAX_RATE:
        raise ConfigError(f"--rate {rate:g} Hz: it must be above 0 and at most {MAX_RATE:g}")
    from canopen_control.trace.bag import BagWriter

    stopping = threading.Event()
    with RobotClient.connect(name) as robot:
        controllers, urdf = robot.ask(ListControllers()), robot.ask(GetDescription()).urdf
        writer = BagWriter(Path(folder), robot.robot, controllers=controllers, urdf=urdf)
        with on_signals(_ENDS, stopping.set), writer as bag:
            begin = time.monotonic()  # importing rosbags takes half a second
            asked = stream_rate(robot.ask(GetStatus()).cycle, rate or 0.0)
            recorded = RecordedBag(folder, robot.robot, left_out=outpaced(controllers, asked))
            _record(robot, bag, recorded, asked, stopping, None if seconds is None else begin + seconds)
            recorded.seconds = round(time.monotonic() - begin, 3)
    recorded.messages = bag.messages
    return recorded


def _record(
    robot: RobotClient,
    bag: BagWriter,
    recorded: RecordedBag,
    rate: float,
    stopping: threading.Event,
    end: float | None,
) -> None:
    robot.ask(Subscribe(state_rate=rate, events=True))
    try:
        while not stopping.is_set() and (end is None or time.monotonic() < end):
            for message in robot.messages(_LOOK_S if end is None else min(_LOOK_S, max(end - time.monotonic(), 0.0))):
                _write(bag, message, recorded)
                if stopping.is_set() or (end is not None and time.monotonic() >= end):
                    break
    except RemoteError as error:  # the robot has ended: what came before is a whole bag
        if error.kind != "BusClosed":
            raise


def _write(bag: BagWriter, message: RobotPush, recorded: RecordedBag) -> None:
    if isinstance(message, StateSample):
        bag.state(message)
        recorded.samples += 1
    elif isinstance(message, RobotEvent):
        bag.event(message)
        recorded.events += 1
