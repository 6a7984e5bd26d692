"""Rules for common mistakes in a robot's launch files (XML of ROS 1 and 2, YAML, Python).

Nothing is launched or included. `$(arg NAME)` is replaced by its default; other substitutions in XML are not checked.
Launch files in Python are parsed and never executed (`runtime.launch_python`); computed names are reported as unknown.

`rules` imports this module only for a robot with a launch file, because most robots are run without one.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.check.finding import Finding
from canopen_control.errors import RobotConfigError, nearest
from canopen_control.od.issues import Severity
from canopen_control.runtime.launch_file import (
    SPAWNER_VALUES,
    TYPE_OPTIONS,
    launch_elements,
    option_values,
    read_launch,
    words_of,
)
from canopen_control.runtime.launch_python import read_python

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from canopen_control.check.finding import CheckedRobot
    from canopen_control.runtime.launch_file import LaunchFile
    from canopen_control.runtime.launch_python import LaunchNode
    from canopen_control.urdf.document import Element


_NODE_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_ARG: Final = re.compile(r"\$\((?:arg|var) +([\w.-]+)\)")
SPAWNERS: Final = ("spawner", "spawner.py", "controller_manager", "unspawner")
_WITH_VALUE: Final = SPAWNER_VALUES | {"--shutdown-timeout", "--wait-for"}  # the added options are those of ROS 1
DESCRIPTION: Final = "robot_description"
_FILES: Final = (".yaml", ".yml", ".urdf", ".xacro", ".eds")  # files that are not generated


@dataclass
class _Launch:
    """Launch file under check, with the arguments read so far and the findings."""

    path: str
    robot: CheckedRobot
    arguments: dict[str, str] = field(default_factory=dict)
    spawns: bool = False
    findings: list[Finding] = field(default_factory=list)

    def text(self, element: Element, name: str) -> str:
        """Return an attribute in which `$(arg NAME)` is replaced by the argument's default."""
        return _ARG.sub(lambda match: self.arguments.get(match[1], match[0]), element.attributes.get(name, ""))

    def add(self, element: Element, severity: Severity, text: str, fix: str) -> None:
        self.findings.append(Finding(self.path, element.place.line, severity, text, fix))


def check_launch(path: Path, robot: CheckedRobot) -> list[Finding]:
    """Return the findings in a launch file, and add controller namespaces to `robot.launch_namespaces`."""
    launch = _Launch(str(path), robot)
    if path.suffix == ".py":
        _check_python(launch, path)
        launch.findings += _transmissions(launch)
        return launch.findings
    try:
        root = launch_elements(path.read_text(encoding="utf-8"), path)
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
        elif child.tag.replace("_", "-") == "push-ros-namespace":  # ROS 2 has both spellings
            namespace = _joined(namespace, launch.text(child, "namespace"))
        elif child.tag in ("group", "node"):
            space = _joined(namespace, launch.text(child, "ns") or launch.text(child, "namespace"))
        if child.tag == "node":
            _node(launch, child, space)
        elif child.tag == "param":
            _parameter(launch, child)
        _walk(launch, child, space)


_GIVE: Final = "give the value with NAME:=VALUE"


def _check_python(launch: _Launch, path: Path) -> None:
    """Check the arguments, nodes and files of a Python launch file."""
    try:
        file = read_launch(path)
        content = read_python(path.read_text(encoding="utf-8"), launch.path)
    except RobotConfigError as error:
        launch.findings += findings_at(error, launch.path)
        return
    if not content.generates:
        text = "the function generate_launch_description, which ros2 launch calls, is missing"
        launch.findings.append(Finding(launch.path, 1, Severity.WARNING, text))
    for name, default in content.arguments.items():
        value = f"default {default!r}" if default is not None else "no constant default"
        text = f"argument {name}: {value}"
        launch.findings.append(Finding(launch.path, content.argument_lines[name], Severity.NOTE, text))
    outer = "".join(content.pushed)
    outer = "/**" if len(content.pushed) > 1 or "$(" in outer else _joined("", outer)  # unknown: any namespace
    for node in content.nodes:
        _python_node(launch, node, outer)
    for place in content.texts:
        if place.text is not None:
            _python_files(launch, file, place.text, place.line)
    for line, expression in dict.fromkeys(content.computed):
        text = f"{expression} is computed, and unknown without running the file"
        fix = "give it by --bus, --controllers or --description" if " file " in expression else _GIVE
        launch.findings.append(Finding(launch.path, line, Severity.NOTE, text, fix))


def findings_at(error: RobotConfigError, path: str) -> list[Finding]:
    """Convert the error of a file to a finding at the line given in the error text."""
    match = re.fullmatch(r"(\d+): (.*)", str(error).removeprefix(f"{path}:").lstrip(), re.DOTALL)
    line, text = (int(match[1]), match[2]) if match else (1, str(error).removeprefix(f"{path}: "))
    return [Finding(path, line, Severity.ERROR, text)]


