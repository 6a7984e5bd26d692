"""Controllers as a spawner gives them: type, files of parameters and fallbacks, set as parameters of the manager.

The law of the file (spawner of ros2_control, Jazzy): before it loads a controller it sets `NAME.params_file`, a file or
a list of them, `NAME.type`, `NAME.fallback_controllers` and, for --controller-ros-args, `NAME.node_options_args`. What
the files say wins over the robot's own file, the last file over those before it. A relative path begins at the folder
of the robot's ros2_controllers.yaml; one that the spawner has in its own folder comes as a whole path from the bridge.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.controllers_file import ControllerConfig, from_file, node_options_mistake
from canopen_control.controllers.params import Params, flattened
from canopen_control.errors import ControlError, RobotConfigError, nearest
from canopen_control.rpc.messages.parameters import MANAGER
from canopen_control.yamlfile.node import Node
from canopen_control.yamlfile.problems import Problems

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.controllers_file import ControllersFile
    from canopen_control.rpc.messages.parameters import ParameterValue

__all__ = ["Given", "Spawned"]

_TEXTS: Final = ("string", "string_array")
_KEYS: Final = {"type": ("string",), "params_file": _TEXTS, "fallback_controllers": _TEXTS, "node_options_args": _TEXTS}


@dataclasses.dataclass(frozen=True)
class Given:
    """What has been set of one controller."""

    type: str = ""
    params_file: tuple[str, ...] = ()
    fallback_controllers: tuple[str, ...] = ()
    node_options_args: tuple[str, ...] = ()

    def changed(self, key: str, texts: tuple[str, ...]) -> Given:
        """Return this with one of `_KEYS` set."""
        if key == "type":
            return dataclasses.replace(self, type=texts[0])
        if key == "params_file":
            return dataclasses.replace(self, params_file=texts)
        if key == "node_options_args":
            return dataclasses.replace(self, node_options_args=texts)
        return dataclasses.replace(self, fallback_controllers=texts)


class Spawned:
    """What spawners have set; `control` are the controllers of the robot's file, to which they are added."""

    def __init__(self, control: ControllersFile) -> None:
        self._control = control
        self._of_file = dict(control.controllers)
        self.given: dict[str, Given] = {}

    def set(self, wanted: Sequence[ParameterValue]) -> None:
        """Take parameters whose names are `CONTROLLER.KEY`: all, or none and a ControlError or RobotConfigError."""
        given = dict(self.given)
        for each in wanted:
            name, _, key = each.name.rpartition(".")
            given[name] = given.get(name, Given()).changed(key, _texts(each, key))
        changed = {name: self._config(name, each) for name, each in given.items() if each != self.given.get(name)}
        self.given = given
        self._control.controllers.update(changed)

    def _config(self, name: str, given: Given) -> ControllerConfig:
        before = self._of_file.get(name) or ControllerConfig(name, "", Params.of({}, name))
        problems = Problems(self._control.path or f"params_file of {name}", strict=False)
        place, values = Node("scalar", 0, 0, f"{name}.params_file", problems), before.params.flat
        for path in given.params_file:
            values = flattened(from_file(place, path, name)).over(values)
        problems.raise_if_any(RobotConfigError)
        for fallback in given.fallback_controllers:
            known = self._control.controllers
            if fallback not in known or fallback == name:
                raise ControlError(
                    f"fallback_controllers of {name}: no controller {fallback!r}{nearest(fallback, known)}"
                )
        if (mistake := node_options_mistake(given.node_options_args)) is not None:
            raise ControlError(f"node_options_args of {name}: {mistake}")
        kind = values.get("type")
        return dataclasses.replace(
            before,
            type=given.type or (str(kind.value) if kind is not None else before.type),
            params=Params(values, name),
            fallbacks=given.fallback_controllers or before.fallbacks,
            node_options=given.node_options_args or before.node_options,
        )


def _texts(wanted: ParameterValue, key: str) -> tuple[str, ...]:
    """Return what a parameter is set to; ControlError for what a controller has not, or of another type."""
    if key not in _KEYS:
        there = ", ".join(_KEYS)
        raise ControlError(f"{MANAGER}: parameter '{wanted.name}' cannot be set; of a controller there are: {there}")
    if wanted.kind not in _KEYS[key]:
        raise ControlError(
            f"{MANAGER}: wrong parameter type, parameter '{wanted.name}' is of type {_KEYS[key][-1]}, "
            f"setting it to {wanted.kind} is not allowed"
        )
    return tuple(map(str, wanted.value)) if isinstance(wanted.value, list) else (str(wanted.value),)
