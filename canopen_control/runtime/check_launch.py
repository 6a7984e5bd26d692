"""The classic mistakes of launch files in XML (ROS 1, and ROS 2's own XML), held against the robot's files.

The law of the file: nothing is launched, found or included; `$(arg NAME)` is its default, and what else is in `$(...)`
is not judged. A launch file in Python is code and is not read.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.errors import RobotConfigError, nearest
from canopen_control.runtime.check_data import Finding, Severity
from canopen_control.urdf.document import read_document

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from canopen_control.runtime.check_data import CheckedRobot
    from canopen_control.urdf.document import Element

__all__ = ["check_launch"]

_NODE_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_ARG: Final = re.compile(r"\$\((?:arg|var) +([\w.-]+)\)")
SPAWNERS: Final = ("spawner", "spawner.py", "controller_manager", "unspawner")
_WITH_VALUE: Final = (
    "--namespace",
    "-n",
    "--shutdown-timeout",
    "--timeout",
    "--wait-for",
    "-c",
    "--controller-manager",
)
DESCRIPTION: Final = "robot_description"


@dataclass
class _Launch:
    """A launch file while it is walked through."""

    path: str
    robot: CheckedRobot
    arguments: dict[str, str] = field(default_factory=dict)
    spawns: bool = False
    findings: list[Finding] = field(default_factory=list)

    def text(self, element: Element, name: str) -> str:
        """Return an attribute with the defaults of `$(arg)` in it."""
        return _ARG.sub(lambda found: self.arguments.get(found[1], found[0]), element.attributes.get(name, ""))

    def add(self, element: Element, severity: Severity, text: str, fix: str) -> None:
        """Add a finding at an element."""
        self.findings.append(Finding(self.path, element.place.line, severity, text, fix))


def check_launch(path: Path, robot: CheckedRobot) -> list[Finding]:
    """Return what is wrong in a launch file; the namespaces it gives controllers go to `robot.launch_namespaces`."""
    launch = _Launch(str(path), robot)
    if path.suffix == ".py":
        text = "a launch file in Python is code; only the XML of launch files is read"
        return [Finding(launch.path, 0, Severity.NOTE, text)]
    try:
        root = read_document(path.read_text(encoding="utf-8"), launch.path).root
    except RobotConfigError as error:
        return [Finding(launch.path, 1, Severity.ERROR, str(error).removeprefix(f"{launch.path}:"))]
    except (OSError, UnicodeDecodeError) as error:
        return [Finding(launch.path, 0, Severity.ERROR, f"cannot be read: {error}")]
    _walk(launch, root, "")
    launch.findings += _transmissions(launch)
    return launch.findings


def _walk(launch: _Launch, element: Element, namespace: str) -> None:
    for child in element.children:
        space = namespace
        if child.tag == "arg":
            _argument(launch, child)
        elif child.tag == "push-ros-namespace":
            namespace = _joined(namespace, launch.text(child, "namespace"))
        elif child.tag in ("group", "node"):
            space = _joined(namespace, launch.text(child, "ns") or launch.text(child, "namespace"))
        if child.tag == "node":
            _node(launch, child, space)
        elif child.tag == "param":
            _parameter(launch, child)
        _walk(launch, child, space)


def _joined(namespace: str, more: str) -> str:
    if more.startswith("/"):
        return more.rstrip("/")
    return f"{namespace}/{more}".rstrip("/") if more else namespace


def _argument(launch: _Launch, element: Element) -> None:
    name = element.attributes.get("name", "")
    value = launch.text(element, "value") or launch.text(element, "default")
    if value:
        launch.arguments[name] = value


def _node(launch: _Launch, element: Element, namespace: str) -> None:
    name, package = launch.text(element, "name"), launch.text(element, "pkg")
    if name and "$(" not in name and not _NODE_NAME.fullmatch(name):
        better = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "node"
        text = f"node name {name!r} is not legal: letters, digits and _ only"
        launch.add(element, Severity.ERROR, text, f"call it {better!r}")
    kind = launch.text(element, "type") or launch.text(element, "exec")
    if package == "controller_manager" and kind in SPAWNERS:
        launch.spawns = True
        _spawner(launch, element, namespace)
    if kind in ("spawn_model", "spawn_entity.py") and "-param" in launch.text(element, "args").split():
        words = launch.text(element, "args").split()
        used = words[words.index("-param") + 1] if words.index("-param") + 1 < len(words) else ""
        if used and used.rpartition("/")[2] != DESCRIPTION:
            _renamed(launch, element, used)


def _spawner(launch: _Launch, element: Element, namespace: str) -> None:
    control = launch.robot.control
    names, namespace = _spawned(launch.text(element, "args"), namespace)
    for name in names if control is not None else ():
        if control is not None and name not in control.controllers:
            text = f"the spawner is to load {name!r}, which {control.path} does not have"
            hint = nearest(name, control.controllers)
            launch.add(element, Severity.ERROR, text + hint, "use a name of the file, or add the controller to it")
        launch.robot.launch_namespaces[name] = namespace


def _spawned(arguments: str, namespace: str) -> tuple[list[str], str]:
    """Return the controllers of a spawner's arguments, and the namespace it works in."""
    names: list[str] = []
    words = iter(arguments.split())
    for word in words:
        option, equals, value = word.partition("=")
        if option in _WITH_VALUE and not equals:
            value = next(words, "")
        if option in ("--namespace", "-n"):
            namespace = _joined("", f"/{value.strip('/')}")
        elif not word.startswith("-") and "$(" not in word and word not in ("spawn", "load", "start"):
            names.append(word.rpartition("/")[2])
    return names, namespace


def _parameter(launch: _Launch, element: Element) -> None:
    name = launch.text(element, "name")
    source = launch.text(element, "command") + launch.text(element, "textfile") + launch.text(element, "value")
    if name.rpartition("/")[2] != DESCRIPTION and re.search(r"\.(urdf|xacro)\b|xacro", source):
        _renamed(launch, element, name)


def _renamed(launch: _Launch, element: Element, name: str) -> None:
    text = f"the description is called {name!r}; the controllers, Gazebo and rviz look for {DESCRIPTION!r}"
    launch.add(element, Severity.ERROR, text, f"call it {DESCRIPTION!r}")


def _transmissions(launch: _Launch) -> Iterator[Finding]:
    """Without a transmission, the controllers that are spawned find no joint."""
    description, robot = launch.robot.description, launch.robot
    if description is None or not launch.spawns or any(not tag.transmissions for tag in description.hardware):
        return
    known = {each.joint for tag in description.hardware for each in tag.transmissions}
    for name in robot.launch_namespaces:
        controller = robot.configured.get(name)
        for joint in controller.joints if controller is not None and not controller.is_broadcaster else ():
            if joint in description.joints and joint not in known:
                text = f"joint {joint!r} has no <transmission>, so {name} finds no interface of it"
                fix = "add a <transmission> with a SimpleTransmission, its joint and its actuator"
                yield Finding(description.path, description.joints[joint].place.line, Severity.ERROR, text, fix)
