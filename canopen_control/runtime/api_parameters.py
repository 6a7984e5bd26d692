"""The API's methods about parameters: of controllers, and of the controller manager, as ROS 2 shows both."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.controllers.declared import checked, declared_by
from canopen_control.controllers.spawned import Spawned
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.parameters import MANAGER, GetParameters, ParameterReading, SetParameters, told

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.rpc.messages.robot import RobotHello, RobotPush
    from canopen_control.rpc.server import Call, Server
    from canopen_control.runtime.core import RobotCore

__all__ = ["ParameterMethods"]


class ParameterMethods:
    """Answers them on a server; what spawners set is added to the controllers of the robot's file."""

    def __init__(self, robot: RobotCore, server: Server[RobotHello, RobotPush]) -> None:
        self._robot, self._spawned = robot, Spawned(robot.setup.controllers)
        server.answers(GetParameters, self._get)
        server.answers(SetParameters, self._set)

    def _get(self, call: Call[GetParameters]) -> None:
        name = call.request.controller
        call.reply(self._of_manager() if name == MANAGER else self._robot.manager.parameters(name))

    def _set(self, call: Call[SetParameters]) -> None:
        name, wanted = call.request.controller, call.request.values
        if name != MANAGER:
            self._robot.manager.set_parameters(name, wanted)
        else:
            own = {each.name for each in declared_by(self._robot.setup.controllers.manager)}
            foreign = [each for each in wanted if each.name in own or "." not in each.name]
            checked(MANAGER, self._of_manager(), foreign)  # read-only, all of them, or not declared
            self._spawned.set(wanted)
        call.reply(Done())

    def _of_manager(self) -> tuple[ParameterReading, ...]:
        own = declared_by(self._robot.setup.controllers.manager)
        return tuple(sorted((*own, *self._of_controllers()), key=lambda each: each.name))

    def _of_controllers(self) -> Iterator[ParameterReading]:
        """Yield what the manager's block says of each controller, or a spawner has set."""
        for name, config in self._robot.setup.controllers.controllers.items():
            yield ParameterReading(name=f"{name}.type", kind="string", value=config.type)
            for key, texts in (("fallback_controllers", config.fallbacks), ("node_options_args", config.node_options)):
                if texts:
                    yield ParameterReading(name=f"{name}.{key}", kind="string_array", value=told(texts))
        for name, given in self._spawned.given.items():
            if given.params_file:
                value = told(given.params_file)
                yield ParameterReading(name=f"{name}.params_file", kind="string_array", value=value)
