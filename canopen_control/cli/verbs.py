"""Verbs of the command line, in groups, and the overview of all verbs.

This module imports nothing, not even `typing`, because `--help` needs nothing else.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Final


#: group -> verb -> description in the imperative, which fits a line of 80 columns
GROUPS: Final = {
    "Robot": {
        "run": "boot a robot and run its controllers",
        "demo": "run a robot on virtual drives, with a live table and some motion",
        "stop": "ramp all joints down to a standstill, and disable the drives",
        "shutdown": "stop a robot and end its runtime",
        "ros": "use ROS 2 topics and services without ros2cli; start the bridge",
    },
    "Observe": {
        "status": "show what a running robot is doing",
        "monitor": "watch drives, joints, events and frames, with a STOP key",
        "view": "serve a web page of the robot: 3D, plots, drives, STOP",
        "trace": "show decoded bus traffic, live or from a recording",
        "scope": "plot objects over time, with triggers; write CSV, PNG or MCAP",
        "report": "write an HTML report about a fault, a recording or a running robot",
    },
    "Command": {
        "command": "send values to a controller, repeatedly",
        "twist": "send a velocity to a base controller, repeatedly",
        "teleop": "drive a base with the keyboard",
        "trajectory": "play or record a trajectory of an arm, or cancel it",
        "gripper": "move a gripper to a position and wait for the end of the motion",
        "controller": "list, load, activate, deactivate and switch controllers",
        "axis": "enable, disable, halt, home or fault-reset drives",
    },
    "Commissioning": {
        "init": "create a robot from EDS files or from the devices on a bus",
        "scan": "list the devices on a bus, and compare them with bus.yml",
        "lss": "assign node-IDs and bit rates (CiA 305)",
        "jog": "move one drive with the arrow keys; needs only its EDS",
        "conform": "check conformance with CiA 301 and 402, and write a report",
        "preflight": "check a robot before its first run on real drives",
        "tune": "measure tracking, identify the load, compute loop gains",
        "calibrate": "measure wheel radii and track width of a base (UMBmark)",
        "firmware": "load a program into a node (CiA 302-3)",
        "backup": "save the parameters of a node as a DCF file",
        "restore": "write the parameters of a DCF file to a node, and verify them",
        "clone": "copy all parameters of a drive to its replacement",
    },
    "Bus": {
        "bus": "list channels, bring them up or down, disturb a local bus",
        "sdo": "read and write objects of a node, transfer files",
        "nmt": "start, stop or reset nodes",
        "gateway": "serve the text commands of CiA 309-3, for clients such as cocomm",
        "objects": "list the objects of a node: names, units, defaults, values",
        "dump": "print all current values of a node as a table, CSV or DCF",
        "record": "record the frames of a bus, or a robot as a ROS 2 bag",
        "replay": "replay a recording onto a bus, or show its contents",
    },
    "Files": {
        "check": "validate a robot's files, and report bus load and stop times",
        "plan": "list what the boot sequence writes to each node",
        "eds": "check, show and compare EDS and DCF files",
        "diff": "compare the parameters of two nodes, two files or one of each",
        "export": "write the PDO layout as DBC, or a recording as CSV",
    },
    "Simulate": {
        "simulate": "run a whole robot in virtual time, reproducibly, with faults",
        "drive": "run virtual drives",
        "device": "run virtual I/O modules, encoders or any device with an EDS",
        "fault": "inject and clear faults in a virtual drive; set its inputs",
        "quirk": "make a virtual drive behave like a manufacturer's drive",
        "world": "show the true pose in a physics simulation, and disturb it",
    },
    "This program": {
        "help": "show the most used verbs, all verbs (--all), or help for one verb",
        "bench": "compare the speed of this package with similar packages",
        "completion": "print a script that completes verbs, options and names",
    },
}
VERBS = {verb: text for group in GROUPS.values() for verb, text in group.items()}
#: verbs and actions that print no result, with the reason
WITHOUT_JSON: Final = {
    "run": "it prints events until the robot ends; `status --json` has the state",
    "demo": "same as for `run`",
    "ros bridge": "it runs until the robot ends; its options are ROS arguments",
    "monitor": "it is for people; `status --watch --json` has the same data",
    "view": "it serves a page until Ctrl-C",
    "teleop": "it is driven by keys",
    "gateway": "its answers have the format of CiA 309-3",
    "help": "it prints a text",
    "completion": "it prints a script",
}
#: output of `canopen-control` without a verb
MAX_USED: Final = (
    *("run", "demo", "stop", "status", "monitor", "view", "trace", "teleop", "axis", "controller", "init", "scan"),
    *("jog", "preflight", "bus", "sdo", "check", "plan", "simulate", "fault"),
)


def overview(*, everything: bool = False) -> str:
    """Return the help of the program: the most used verbs or all, by group, at most 80 columns wide."""
    lines = ["usage: canopen-control VERB [OPTIONS]      options: -h, --help, --version", ""]
    lines += ["CANopen and CiA 402 drives for robots. VERB is one of the subcommands below."]
    for group, verbs in GROUPS.items():
        shown = [f"  {verb:<11} {text}" for verb, text in verbs.items() if everything or verb in MAX_USED]
        lines += [f"{group}:", *shown] if shown else []
    lines += ["", "Start with:                 canopen-control run robby"]
    lines += ["Options and examples:       canopen-control help VERB"]
    return "\n".join(lines if everything else [*lines, "All verbs:                  canopen-control help --all"]) + "\n"
