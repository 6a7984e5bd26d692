"""The script of a campaign: a list of timed actions drawn from a seed, written and read as lines; runs nothing itself.

The same seed and length give the same list, and a list that was cut down by hand can be played.
An episode sets the wheels turning, does one thing against them, and mends it; what an episode is made of is a table.
"""

from __future__ import annotations

import random
import shlex
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable


TOP_SPEED: Final = 12.0  # rad/s
_SLOWEST: Final = 2.0
_CHAPTER_S, _KILLING_S = 600.0, 240.0  # the first minutes of each chapter kill runtimes; the rest does not
_PROGRAM_S: Final = {"socket": 0.0, "cli": 1.0, "ros": 4.0}  # time from the start of a source to its first command
NODES: Final = (2, 3)
#: faults of the virtual drives that must stop the robot, with the value of `Limits` that bounds the reaction time
FAULTS: Final = {
    "drive_fault": "status",
    "short_circuit": "status",
    "undervoltage": "status",
    "following_error": "status",
    "power_stage_off": "status",
    "limit_switch": "status",  # only if the axis moves in the direction of the switch
    "heartbeat_lost": "consumer",
    "silent": "consumer",
    "bus_off": "consumer",
    "undefined_statusword": "consumer",
    "heartbeat_wrong_state": "heartbeat",
    "leaves_operational": "heartbeat",
    "spontaneous_reset": "heartbeat",
    "second_node": "heartbeat",
    "tpdo_missing": "feedback",
    "sync_deaf": "feedback",
}
#: faults that need not stop the robot; they must not cause motion
HARMLESS: Final = (
    "heartbeat_jitter", "sdo_silent", "sdo_late", "sdo_short_answer", "sdo_wrong_mux", "sdo_busy", "tpdo_short",
    "tpdo_long", "tpdo_late", "emcy_flood", "emcy_short", "error_passive", "duplicate_node", "clock_fast", "warning",
    "transition_slow", "fault_on_enable", "fault_reset_ignored", "boot_late", "parameter_clamped", "hand_moved",
)  # fmt: skip
HOSTILE: Final = ("junk", "long_lines", "idle", "half_open", "deaf", "requests", "churn")
FLOODS: Final = ("junk", "remote", "sync", "emergency", "master_heartbeat", "error_frames", "delay")
_VICTIMS: Final = ("runtime", "runtime", "runtime", "drive", "drive", "recorder", "hub", "bridge")
_SPARED: Final = ("drive", "drive", "recorder", "bridge")


