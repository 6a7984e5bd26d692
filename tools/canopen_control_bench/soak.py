"""`soak`: an hour (in CI a minute) at 100 Hz with random commands and random drive failures.

Every few seconds one of the drives shows a fault of the table of `canopen_control.virtual.fault_table`; the whole
robot has to stand still within `STOP_LIMIT_S`, and to run again after the fault is taken away, reset and enabled.
Nothing may grow and no frame may be lost by anybody but the fault. Whether the wheels stand still is read from the
drives' plants themselves, past the bus and past the runtime.
"""

from __future__ import annotations

import contextlib
import random
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.bus.local import ask_hub
from canopen_control.client.drive_client import DriveClient
from canopen_control.client.robot_client import RobotClient
from canopen_control.errors import CanopenError, RemoteError
from canopen_control.rpc.messages.drive import GetDriveState, SwitchFault
from canopen_control.rpc.messages.hub import GetHubStatus
from canopen_control.rpc.messages.robot import AxisRequest, CommandController, GetStatus
from canopen_control_bench.cycle import ROBOT, Arena, ask_robot
from canopen_control_bench.figure import Figure, limited
from canopen_control_bench.fleet import CONTROLLER
from canopen_control_bench.machine import resident_bytes
from canopen_control_bench.stage import stage

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control_bench.runner import Options


PERIOD_US = 10_000
DRIVES = 2
SECONDS, QUICK_SECONDS = 60.0, 15.0
STOP_LIMIT_S = 1.5  # the ramp from full speed takes 0.3 s, and a lost heartbeat is detected after 0.5 s
GROWTH_LIMIT_MB = 1.0
#: faults that stop the robot and can be cleared
FAULTS = (
    "drive_fault",
    "undervoltage",
    "heartbeat_lost",
    "silent",
    "tpdo_missing",
    "leaves_operational",
    "following_error",
)
_COMMAND_S, _FAULT_S = 0.05, (2.0, 5.0)
_DRIVE_S = 5.0  # maximum response time of a drive
_STANDING = 1.0  # microsteps/s
_RECOVERY_S = 20.0
_MAX_RADIANS = 12.0
_SEED = 402


@dataclass(slots=True)
class Seen:
    """The counts so far."""

    faults: int = 0
    commands: int = 0
    stops_s: list[float] = field(default_factory=list)
    recoveries_s: list[float] = field(default_factory=list)


class Soak:
    """Commands a robot and injects faults into its drives."""

    def __init__(self, arena: Arena, pid: int) -> None:
        self.arena, self.pid, self.seen = arena, pid, Seen()
        self.random = random.Random(_SEED)
        self.client = RobotClient.connect(ROBOT)
        self.drives = [DriveClient.connect(arena.channel, node, _DRIVE_S) for node in arena.nodes]

    def close(self) -> None:
        """Close the connections to the robot."""
        self.client.close()
        for drive in self.drives:
            drive.close()

    def run(self, seconds: float) -> None:
        """Run commands and faults for the given time; raises CanopenError if the robot does not recover."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._drive_for(self.random.uniform(*_FAULT_S))
            self._break()

    def _drive_for(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            values = [self.random.uniform(-_MAX_RADIANS, _MAX_RADIANS) for _ in range(self.arena.count)]
            self.client.notify(CommandController(controller=CONTROLLER, values=values, source="soak"))
            self.seen.commands += 1
            time.sleep(_COMMAND_S)

    def _break(self) -> None:
        """Fail a drive, wait until all have stopped, clear the fault, and wait until the robot runs and turns again."""
        place, fault = self.random.randrange(self.arena.count), self.random.choice(FAULTS)
        begin = time.monotonic()
        self.drives[place].ask(SwitchFault(name=fault))
        self.seen.faults += 1
        what = f"{fault} of node {self.arena.nodes[place]}"
        self.seen.stops_s.append(self._until(self._stands_still, f"all wheels to stand after {what}") - begin)
        with contextlib.suppress(CanopenError):
            self.drives[place].ask(SwitchFault(name=fault, on=False))
        begin = time.monotonic()
        self.seen.recoveries_s.append(self._until(self._runs_again, f"the robot to run after {what}") - begin)

    def _stands_still(self) -> bool:
        """Whether the wheels are at rest, and remain so while commanded."""
        values = [_MAX_RADIANS] * self.arena.count
        self.client.notify(CommandController(controller=CONTROLLER, values=values, source="soak"))
        return all(abs(self._speed(place)) < _STANDING for place in range(len(self.drives)))

    def _runs_again(self) -> bool:
        for action in ("fault-reset", "enable"):
            with contextlib.suppress(RemoteError):
                self.client.ask(AxisRequest(action=action, node="all"))
        values = [_MAX_RADIANS] * self.arena.count
        self.client.notify(CommandController(controller=CONTROLLER, values=values, source="soak"))
        time.sleep(_COMMAND_S)
        return all(abs(self._speed(place)) > _STANDING for place in range(len(self.drives)))

    def _speed(self, place: int) -> float:
        return self.drives[place].ask(GetDriveState()).axes[0].plant.velocity

    def _until(self, condition: Callable[[], bool], what: str) -> float:
        end = time.monotonic() + _RECOVERY_S
        while not condition():
            if time.monotonic() > end:
                events = [event.text for event in ask_robot(GetStatus()).events][-4:]
                raise CanopenError(f"waited {_RECOVERY_S:g} s for {what}: {'; '.join(events)}")
            time.sleep(0.01)
        return time.monotonic()


def measure(options: Options) -> list[Figure]:
    """Run the soak test after a warm-up that loads everything needed."""
    seconds = options.seconds or (QUICK_SECONDS if options.quick else SECONDS)
    with stage() as played:
        arena = Arena(played, DRIVES, PERIOD_US, base=False)
        ours = arena.ours()
        soak = Soak(arena, ours.pid)
        soak.run(min(10.0, seconds / 3))
        soak.seen, before = Seen(), resident_bytes(ours.pid) / 1e6
        soak.run(seconds)
        after, status = resident_bytes(ours.pid) / 1e6, ask_robot(GetStatus())
        lost = ask_hub(arena.buses[0], GetHubStatus()).dropped + status.buses["can"].lost
        used = played.cpu_s()
        soak.close()
        ours.leave()
    seen = soak.seen
    absolutes = {
        "seconds": seconds,
        "faults": seen.faults,
        "commands": seen.commands,
        "slowest recovery s": round(max(seen.recoveries_s), 2),
        "cycles left out": status.cycle.missed,
        "resident MB": round(after, 1),
        **used,
    }
    return [
        limited("soak: growth", "MB", [after - before], limit=GROWTH_LIMIT_MB, absolutes=absolutes, counted=True),
        limited("soak: frames lost", "", [float(lost)], limit=0.0, counted=True),
        limited("soak: latest stop after a fault", "s", [max(seen.stops_s)], limit=STOP_LIMIT_S),
    ]
