"""Judges motion on a bus by what was requested of the robot: frames and facts in, breaches out; no I/O, no clock.

A fact that took a while (asked at one time, answered at another) happened at an unknown moment
between the two, a frame arrived at an unknown moment between two looks at the bus, and motion is a breach only where no
choice of these moments allows it. So a breach is never a matter of how late somebody read.

Motion is allowed while somebody has asked to enable since the last stop reason, and a command that may be newer than
that is not older than its life, not replaced, and its source still there. When that ends the wheels may move on for the
time that the reason needs to be noticed (`Reason.detect`), `GRACE_S`, and the ramp; no longer. All times in seconds.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from campaigner.wire import CONTROLWORD, STATUSWORD, TARGET_VELOCITY, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Iterator

    from campaigner.wire import Wire


GRACE_S: Final = 0.25  # one or two cycles, the delay of a socket, and the scheduling delay of a busy machine
MOTOR_S: Final = 0.1  # lag of a shaft behind its ramp
STANDING: Final = 0.05  # rad/s
_KEPT_S: Final = 30.0  # facts that ended longer ago have no effect
_AGAIN_S: Final = 1.0  # a motion is one breach, not one for each wheel and frame; a gap of this length ends it
_RUNS: Final = 0x000F  # controlword: switch on, enable voltage, no quick stop, enable operation
_HALT: Final = 0x0100
_POWERED: Final = ((0x6F, 0x27), (0x6F, 0x07), (0x4F, 0x0F))  # operation enabled, quick stop, fault reaction


@dataclass(slots=True)
class Enable:
    """A request to enable the drives; `done` is the time of its answer, whatever the answer was."""

    asked: float
    done: float = math.inf


@dataclass(slots=True)
class Command:
    """A command, or a stream of commands until `done`; `speed` in rad/s, 0 or nan (no value) causes no motion.

    `gone`: when its source's connection had ended, if it is to end with that. A `refused` one counts until its answer;
    no value ends what was commanded before also when it is refused.
    """

    source: str
    speed: float
    asked: float
    life: float
    done: float = math.inf
    gone: float = math.inf
    refused: bool = False

    @property
    def end(self) -> float:
        """Return the time after which it cannot cause motion any more."""
        return self.done if self.refused else min(self.done + self.life, self.gone)


@dataclass(slots=True)
class Reason:
    """A reason to stop everything: it occurred between `since` and `known`, and must be detected within `detect`."""

    name: str
    since: float
    known: float = math.inf
    detect: float = 0.0


@dataclass(frozen=True, slots=True)
class Breach:
    """A violated invariant; `rule` is its short name."""

    time: float
    rule: str
    text: str


@dataclass(slots=True)
class _Shaft:
    word: int = 0  # controlword
    target: int = 0
    status: int = 0
    heard: float = -math.inf
    moving: bool = False
    rose: float = -math.inf  # start of the motion


class Observer:
    """Evaluates the traffic of a bus; `top_speed` (rad/s) is the highest commanded speed. `breaches` grows."""

    def __init__(self, wire: Wire, top_speed: float) -> None:
        self.wire = wire
        self.ramp = wire.ramp(top_speed)
        self.breaches: list[Breach] = []
        self.moved_s = 0.0  # total duration of observed motion, permitted or not
        self._enables: list[Enable] = []
        self._commands: list[Command] = []
        self._reasons: list[Reason] = []
        self._excuses: deque[tuple[float, float, int]] = deque()  # from, to, node (0: all)
        self._shafts = {node: _Shaft() for node in wire.nodes}
        self._pruned = self._told = -math.inf
        self._last_motion = -math.inf

    # ------------------------------------------------------------------------------------------- facts

    def add(self, fact: Enable | Command | Reason) -> None:
        """Add a fact, at the latest when its effect may show on the bus; its owner completes it later."""
        if isinstance(fact, Enable):
            self._enables.append(fact)
        elif isinstance(fact, Command):
            self._commands.append(fact)
        else:
            self._reasons.append(fact)

    def excuse(self, since: float, until: float, node: int = 0) -> None:
        """Add a period in which nothing could be done or observed; running deadlines are extended by its length."""
        self._excuses.append((since, until, node))

    # ------------------------------------------------------------------------------------------- the bus

    def on_frame(self, early: float, late: float, identifier: int, data: bytes) -> None:
        """Evaluate a frame that arrived between two times."""
        for node, index, value in self.wire.values(identifier, data):
            shaft = self._shafts[node]
            if index == CONTROLWORD:
                shaft.word = value
                self._judge_target(early, late, node)
            elif index == TARGET_VELOCITY:
                shaft.target = value
                self._judge_target(early, late, node)
            elif index == STATUSWORD:
                shaft.status = value
            elif index == VELOCITY:
                shaft.heard = late
                self._judge_shaft(early, late, node, value / self.wire.scales[node])

    def on_shaft(self, early: float, late: float, node: int, velocity: float) -> None:
        """Evaluate a shaft velocity (device units/s) that was read directly while the bus is silent."""
        self._judge_shaft(early, late, node, velocity / self.wire.scales[node])

    def silent(self, node: int, now: float) -> bool:
        """Whether the velocity of this node is currently not on the bus."""
        return now - self._shafts[node].heard > 3 * self.wire.limits.sync

    def powered(self, node: int) -> bool:
        """Whether the drive's last statusword says that it drives its motor."""
        return any(self._shafts[node].status & mask == value for mask, value in _POWERED)

    def forget(self, node: int) -> None:
        """Forget a node after it or its master was restarted; its old reports are obsolete."""
        self._shafts[node] = _Shaft()

    # ------------------------------------------------------------------------------------------ evaluation

    def _judge_target(self, early: float, late: float, node: int) -> None:
        shaft = self._shafts[node]
        drives = shaft.word & _RUNS == _RUNS and not shaft.word & _HALT and shaft.target != 0
        if drives and not self._allowed(early - self._margin(early, node, GRACE_S + self.ramp), late):
            if self._told_just_now(late):
                return
            speed = shaft.target / self.wire.scales[node]
            text = f"its target velocity is {speed:.2f} rad/s (controlword 0x{shaft.word:04X}), {self.why(late)}"
            self._report_event(late, "target", node, text)

    def _judge_shaft(self, early: float, late: float, node: int, speed: float) -> None:
        shaft = self._shafts[node]
        moves = abs(speed) > STANDING
        if moves and not shaft.moving:
            shaft.rose = late
        shaft.moving = moves
        if not moves:
            return
        if late > self._last_motion:
            self.moved_s += min(late - self._last_motion, self.wire.limits.sync)
            self._last_motion = late
        margin = self._margin(early, node, GRACE_S + self.ramp + MOTOR_S)
        if not self._allowed(early - margin, late) and not self._told_just_now(late):
            ended = self._last_allowed(late)
            began = ended is None or shaft.rose > ended + margin
            power = "under power" if self.powered(node) else "without power"
            text = f"its shaft turns at {speed:.2f} rad/s ({power}), {self.why(late)}"
            self._report_event(late, "motion" if began else "stop", node, text)

    def _margin(self, early: float, node: int, margin: float) -> float:
        """Return how long motion that is no longer permitted may continue, extended by excuses in that time."""
        waiting = [(since, until) for since, until, whose in self._excuses if whose in (0, node) and since < early]
        found = True
        while found:
            found = False
            for since, until in waiting:
                if until > early - margin:
                    margin += min(until, early) - since
                    waiting.remove((since, until))
                    found = True
                    break
        return margin

    def _allowed(self, begin: float, end: float) -> bool:
        """Whether motion was permitted at any time in the interval; a period of permission begins with a request."""
        return any(self._allowed_at(moment) for moment in self._moments(begin, end))

    def _moments(self, begin: float, end: float) -> Iterator[float]:
        yield end
        yield begin
        asked = [enable.asked for enable in self._enables] + [command.asked for command in self._commands]
        yield from (moment for moment in asked if begin < moment <= end)

    def _allowed_at(self, moment: float) -> bool:
        for enable in self._enables:
            if enable.asked <= moment and not self._ended(enable, moment):
                for command in self._commands:
                    if command.asked <= moment and command.done >= enable.asked and self._drives(command, moment):
                        return True
        return False

    def _ended(self, enable: Enable, moment: float) -> bool:
        """Whether a stop reason that certainly came after this enable must be in effect."""
        return any(reason.since > enable.done and reason.known + reason.detect < moment for reason in self._reasons)

    def _drives(self, command: Command, moment: float) -> bool:
        if not abs(command.speed) > 0 or moment > command.end:
            return False
        replaced = (later.done for later in self._commands if later.asked > command.done and not _in_vain(later))
        return moment <= min(replaced, default=math.inf)

    def _last_allowed(self, before: float) -> float | None:
        """Return approximately when motion was last permitted, or None if it never was."""
        moment = before
        while moment > before - _KEPT_S:
            if self._allowed_at(moment):
                return moment
            moment -= self.wire.limits.sync
        return None

    def why(self, moment: float) -> str:
        """Return the reason why nothing should move."""
        ended = self._last_allowed(moment)
        if ended is None:
            return "and that was not allowed for long: no command newer than an enable"
        reasons = [reason for reason in self._reasons if ended - 1.0 <= reason.known + reason.detect <= moment]
        names = ", ".join(dict.fromkeys(reason.name for reason in reasons))
        return f"{moment - ended:.2f} s after {names or self._how_the_command_ended(ended)}"

    def _how_the_command_ended(self, ended: float) -> str:
        near = [command for command in self._commands if command.asked <= ended + 0.1 and abs(command.speed) > 0]
        if not near:
            return "the last command"
        last = max(near, key=lambda command: (min(command.end, ended + 0.1), command.asked))
        if last.refused:
            return f"a command of {last.source} was refused"
        if last.gone <= last.done + last.life and last.gone < ended + 0.5:
            return f"the connection of {last.source} ended"
        if last.end < ended + 0.5:
            return f"the last command (of {last.source}) had expired"
        return f"the command of {last.source} was replaced"

    def _told_just_now(self, time: float) -> bool:
        before, self._told = self._told, time
        return time - before <= _AGAIN_S

    def _report_event(self, time: float, rule: str, node: int, text: str) -> None:
        self.breaches.append(Breach(time, rule, f"node {node} ({self.wire.nodes[node]}): {text}"))

    # ------------------------------------------------------------------------------------------- memory

    def prune(self, now: float) -> None:
        """Discard facts that are no longer relevant; call this regularly."""
        if now - self._pruned < 1.0:
            return
        self._pruned = now
        old = now - _KEPT_S
        self._commands = [command for command in self._commands if command.end > old]
        while self._excuses and self._excuses[0][1] < old:
            self._excuses.popleft()
        settled = [reason for reason in self._reasons if reason.known + reason.detect < old]
        if settled:
            newest = max(state.since for state in settled)
            self._enables = [enable for enable in self._enables if enable.done >= newest]
            self._reasons = [reason for reason in self._reasons if reason.since >= newest or reason not in settled]


def _in_vain(command: Command) -> bool:
    """Whether a command has no effect: refused, unless for its value, which sets the target to zero."""
    return command.refused and math.isfinite(command.speed)