@dataclass(frozen=True, slots=True)
class Action:
    """At `at` seconds do `kind` with `params`; written as ``12.30 fault node=2 name=silent for=3.10``."""

    at: float
    kind: str
    params: dict[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        words = [f"{name}={shlex.quote(value)}" for name, value in self.params.items()]
        return " ".join([f"{self.at:.2f}", self.kind, *words])

    def number(self, name: str, otherwise: float = 0.0) -> float:
        """Return a parameter as a number."""
        return float(self.params.get(name, otherwise))


class _Draft:
    """Generates one list of actions."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.now = 0.0
        self.actions: list[Action] = []

    def do(self, kind: str, **params: object) -> None:
        texts = {name: f"{value:.2f}" if isinstance(value, float) else str(value) for name, value in params.items()}
        self.actions.append(Action(round(self.now, 2), kind, texts))

    def wait(self, least: float, most: float) -> None:
        self.now += self.random.uniform(least, most)

    def between(self, least: float, most: float) -> float:
        return self.random.uniform(least, most)

    @property
    def spares(self) -> bool:
        """Whether the runtime is to stay alive: memory growth takes minutes to show."""
        return self.now % _CHAPTER_S > _KILLING_S

    def speed(self) -> float:
        return self.random.choice((-1, 1)) * self.random.uniform(_SLOWEST, TOP_SPEED)

    def node(self) -> int:
        return self.random.choice(NODES)

    def stream(self, least: float, most: float) -> None:
        """Add a source of commands that stays connected."""
        how = self.random.choice(("socket", "socket", "socket", "cli", "cli", "ros"))
        ends = ("close", "zeros", "silence") if how == "socket" else ("kill", "term")
        left = self.speed()
        right = left if self.random.random() < 0.6 else self.speed()
        end = self.random.choice(ends)
        slow = _PROGRAM_S[how]
        self.do("stream", left=left, right=right, how=how, ends=end, seconds=slow + self.between(least, most))
        self.now += slow

    def recover(self) -> None:
        self.do("recover")
        self.wait(0.5, 2.0)


def _turn(draft: _Draft) -> None:
    for _ in range(draft.random.choice((1, 1, 2))):
        draft.stream(1.0, 4.0)
        draft.wait(0.1, 1.0)
    draft.wait(1.0, 6.0)


def _once(draft: _Draft) -> None:
    draft.do("once", left=draft.speed(), right=draft.speed(), how=draft.random.choice(("socket", "cli")))
    draft.wait(1.0, 4.0)


def _absurd(draft: _Draft) -> None:
    draft.stream(0.5, 1.5)
    draft.wait(0.5, 1.0)
    draft.do("absurd", value=draft.random.choice(("1e308", "-1e308", "1e30", "1e12", "-4e9")))
    draft.wait(1.0, 2.5)


def _stop(draft: _Draft) -> None:
    draft.stream(2.0, 5.0)
    draft.wait(0.3, 1.5)
    latched = draft.random.random() < 0.5
    draft.do("stop", latch="yes" if latched else "no")
    draft.wait(0.5, 2.0)
    if latched and draft.random.random() < 0.5:
        draft.do("enable")  # refused
        draft.wait(0.2, 1.0)
    draft.recover()


def _command_while_stopped(draft: _Draft) -> None:
    draft.do("stop", latch="no")
    draft.wait(0.3, 1.0)
    draft.do("once", left=draft.speed(), right=draft.speed(), how=draft.random.choice(("socket", "cli")))
    draft.wait(0.4, 4.0)
    draft.do("enable")
    draft.wait(1.0, 3.0)


def _fault(draft: _Draft) -> None:
    draft.stream(3.0, 7.0)
    draft.wait(0.5, 1.5)
    name = draft.random.choice(tuple(FAULTS))
    draft.do("fault", node=draft.node(), name=name, seconds=draft.between(1.5, 4.0))
    draft.wait(4.2, 6.0)
    draft.recover()


def _harmless(draft: _Draft) -> None:
    draft.stream(2.0, 6.0)
    draft.wait(0.2, 1.0)
    draft.do("fault", node=draft.node(), name=draft.random.choice(HARMLESS), seconds=draft.between(1.0, 4.0))
    draft.wait(1.0, 2.0)
    if draft.random.random() < 0.4:
        draft.do("stop", latch="no")
    draft.wait(3.5, 5.0)
    draft.recover()


def _kill(draft: _Draft) -> None:
    draft.stream(2.0, 6.0)
    draft.wait(0.3, 1.5)
    draft.do("kill", who=draft.random.choice(_SPARED if draft.spares else _VICTIMS), node=draft.node())
    draft.wait(2.0, 4.0)
    draft.recover()


def _latched_across_a_death(draft: _Draft) -> None:
    if draft.spares:
        return
    draft.stream(1.0, 2.0)
    draft.wait(0.3, 1.0)
    draft.do("stop", latch="yes")
    draft.wait(0.3, 1.0)
    draft.do("kill", who="runtime")
    draft.do("start")
    draft.wait(0.3, 1.0)
    draft.do("enable")  # refused
    draft.wait(0.3, 1.0)
    draft.do("once", left=draft.speed(), right=draft.speed(), how="socket")
    draft.wait(1.0, 2.0)
    draft.recover()


def _kill_while_starting(draft: _Draft) -> None:
    if draft.spares:
        return
    draft.do("restart", after=draft.between(0.02, 1.5))
    draft.wait(3.0, 5.0)
    draft.recover()


def _freeze(draft: _Draft) -> None:
    draft.stream(2.0, 6.0)
    draft.wait(0.3, 1.0)
    long = draft.random.random() < 0.6
    seconds = draft.between(1.0, 3.0) if long else draft.between(0.05, 0.3)
    draft.do("freeze", who=draft.random.choice(("runtime", "drive", "recorder")), node=draft.node(), seconds=seconds)
    draft.now += seconds
    draft.wait(1.5, 3.0)
    draft.recover()


def _hostile(draft: _Draft) -> None:
    draft.stream(3.0, 7.0)
    draft.wait(0.2, 0.6)
    draft.do("hostile", name=draft.random.choice(HOSTILE), seconds=draft.between(2.0, 5.0))
    draft.wait(0.8, 1.5)
    draft.do("stop", latch=draft.random.choice(("yes", "no")))
    draft.wait(4.0, 5.0)
    draft.recover()


def _flood(draft: _Draft) -> None:
    draft.stream(3.0, 6.0)
    draft.wait(0.2, 0.6)
    draft.do("flood", name=draft.random.choice(FLOODS), seconds=draft.between(1.5, 4.0))
    draft.wait(0.8, 1.5)
    if draft.random.random() < 0.5:
        draft.do("stop", latch="no")
    draft.wait(3.0, 4.0)
    draft.recover()


def _foreigner(draft: _Draft) -> None:
    draft.stream(2.0, 5.0)
    draft.wait(0.3, 1.0)
    name = draft.random.choice(("boot_up", "reset_node", "reset_communication", "pre_operational", "stop_node"))
    draft.do("foreign", name=name, node=draft.node())
    draft.wait(2.0, 4.0)
    draft.recover()


def _cut(draft: _Draft) -> None:
    draft.stream(3.0, 6.0)
    draft.wait(0.3, 1.0)
    draft.do("cut", who=draft.random.choice(("drive", "master")), node=draft.node(), seconds=draft.between(1.0, 3.0))
    draft.wait(3.5, 5.0)
    draft.recover()


_EPISODES: Final[tuple[tuple[int, Callable[[_Draft], None]], ...]] = (
    (3, _turn),
    (2, _once),
    (1, _absurd),
    (3, _stop),
    (2, _command_while_stopped),
    (5, _fault),
    (3, _harmless),
    (5, _kill),
    (2, _kill_while_starting),
    (1, _latched_across_a_death),
    (3, _freeze),
    (4, _hostile),
    (3, _flood),
    (2, _foreigner),
    (1, _cut),
)
KINDS: Final = frozenset(
    "stream once absurd stop enable recover fault kill start restart freeze hostile flood foreign cut".split()  # noqa: SIM905
)


def make_script(seed: int, seconds: float) -> list[Action]:
    """Draw the actions of a campaign of the given duration in seconds."""
    draft = _Draft(seed)
    weights = [weight for weight, _ in _EPISODES]
    draft.wait(0.5, 1.0)
    while draft.now < seconds:
        draft.random.choices(_EPISODES, weights)[0][1](draft)
    return [action for action in draft.actions if action.at < seconds]


def read_script(lines: Iterable[str]) -> list[Action]:
    """Read lines as written by `Action`, skipping empty lines and comments; ValueError names an invalid line."""
    actions = []
    for line in lines:
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            words = shlex.split(line)
            action = Action(float(words[0]), words[1], dict(_parameter(word) for word in words[2:]))
        except (IndexError, ValueError):
            raise ValueError(f"{line.strip()!r} is not an action, such as: 1.50 stop latch=no") from None
        if action.kind not in KINDS:
            raise ValueError(f"{line.strip()!r}: there is no {action.kind!r}; available: {', '.join(sorted(KINDS))}")
        actions.append(action)
    return sorted(actions, key=lambda action: action.at)


def _parameter(word: str) -> tuple[str, str]:
    name, equals, value = word.partition("=")
    if not equals:
        raise ValueError(word)
    return name, value
