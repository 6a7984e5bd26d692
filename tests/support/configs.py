"""Copies of the bundled robots with something changed, for tests of what is said about it."""

import shutil

from canopen_control.check.rules import find
from canopen_control.controllers.controllers_file import read_controllers
from canopen_control.data_files import data_path
from canopen_control.master.config import read_bus
from canopen_control.od.issues import Severity
from canopen_control.runtime.robot_files import find_robot
from canopen_control.urdf.description import read_description

ROBOTS = ("robby", "diffbot_sim", "mobile_base_ros1", "arm6", "forklift", "mecanum")


def changed(folder, name, **edits):
    """Copy a bundled robot, each `old: new` of `bus`, `controllers`, `description` replaced once; return its files."""
    target = folder / name
    shutil.copytree(data_path("config", name), target)
    files = find_robot(str(target))
    for which, changes in edits.items():
        path = getattr(files, which)
        text = path.read_text()
        for old, new in changes.items():
            assert old in text, (path.name, old)
            text = text.replace(old, new, 1)
        path.write_text(text)
    return files


FIRST = {
    "robby": "robby_forward_controller",
    "diffbot_sim": "diff_drive_base_controller",
    "mobile_base_ros1": "mobile_base_controller",
    "arm6": "arm_position_controller",
    "forklift": "forklift_base_controller",
    "mecanum": "mecanum_base_controller",
}
BASES = {
    "robby": ("robby_base_controller", "    linear.x.max_velocity: 1.0", "    "),
    "diffbot_sim": ("diff_drive_base_controller", "    linear.x.max_velocity: 1.0", "    "),
    "mobile_base_ros1": ("mobile_base_controller", "      max_velocity: 1.0", "      "),
}


def found(files, *, notes=False, **how):
    """Return the findings as text without the folder, those that are notes only where they are asked for."""
    findings = find(
        files, read_bus(files.bus), read_controllers(files.controllers), read_description(files.description), **how
    )
    folder = f"{files.bus.parent}/"
    return [str(finding).replace(folder, "") for finding in findings if notes or finding.severity is not Severity.NOTE]


def line_of(files, which, text):
    path = getattr(files, which)
    return next(number for number, line in enumerate(path.read_text().splitlines(), 1) if text in line)
