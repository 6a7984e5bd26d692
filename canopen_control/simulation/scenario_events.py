"""Events of a simulation, and the table of their kinds.

A schedule is a list of events, random or from a scenario file; `EventPlayer` executes it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.virtual.scenario import world_words

if TYPE_CHECKING:
    from canopen_control.rpc.messages.drive import WorldAct


class EventKind(NamedTuple):
    """Kind of an event: target (`node`, `member`, `controller` or none), description, allowed keys.

    `breaks` is True for a fault; faults are counted by the states in which they occur.
    """

    target: str
    does: str
    lasts: bool = False
    values: bool = False
    breaks: bool = False


KINDS: Final = {
    "fault": EventKind("node", "switches a fault of a virtual drive on, and off after `for`", lasts=True, breaks=True),
    "heal": EventKind("node", "switches a fault of a virtual drive off"),
    "quirk": EventKind(
        "node", "switches a quirk of a virtual drive on, `NAME=VALUE@AXIS`, and off after `for`", lasts=True
    ),
    "quirk_off": EventKind("node", "switches a quirk of a virtual drive off"),
    "plant": EventKind("node", "sets numbers of what hangs on an axis"),
    "world": EventKind("", "puts on a payload, pushes, blocks a joint, or changes the grip of the floor", lasts=True),
    "power": EventKind("node", "takes the supply of a drive away, for good or for a while", lasts=True, breaks=True),
    "stall": EventKind(
        "member", "lets a process do nothing for a while: `master`, or a drive's node id", lasts=True, breaks=True
    ),
    "kill": EventKind("", "kills the robot's process; it starts again after `for`", lasts=True, breaks=True),
    "cut": EventKind("member", "cuts the cable of `master`, or of a drive, for a while", lasts=True, breaks=True),
    "bus_off": EventKind("member", "sends a CAN controller off the bus", lasts=True, breaks=True),
    "lose": EventKind("member", "loses some frames of a member, or of all", lasts=True, values=True, breaks=True),
    "double": EventKind("member", "doubles some frames of a member, or of all", lasts=True, values=True, breaks=True),
    "disturb": EventKind("member", "disturbs some frames, which are sent again", lasts=True, values=True, breaks=True),
    "frame": EventKind("", "puts an unexpected frame onto the bus: identifier, then bytes", values=True, breaks=True),
    "command": EventKind("controller", "commands values, ten times a second", lasts=True, values=True),
    "trajectory": EventKind(
        "controller",
        "sends a trajectory to positions, there after `for`, or by way of several at `times`",
        lasts=True,
        values=True,
    ),
    "cancel": EventKind("controller", "cancels what a trajectory controller follows"),
    "silent": EventKind("", "connects clients that say nothing: how many, 1 without a value", lasts=True, values=True),
    "deaf": EventKind("", "connects a client that watches everything, asks on and on, and reads nothing", lasts=True),
    "ask": EventKind("", "asks for the status as a client that waits for each answer", lasts=True),
    "dead_man": EventKind(
        "controller",
        "commands values once, as a client with whose connection the command ends, and leaves after `for`",
        lasts=True,
        values=True,
    ),
    "stop": EventKind("", "stops the robot"),
    "latch": EventKind("", "stops the robot and latches it"),
    "release": EventKind("", "releases a latched stop"),
    "axis": EventKind("", "enable, disable, halt, quick-stop or fault-reset (`name`) of all drives"),
    "activate": EventKind("controller", "switches to a controller"),
    "deactivate": EventKind("controller", "deactivates a controller"),
}


@dataclass(frozen=True, slots=True)
class ScenarioEvent:
    """Event `at_ns` after the start, of a kind in KINDS; `for_ns` is its duration, None: unlimited or instantaneous.

    `target` is a node id, `master`, or a controller; `name` is the name of a fault, a quirk or an action, `world` a
    disturbance of the physics world. `times` are the times in s of the points of a trajectory, whose values are
    concatenated; empty for one point. `when` is a state machine and a state, such as "axis power BRAKING": the event
    waits until its node, or any node, is in this state.
    """

    at_ns: int
    kind: str
    target: str = ""
    name: str = ""
    values: tuple[float, ...] = ()
    for_ns: int | None = None
    plant: tuple[tuple[str, float], ...] = ()
    axis: int = 0
    times: tuple[float, ...] = ()
    when: str = ""
    world: WorldAct | None = None

    @property
    def words(self) -> str:
        world = "" if self.world is None else " ".join(f"{key} {value}" for key, value in world_words(self.world))
        text = " ".join(word for word in (self.kind, self.target, self.name, world) if word)
        values = " ".join(f"{word:g}" for word in self.values)
        lasts = f" for {self.for_ns / 1e9:g} s" if self.for_ns is not None else ""
        when = f", as soon as {self.when}" if self.when else ""
        return f"{self.at_ns / 1e9:.3f} s: {text}{f' {values}' if values else ''}{lasts}{when}"
