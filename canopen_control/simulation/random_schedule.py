"""Random schedule of a seed: client commands and switches, and faults of drives, buses and processes.

Random numbers come only from `random()`, whose sequence is the same in all versions of Python. Most faults
are followed by a fault reset and an enable, so that the next fault occurs in a moving robot.
"""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING, Final, TypeVar

from canopen_control.simulation.robot_under_test import MASTER
from canopen_control.virtual.fault_table import FAULTS
from canopen_control.virtual.scenario import ScenarioEvent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.simulation.motions import SampleMotion


T = TypeVar("T")

_S: Final = 1_000_000_000
_MS: Final = 1_000_000
_BOOTED_NS: Final = 600 * _MS
_SHORT_NS: Final = 6 * _S  # shorter schedules begin with their faults at once
TROUBLES: Final = ("fault", "fault", "fault", "fault", "power", "stall", "cut", "lose", "double", "disturb", "bus_off")
"""Kinds of faults without the rare ones; a kind listed n times is n times as likely."""
_RARE: Final = ("kill", "frame", "frame")
_LATE: Final = 0.15  # fraction of seeds in which a drive boots later than the robot
_LOSSES: Final = (
    "heartbeat_lost",
    "silent",
    "tpdo_missing",
    "leaves_operational",
    "spontaneous_reset",
    "drive_fault",
    "local_control",
)
"""Faults of drives that supervision must detect: at least a third of the drives' faults."""
# faults after which a drive's control loops move its shaft
_OF_ENCODERS: Final = ("position_jump", "position_wrap", "hand_moved")
# only of devices other than drives, or of drives with a boot-loader
_OF_DEVICES: Final = ("input", "output", "program")
_HANGING: Final = 0.4  # fraction of seeds with blocked clients
_HANGS: Final = ("silent", "deaf", "dead_man")
_CANCELLED: Final = 0.2  # fraction of trajectories that are cancelled
_CLIENTS: Final = ("stop", "latch", "axis", "axis", "switch")


def draw_schedule(
    seed: int, duration_ns: int, motions: Sequence[SampleMotion], nodes: Sequence[int], faults: Sequence[str]
) -> tuple[ScenarioEvent, ...]:
    """Return the events of a seed in order of time; without `faults` or `nodes`, only client requests."""
    return RandomSchedule(seed, duration_ns, motions, nodes, faults).acts()


