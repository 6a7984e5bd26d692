"""Stand-ins for `launch`, `launch_ros` and `ament_index_python` that record what a launch file makes."""

from __future__ import annotations

import importlib.util
import sys
import types
from pathlib import Path
from unittest.mock import patch

FOLDER = Path(__file__).parents[2] / "canopen_control/ros/share/launch"


class Configuration(str):
    """A launch argument's value, which is known when it is launched."""

    __slots__ = ()


class Action:
    def __init__(self, *positional, **named):
        self.positional, self.named = positional, named


class DeclareLaunchArgument(Action):
    pass


class ExecuteProcess(Action):
    pass


class Node(Action):
    pass


class If(Action):
    def holds(self, arguments):
        return arguments[self.positional[0]] == "true"


class Unless(If):
    def holds(self, arguments):
        return not super().holds(arguments)


class PackageNotFoundError(KeyError):
    pass


def _modules(packages):
    def get_package_prefix(package):
        if package not in packages:
            raise PackageNotFoundError(package)
        return "/opt/ros/jazzy"

    contents = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": DeclareLaunchArgument, "ExecuteProcess": ExecuteProcess},
        "launch.conditions": {"IfCondition": If, "UnlessCondition": Unless},
        "launch.substitutions": {"LaunchConfiguration": Configuration},
        "launch_ros": {},
        "launch_ros.actions": {"Node": Node},
        "ament_index_python": {},
        "ament_index_python.packages": {
            "PackageNotFoundError": PackageNotFoundError, "get_package_prefix": get_package_prefix,
        },
    }  # fmt: skip
    created = {}
    for name, attributes in contents.items():
        created[name] = types.ModuleType(name)
        created[name].__dict__.update(attributes)
    return created


def launched(name, packages=(), **arguments):
    """Return (commands, nodes) that a launch file starts with these arguments on a host with these packages."""
    with patch.dict(sys.modules, _modules(packages)):
        spec = importlib.util.spec_from_file_location("launch_file", FOLDER / f"{name}.launch.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        actions = module.generate_launch_description()
    declared = [action for action in actions if isinstance(action, DeclareLaunchArgument)]
    values = {argument.positional[0]: argument.named["default_value"] for argument in declared}
    assert set(arguments) <= set(values)
    values.update(arguments)
    started = [
        action for action in actions if "condition" not in action.named or action.named["condition"].holds(values)
    ]

    def text(word):
        if isinstance(word, list):  # list of substitutions, which launch joins
            return "".join(map(text, word))
        return values[word] if isinstance(word, Configuration) else word

    commands = [
        [text(word) for word in action.named["cmd"]] for action in started if isinstance(action, ExecuteProcess)
    ]
    return commands, [action.named["executable"] for action in started if isinstance(action, Node)]
