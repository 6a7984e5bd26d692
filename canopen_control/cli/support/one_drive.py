"""The one drive that `jog` and `tune` move: looked at on its bare bus, or found in a robot that runs."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

from canopen_control.cli.support.open_session import open_session
from canopen_control.cli.support.restoring import reached
from canopen_control.cli.support.target import find_eds
from canopen_control.client import RobotClient
from canopen_control.errors import ConfigError, DriveError
from canopen_control.service.drive_faults import fault_words, why_not_free
from canopen_control.service.driven_axis import drive_of_robot
from canopen_control.service.jog_units import JogScale
from canopen_control.service.restore_journal import unfinished_words

if TYPE_CHECKING:
    import argparse
    import contextlib

    from canopen_control.master.event_log import Event
    from canopen_control.scaffold.drive_choice import AxisChoice
    from canopen_control.scaffold.new_robot import Device, NewRobot
    from canopen_control.service.driven_axis import JogDrive

__all__ = ["axis_of", "look_at_drive", "running_drive", "tell_event", "with_counts"]


def running_drive(
    args: argparse.Namespace, name: str | None, mode: str, stack: contextlib.ExitStack
) -> tuple[JogDrive, JogScale]:
    """Return a drive of a running robot, in a mode of operation; the robot knows its units."""
    client = stack.enter_context(RobotClient.connect(name))
    drive = drive_of_robot(client, args.node, args.axis, mode)
    text = f"node {args.node} is {drive.joint} of the running robot {client.robot}, and moved through it"
    print(text, file=sys.stderr if getattr(args, "json", False) else sys.stdout)
    return drive, JogScale(args.counts or math.tau, told=True, of_joint=True)


def look_at_drive(args: argparse.Namespace, *, with_fault: bool = False) -> Device:
    """Return the device with what itself says of its units; ConfigError and DriveError for what must not be moved."""
    from canopen_control.cli.init import ask_drives
    from canopen_control.scaffold.new_robot import Device

    with open_session(args) as node:
        if not len(node.axes()):
            raise ConfigError(f"{args.eds} has no controlword (0x6040): it describes no CiA 402 drive, nothing to turn")
        if differing := node.identity_differences():
            raise ConfigError(f"{node} is not the device of {args.eds}: {'; '.join(differing)}; give its own EDS")
        if not with_fault and (words := fault_words(node)):
            again = f"canopen-control jog {args.node} --can {args.can} --eds {args.eds} --fault-reset"
            raise DriveError(f"{node} has a fault: {words}; nothing is reset by itself: {again}")
        if reason := why_not_free(node):
            raise DriveError(reason)
        if unfinished := unfinished_words(node, reached(args)):
            raise DriveError(f"{unfinished}; nothing moves with a part of each; where that is meant, delete the file")
        device = Device(node.node_id, find_eds(args.eds).resolve(), node.dictionary)
    ask_drives(args.can, [device], args.timeout or 0.5)
    return device


def axis_of(robot: NewRobot, args: argparse.Namespace) -> AxisChoice:
    """Return the axis that the arguments name; ConfigError where it has none of that number."""
    number: int = args.axis
    if number >= len(robot.joints):
        raise ConfigError(f"node {args.node} has no axis {number}; it has {len(robot.joints)}, counted from 0")
    return robot.joints[number].axis


def with_counts(robot: NewRobot, counts: float | None) -> NewRobot:
    """Return the same with what the user says of its counts."""
    if counts is None:
        return robot
    nodes = tuple(
        replace(
            node,
            drive=node.drive and replace(node.drive, axes=tuple(replace(a, counts=counts) for a in node.drive.axes)),
            joints=tuple(replace(joint, axis=replace(joint.axis, counts=counts)) for joint in node.joints),
        )
        for node in robot.nodes
    )
    return replace(robot, nodes=nodes)


def tell_event(event: Event) -> None:
    """Print what went wrong while the drive is booted and moved."""
    from canopen_control.master.event_log import Level

    if event.level >= Level.WARNING:
        print(f"\r\x1b[K{event.sentence}" if sys.stdout.isatty() else event.sentence, file=sys.stderr, flush=True)
