"""The runtime whose bridge is measured: robby on mock hardware with diff drive; records when commands arrive.

`python -m canopen_control_bench.bridge_subject NAME`. A command's linear velocity is the time.monotonic() at which it
was published. "latencies" on standard input is answered with the seconds that each command took, and forgets them.
"""

from __future__ import annotations

import json
import sys
import time
from typing import TYPE_CHECKING, Any

from canopen_control.runtime.observer import RobotObserver
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.run_session import RunOptions, RunSession
from canopen_control.runtime.setup import read_robot
from canopen_control_bench.turns import say

if TYPE_CHECKING:
    from collections.abc import Sequence


CONTROLLER = "robby_base_controller"


class _ReadyTeller(RobotObserver):
    def running(self) -> None:
        say({"ready": True})


class BridgeSubject:
    """The robot of a session as seen by its API, with its commands timed."""

    def __init__(self, session: RunSession) -> None:
        self.session, self.latencies = session, list[float]()
        session.api._robot = self  # type: ignore[assignment]  # noqa: SLF001 - the measuring point, compiled or not
        session.robot.observers.append(_ReadyTeller())
        session.reactor.add_reader(0, self._on_order)

    def command(self, controller: str, values: Sequence[float], *words: Any, **options: Any) -> Any:  # noqa: ANN401
        """Record the age of a command, and execute it."""
        self.latencies.append(time.monotonic() - values[0])
        return self.session.robot.command(controller, [0.0] * len(values), *words, **options)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever it is there
        """Forward everything else to the robot."""
        return getattr(self.session.robot, name)

    def _on_order(self) -> None:
        line = sys.stdin.readline()
        if not line:
            self.session.reactor.remove_reader(0)
            self.session.robot.shutdown("measured")
        elif json.loads(line) == "latencies":
            taken, self.latencies = self.latencies, []
            sys.stdout.write(json.dumps(taken) + "\n")
            sys.stdout.flush()


def main(arguments: Sequence[str]) -> int:
    """Run until standard input ends."""
    setup = read_robot(find_robot("robby"), name=arguments[0], mock=True, controllers=[CONTROLLER])
    session = RunSession(setup, RunOptions(drives=False))
    try:
        BridgeSubject(session)
        return 0 if session.run() is None else 1
    finally:
        session.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
