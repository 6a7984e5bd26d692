"""Controllers that a spawner defines by parameters of the manager: type, parameter files and fallbacks.

Rules (spawner of ros2_control, Jazzy): before it loads a controller, the spawner sets `NAME.params_file` (a file or a
list of files), `NAME.type`, `NAME.fallback_controllers` and, for --controller-ros-args, `NAME.node_options_args`.
These files take precedence over the robot's own file, and a later file over earlier files. A relative path begins at
the folder of the robot's ros2_controllers.yaml; the bridge makes a path in the spawner's own folder absolute.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.controllers_file import ControllerConfig, from_file, node_options_mistake
from canopen_control.controllers.params import Params, flattened
from canopen_control.errors import ControlError, RobotConfigError, nearest
from canopen_control.rpc.messages.parameters import MANAGER
from canopen_control.yamlfile.node import Node, Problems

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.controllers_file import ControllersFile
    from canopen_control.rpc.messages.parameters import ParameterValue


_TEXTS: Final = ("string", "string_array")
_KEYS: Final = {"type": ("string",), "params_file": _TEXTS, "fallback_controllers": _TEXTS, "node_options_args": _TEXTS}


@dataclasses.dataclass(frozen=True)
class SpawnerArguments:
    """Parameters that a spawner has set for one controller."""

    type: str = ""
    params_file: tuple[str, ...] = ()
    fallback_controllers: tuple[str, ...] = ()
    node_options_args: tuple[str, ...] = ()

    def changed(self, key: str, texts: tuple[str, ...]) -> SpawnerArguments:
        """Return a copy with the values `texts` for the setting `key`, one of `_KEYS`."""
        if key == "type":
            return dataclasses.replace(self, type=texts[0])
        if key == "params_file":
            return dataclasses.replace(self, params_file=texts)
        if key == "node_options_args":
            return dataclasses.replace(self, node_options_args=texts)
        return dataclasses.replace(self, fallback_controllers=texts)


class SpawnedControllers:
    """Parameters that spawners have set, for each controller.

    The resulting controllers are added to `control`, the contents of the robot's file.
    """

    def __init__(self, control: ControllersFile) -> None:
        self._control = control
        self._of_file = dict(control.controllers)
        self.arguments: dict[str, SpawnerArguments] = {}

    def set(self, parameters: Sequence[ParameterValue]) -> None:
        """Set parameters named `CONTROLLER.KEY`; if one is invalid, set none and raise ControlError or ConfigError."""
        arguments_by_name = dict(self.arguments)
        for parameter in parameters:
            name, _, key = parameter.name.rpartition(".")
            arguments_by_name[name] = arguments_by_name.get(name, SpawnerArguments()).changed(
                key, _spawner_texts(parameter, key)
            )
        changed = {
            name: self._config(name, arguments)
            for name, arguments in arguments_by_name.items()
            if arguments != self.arguments.get(name)
        }
        self.arguments = arguments_by_name
        self._control.controllers.update(changed)

    def _config(self, name: str, arguments: SpawnerArguments) -> ControllerConfig:
        before = self._of_file.get(name) or ControllerConfig(name, "", Params.of({}, name))
        problems = Problems(self._control.path or f"params_file of {name}", strict=False)
        place, values = Node("scalar", 0, 0, f"{name}.params_file", problems), before.params.flat
        for path in arguments.params_file:
            values = flattened(from_file(place, path, name)).merged_over(values)
        problems.raise_if_any(RobotConfigError)
        for fallback in arguments.fallback_controllers:
            controllers = self._control.controllers
            if fallback not in controllers or fallback == name:
                raise ControlError(
                    f"fallback_controllers of {name}: no controller {fallback!r}{nearest(fallback, controllers)}"
                )
        if (mistake := node_options_mistake(arguments.node_options_args)) is not None:
            raise ControlError(f"node_options_args of {name}: {mistake}")
        kind = values.get("type")
        return dataclasses.replace(
            before,
            type=arguments.type or (str(kind.value) if kind is not None else before.type),
            params=Params(values, name),
            fallbacks=arguments.fallback_controllers or before.fallbacks,
            node_options=arguments.node_options_args or before.node_options,
        )


def _spawner_texts(parameter: ParameterValue, key: str) -> tuple[str, ...]:
    """Return a parameter's value as texts; raise ControlError for an unknown key or a wrong type."""
    if key not in _KEYS:
        keys = ", ".join(_KEYS)
        raise ControlError(
            f"{MANAGER}: parameter '{parameter.name}' cannot be set; a controller has the parameters: {keys}"
        )
    if parameter.kind not in _KEYS[key]:
        raise ControlError(
            f"{MANAGER}: wrong parameter type, parameter '{parameter.name}' is of type {_KEYS[key][-1]}, "
            f"setting it to {parameter.kind} is not allowed"
        )
    return tuple(map(str, parameter.value)) if isinstance(parameter.value, list) else (str(parameter.value),)