def _python_node(launch: _Launch, node: LaunchNode, outer: str) -> None:
    if node.name and not _NODE_NAME.fullmatch(node.name) and "$(" not in node.name:
        text = f"node name {node.name!r} is not valid: letters, digits and _ only"
        launch.findings.append(Finding(launch.path, node.line, Severity.ERROR, text))
    title = "/".join(part for part in (node.package, node.plugin or node.executable) if part) or "a node"
    arguments = [argument for argument in node.arguments if argument.text is not None]
    if node.package == "controller_manager" and node.executable in SPAWNERS:
        launch.spawns = True
        words = [part.text for part in arguments if part.text]
        names, namespace = _spawned(words, _joined(outer, node.namespace or ""))
        for name in names:
            _check_spawned(launch, name, namespace, node.line)
        _note_types(launch, words, names, node.line)
        title = f"{title} of {', '.join(names) or 'controllers that are computed'}"
    launch.findings.append(Finding(launch.path, node.line, Severity.NOTE, f"starts {title}"))


def _python_files(launch: _Launch, file: LaunchFile, text: str, line: int) -> None:
    """Check that the files named in a text exist, if their packages are found."""
    for word in words_of(text):
        if ":=" in word or "/" not in word or not word.endswith(_FILES):
            continue  # a bare name is part of a path that is joined elsewhere
        absent = file.absent_packages(word)
        for package in absent:
            problem = f"package {package!r} was not found near this file, in ROS_PACKAGE_PATH or sourced"
            launch.findings.append(Finding(launch.path, line, Severity.NOTE, problem))
        name = None if absent else file.resolved(word)
        if name is not None and not (file.path.parent / name).is_file():
            problem = f"file {name} does not exist"
            launch.findings.append(Finding(launch.path, line, Severity.WARNING, problem))


def _check_spawned(launch: _Launch, name: str, namespace: str, line: int) -> None:
    """Check that a spawned controller is in ros2_controllers.yaml, and store its namespace."""
    control = launch.robot.control
    if control is not None and name not in control.controllers:
        text = f"the spawner loads {name!r}, which is not in {control.path}{nearest(name, control.controllers)}"
        fix = "use a name of the file, or add the controller to it"
        launch.findings.append(Finding(launch.path, line, Severity.ERROR, text, fix))
    if control is not None:
        launch.robot.launch_namespaces[name] = namespace


def _note_types(launch: _Launch, words: Sequence[str], names: Sequence[str], line: int) -> None:
    """Note types in the arguments of a spawner, which the spawner accepts up to Iron (ros2_control #1639)."""
    for type_name in option_values(words, TYPE_OPTIONS):
        text = f"the spawner of ROS 2 Jazzy and later has no option --controller-type ({type_name})"
        fix = f"give the type in ros2_controllers.yaml: controller_manager: {names[0] if names else 'NAME'}: type"
        launch.findings.append(Finding(launch.path, line, Severity.NOTE, text, fix))


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
        text = f"node name {name!r} is not valid: letters, digits and _ only"
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
    words = words_of(launch.text(element, "args"))
    names, namespace = _spawned(words, namespace)
    for name in names:
        _check_spawned(launch, name, namespace, element.place.line)
    _note_types(launch, words, names, element.place.line)


def _spawned(words: Sequence[str], namespace: str) -> tuple[list[str], str]:
    """Return the controllers in a spawner's arguments, and their namespace."""
    names: list[str] = []
    words_left = iter(words)
    for word in words_left:
        option, equals, value = word.partition("=")
        if option in _WITH_VALUE and not equals:
            value = next(words_left, "")
        if option in ("--namespace", "-n"):
            namespace = _joined("", f"/{value.strip('/')}")
        elif not word.startswith("-") and "$(" not in word:
            names += [part.rpartition("/")[2] for part in word.split() if part not in ("spawn", "load", "start")]
    return names, namespace


def _parameter(launch: _Launch, element: Element) -> None:
    name = launch.text(element, "name")
    source = launch.text(element, "command") + launch.text(element, "textfile") + launch.text(element, "value")
    if name.rpartition("/")[2] != DESCRIPTION and re.search(r"\.(urdf|xacro)\b|xacro", source):
        _renamed(launch, element, name)


def _renamed(launch: _Launch, element: Element, name: str) -> None:
    text = f"the description is called {name!r}; the controllers, Gazebo and rviz use {DESCRIPTION!r}"
    launch.add(element, Severity.ERROR, text, f"call it {DESCRIPTION!r}")


def _transmissions(launch: _Launch) -> Iterator[Finding]:
    """Find joints of spawned ROS 1 controllers that have no <transmission> and so no interface."""
    description, robot = launch.robot.description, launch.robot
    if description is None or not launch.spawns or any(not tag.transmissions for tag in description.hardware):
        return
    joints = {transmission.joint for tag in description.hardware for transmission in tag.transmissions}
    for name in robot.launch_namespaces:
        controller = robot.configured.get(name)
        for joint in controller.joints if controller is not None and not controller.is_broadcaster else ():
            if joint in description.joints and joint not in joints:
                text = f"joint {joint!r} has no <transmission>, so {name} finds no interface of the joint"
                fix = "add a <transmission> with a SimpleTransmission, the joint and the actuator"
                yield Finding(description.path, description.joints[joint].place.line, Severity.ERROR, text, fix)
