"""Table of the kinds of scenario events.

A schedule is a list of `ScenarioEvent`, random or from a scenario file; `EventPlayer` executes it.
"""

from __future__ import annotations

from typing import Final, NamedTuple


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
    "fault": EventKind(
        "node", "switches a fault of a virtual drive on, and off again after `for`", lasts=True, breaks=True
    ),
    "fault_off": EventKind("node", "switches a fault of a virtual drive off"),
    "quirk": EventKind(
        "node", "switches a quirk of a virtual drive on, `NAME=VALUE@AXIS`, and off again after `for`", lasts=True
    ),
    "quirk_off": EventKind("node", "switches a quirk of a virtual drive off"),
    "plant": EventKind("node", "sets values of the simulated load on an axis"),
    "world": EventKind(
        "", "adds a payload, pushes the robot, blocks a joint, or changes the friction of the floor", lasts=True
    ),
    "power": EventKind("node", "switches the supply of a drive off, and on again after `for`", lasts=True, breaks=True),
    "stall": EventKind(
        "member", "suspends the process of the robot (`master`) or of a drive for a while", lasts=True, breaks=True
    ),
    "kill": EventKind("", "kills the robot's process, and restarts it after `for`", lasts=True, breaks=True),
    "cut": EventKind(
        "member", "disconnects the robot (`master`) or a drive from the bus for a while", lasts=True, breaks=True
    ),
    "bus_off": EventKind("member", "puts a CAN controller into bus-off for a while", lasts=True, breaks=True),
    "lose": EventKind(
        "member", "drops every n-th frame of one bus member, or of all members", lasts=True, values=True, breaks=True
    ),
    "double": EventKind(
        "member",
        "duplicates every n-th frame of one bus member, or of all members",
        lasts=True,
        values=True,
        breaks=True,
    ),
    "disturb": EventKind(
        "member",
        "disturbs every n-th frame by an error frame, so that it is sent again",
        lasts=True,
        values=True,
        breaks=True,
    ),
    "frame": EventKind("", "sends an unexpected frame: identifier, then data bytes", values=True, breaks=True),
    "command": EventKind("controller", "commands values ten times a second", lasts=True, values=True),
    "trajectory": EventKind(
        "controller",
        "sends a trajectory to positions that ends after `for`, or has a point at each of `times`",
        lasts=True,
        values=True,
    ),
    "cancel": EventKind("controller", "cancels the active goal of a trajectory controller"),
    "silent": EventKind(
        "", "connects clients that send nothing; the value is their number (default 1)", lasts=True, values=True
    ),
    "deaf": EventKind(
        "", "connects a client that subscribes to everything and sends requests, but never reads", lasts=True
    ),
    "ask": EventKind("", "connects a client that requests the status and waits for each answer", lasts=True),
    "dead_man": EventKind(
        "controller",
        "commands values once with the dead-man option, and disconnects after `for`",
        lasts=True,
        values=True,
    ),
    "stop": EventKind("", "stops the robot"),
    "latch": EventKind("", "stops the robot and latches STOP"),
    "release": EventKind("", "releases a latched STOP"),
    "axis": EventKind(
        "", "runs the axis action `name` on all drives: enable, disable, halt, quick-stop or fault-reset"
    ),
    "activate": EventKind("controller", "activates a controller instead of the active one"),
    "deactivate": EventKind("controller", "deactivates a controller"),
}