class RandomSchedule:
    """Generator of the events of one seed."""

    def __init__(
        self, seed: int, duration_ns: int, motions: Sequence[SampleMotion], nodes: Sequence[int], faults: Sequence[str]
    ) -> None:
        self._seed, self._random = seed, Random(f"{seed}/schedule").random
        self._duration = duration_ns
        self._motions, self._nodes, self._faults = list(motions), list(nodes), list(faults if nodes else ())
        self._acts: list[ScenarioEvent] = []
        self._active = next((motion for motion in motions if motion.starts), None)

    def acts(self) -> tuple[ScenarioEvent, ...]:
        now = self._late_boot() if self._faults and self._random() < _LATE else _BOOTED_NS
        soon = self._duration <= _SHORT_NS
        trouble = now + self._between(0 if soon else 1 * _S, self._duration // 4 if soon else 5 * _S)
        while now < self._duration:
            if self._faults and now >= trouble:
                now = self._trouble(now)
                trouble = now + self._between(2 * _S, 8 * _S)
            elif self._random() < 0.12:
                now = self._client(now)
            else:
                now = self._move(now)
        if self._faults:
            self._hang()
        self._cancel()
        return tuple(sorted((act for act in self._acts if act.at_ns < self._duration), key=lambda act: act.at_ns))

    # -- numbers

    def _between(self, low: int, high: int) -> int:
        """Return a random time from `low` to `high`, in whole ms."""
        return (low + int((high - low) * self._random())) // _MS * _MS

    def _one(self, these: Sequence[T]) -> T:
        return these[int(self._random() * len(these))]

    def _add(self, at_ns: int, kind: str, target: str = "", **more: object) -> None:
        self._acts.append(ScenarioEvent(at_ns, kind, target, **more))  # type: ignore[arg-type]

    # -- clients

    def _move(self, now: int) -> int:
        """Add a command; return the time at which it ends, sometimes plus a pause in which commands expire."""
        motion, lasts = self._active, self._between(_S // 2, 3 * _S)
        if motion is not None:
            drawn = [low + (high - low) * self._random() for low, high in motion.ranges]
            still = self._random() < 0.15
            values = tuple(0.0 if still and motion.kind == "command" else round(value, 3) for value in drawn)
            self._add(now, motion.kind, motion.controller, values=values, for_ns=lasts)
        return now + lasts + (self._between(0, 6 * _S) if self._random() < 0.25 else 0)

    def _client(self, now: int) -> int:
        kind = self._one(_CLIENTS)
        if kind == "switch":
            return self._switch(now)
        moved = self._move(now)  # the robot moves again after the stop
        now += self._between(0, moved - now)
        if kind == "axis":
            self._add(now, "axis", name=self._one(("disable", "halt", "quick-stop")))
        else:
            self._add(now, kind)
        later = now + self._between(_S // 5, 2 * _S)
        if kind == "latch":
            self._add(now + 100 * _MS, "axis", name="enable")  # no effect while latched
            self._add(later, "release")
        return self._recover(max(later, moved) + 50 * _MS)

    def _switch(self, now: int) -> int:
        """Add a switch to another controller, sometimes after a time without an active controller."""
        if self._active is not None and self._random() < 0.3:
            self._add(now, "deactivate", self._active.controller)
            now += self._between(50 * _MS, 2 * _S)
        if self._motions:
            self._active = self._one(self._motions)
            self._add(now, "activate", self._active.controller)
        return now + self._between(0, _S // 2)

    def _recover(self, now: int) -> int:
        """Add a fault reset, an enable and sometimes an activation; return the time after them."""
        self._add(now, "axis", name="fault-reset")
        self._add(now + 300 * _MS, "axis", name="enable")
        if self._active is not None and self._random() < 0.5:
            self._add(now + 600 * _MS, "activate", self._active.controller)
        return now + 900 * _MS

    def _hang(self) -> None:
        """Add silent, blocked or dead-man clients to some seeds; the other events are unchanged."""
        self._random = Random(f"{self._seed}/clients").random
        if self._random() >= _HANGING:
            return
        kind, at = self._one(_HANGS), self._between(_BOOTED_NS, max(_BOOTED_NS, self._duration // 3))
        commanded = [candidate for candidate in self._motions if candidate.kind == "command" and candidate.starts]
        if kind != "dead_man":
            count = (float(self._one((1, 20, 80))),) if kind == "silent" else ()
            lasts = self._between(_S, self._duration) if kind == "silent" else None
            self._add(at, kind, values=count, for_ns=lasts)
            self._add(at + 10 * _MS, "ask", for_ns=self._between(_S, 3 * _S))
        elif commanded:
            motion = self._one(commanded)
            values = tuple(round(low + (high - low) * self._random(), 3) for low, high in motion.ranges)
            self._add(at, kind, motion.controller, values=values, for_ns=self._between(50 * _MS, 400 * _MS))

    def _cancel(self) -> None:
        """Cancel some trajectories; the other events are unchanged."""
        self._random = Random(f"{self._seed}/cancels").random
        for act in [candidate for candidate in self._acts if candidate.kind == "trajectory"]:
            if self._random() < _CANCELLED:
                self._add(act.at_ns + self._between(0, act.for_ns or 0), "cancel", act.target)

    # -- faults

    def _late_boot(self) -> int:
        """Add a drive that boots late, sometimes after the robot gave up waiting; return the time after recovery."""
        late = self._between(50 * _MS, 4 * _S)
        self._add(0, "power", str(self._one(self._nodes)), for_ns=late)
        return self._recover(late + _BOOTED_NS)

    def _trouble(self, now: int) -> int:
        """Add a fault or foreign frames during a motion, usually with a recovery; return the time after it."""
        moved = self._move(now)
        kind = self._one(_RARE) if self._random() < 0.08 else self._one(TROUBLES)
        at, lasts = now + self._between(0, moved - now), self._between(20 * _MS, 2500 * _MS)
        node = str(self._one(self._nodes))
        member = MASTER if self._random() < 0.3 else node
        if kind == "fault":
            self._add(at, "fault", node, name=self._fault(), for_ns=lasts)
        elif kind == "power":
            self._add(at, kind, node, for_ns=lasts)
        elif kind in ("stall", "cut", "bus_off"):
            self._add(at, kind, member, for_ns=lasts if self._random() < 0.5 else lasts // 10)
        elif kind in ("lose", "double", "disturb"):
            every = float(self._one((1, 2, 3, 7, 50)))
            self._add(at, kind, "" if self._random() < 0.3 else member, values=(every,), for_ns=lasts // 3)
        elif kind == "kill":
            self._add(at, kind, for_ns=lasts)
        else:
            for number in range(self._one((1, 1, 3, 30))):  # a burst of foreign frames
                self._add(at + number * self._between(0, 20 * _MS), "frame", values=tuple(self._frame()))
        if self._random() < 0.2:
            return max(at, moved)  # the next fault overlaps this one
        return self._recover(max(at + lasts, moved) + self._between(0, _S))

    def _fault(self) -> str:
        losses = [loss for loss in _LOSSES if loss in self._faults]
        return self._one(losses if losses and self._random() < 1 / 3 else self._faults)

    def _frame(self) -> list[float]:
        """Return a random frame: the identifier of a CANopen service, then the data bytes."""
        base = self._one((0x000, 0x080, 0x180, 0x200, 0x280, 0x580, 0x600, 0x700, 0x7E5))
        data = [float(int(256 * self._random())) for _ in range(self._one((0, 1, 2, 4, 6, 8)))]
        return [float(base + (int(self._one(self._nodes)) if base not in (0, 0x7E5) else 0)), *data]


def known_faults(*, physics: bool = False) -> list[str]:
    """Return the faults of drives; with `physics`, without faults that turn the drive's own shaft."""
    encoders = _OF_ENCODERS if physics else ()
    return [fault.name for fault in FAULTS.values() if fault.acts not in _OF_DEVICES and fault.name not in encoders]
