"""Plays the scenarios of the trajectories' vectors: a controller on interfaces, compared step by step with upstream."""

from __future__ import annotations

import math
from typing import Any

from support.control import same
from support.trajectories import QUANTITIES, close, message

from canopen_control.controllers.base import ControllerState
from canopen_control.controllers.params import Params
from canopen_control.controllers.trajectory.controller import JointTrajectoryController
from canopen_control.controllers.trajectory.goal import TrajectoryGoal
from canopen_control.controllers.trajectory.params import GoalTolerances, JointTolerance, read_params
from canopen_control.controllers.trajectory.point import Point
from canopen_control.errors import ControlError, RobotConfigError
from canopen_control.hardware.interfaces import CommandInterface, StateInterface
from canopen_control.urdf.joint_element import Joint, UrdfLimits

OURS = {"allowed_start_tolerance": 0.0}
"""What upstream does not judge."""


def goal_of(values: dict[str, Any]) -> TrajectoryGoal:
    def tolerances(key: str) -> tuple[JointTolerance, ...]:
        fields = ("position", "velocity", "acceleration")
        return tuple(
            JointTolerance(*(value.get(name, 0.0) for name in fields), value["name"]) for value in values.get(key, ())
        )

    time = values.get("goal_time_tolerance_ns", 0) / 1e9
    return TrajectoryGoal(
        message(values["trajectory"]), GoalTolerances(tolerances("path_tolerance"), tolerances("goal_tolerance"), time)
    )


def joint(name: str, values: dict[str, Any]) -> Joint:
    velocity = values.get("velocity")
    return Joint(name, values["type"], "", "", limits=UrdfLimits(velocity=math.inf if velocity is None else velocity))


class Player:
    """A controller that is configured; `play` does one step and returns what is not as expected."""

    def __init__(self, case: dict[str, Any]) -> None:
        inputs = case["in"]
        self.rate = inputs["update_rate"]
        self.controller = controller = JointTrajectoryController("arm")
        controller.cycle_rate = self.rate
        controller.description = {name: joint(name, text) for name, text in inputs["urdf"].items()}
        self.goals: dict[str, TrajectoryGoal] = {}
        self.collected: dict[str, dict[str, Any]] = {}
        try:
            controller.on_configure(Params.of({**inputs["params"], **OURS}))
        except RobotConfigError:
            self.configured = False
            return
        self.configured = True
        values = inputs.get("state0", {})
        before = inputs.get("command0", {})
        self.commands = [
            CommandInterface(*name.rsplit("/", 1), before.get(name, math.nan))
            for name in controller.command_interface_names()
        ]
        self.states = [
            StateInterface(*name.rsplit("/", 1), values.get(name, math.nan))
            for name in controller.state_interface_names()
        ]
        self.first_change: int | None = None

    def play(self, step: list[Any], expect: dict[str, Any]) -> dict[str, Any]:
        verb, *values = step
        self.answer: Any = None
        getattr(self, f"_{verb}")(*values)
        return self._differences(expect)

    def _activate(self) -> None:
        self.controller.on_activate(self.commands, self.states, 0)
        self.controller.state = ControllerState.ACTIVE

    def _deactivate(self) -> None:
        self.controller.on_deactivate(0)
        self.controller.state = ControllerState.INACTIVE

    def _state(self, values: dict[str, float]) -> None:
        for state in self.states:
            state.value = values.get(state.name, state.value)

    def _update(self, now: int, period: int) -> None:
        self.controller.update(now, period / 1e9)

    def _run(self, begin: int, period: int, count: int, tracking: str) -> None:
        before, self.first_change = self._mode(), None
        for index in range(count):
            if tracking == "perfect":
                known = {command.name: command.value for command in self.commands if math.isfinite(command.value)}
                self._state(known)
            self.controller.update(begin + index * period, period / 1e9)
            if self.first_change is None and self._mode() != before:
                self.first_change = index

    def _mode(self) -> tuple[bool, object]:
        return self.controller.holding, self.controller.goal

    def _topic(self, now: int, values: dict[str, Any]) -> None:
        try:
            self.controller.set_trajectory(message(values), now)
            self.answer = "ACCEPT"
        except ControlError:
            self.answer = "REJECT"

    def _goal(self, now: int, name: str, values: dict[str, Any]) -> None:
        goal = goal_of(values)
        running = next((key for key, other in self.goals.items() if other is self.controller.goal), None)
        try:
            self.controller.send_goal(goal, now)
        except ControlError:
            self.answer = "REJECT"
            return
        self.answer = "ACCEPT"
        self.goals[name], self.collected[name] = goal, {"state": "executing"}
        if running is not None:
            self._deliver(running)

    def _cancel(self, now: int, name: str) -> None:
        self.answer = "ACCEPT"
        self.controller.cancel(self.goals[name])
        if self.collected[name]["state"] == "executing":
            self.collected[name] = {"state": "canceling"}

    def _monitor(self) -> None:
        for name in self.goals:
            self._deliver(name)

    def _deliver(self, name: str) -> None:
        goal = self.goals[name]
        if goal.code is not None:
            self.collected[name] = {"state": goal.state.value, "error_code": int(goal.code)}

    def _scaling(self, factor: float) -> None:
        try:
            self.controller.set_speed_scaling(factor)
            self.answer = True
        except ControlError:
            self.answer = False

    def _query(self, now: int) -> None:
        self.answer = self.controller.query(now, Point())

    def _params(self, values: dict[str, Any]) -> None:
        self.controller.change(read_params(Params.of({**values, **OURS}), "arm"))

    def _differences(self, expect: dict[str, Any]) -> dict[str, Any]:
        controller = self.controller
        active = next((name for name, goal in self.goals.items() if goal is controller.goal), None)
        result = {
            "holding": controller.holding,
            "active_goal": active,
            "pending_goal": active is not None,
            "response": self.answer,
            "accepted": self.answer,
            "success": self.answer,
            "factor": controller.speed.factor,
            "goals": self.collected,
            "first_change_cycle": self.first_change,
        }
        wrong = {key: (result[key], expect[key]) for key in result.keys() & expect.keys() if result[key] != expect[key]}
        for name, value in expect.get("command", {}).items():
            command = next(candidate for candidate in self.commands if candidate.name == name)
            if not (same(command.value, value) or abs(command.value - value) <= 1e-9 * max(1.0, abs(value))):
                wrong[name] = (command.value, value)
        if "active_tolerances" in expect:
            wrong |= self._tolerances(expect["active_tolerances"])
        return wrong | self._state_message(expect.get("controller_state", {}))

    def _tolerances(self, expect: dict[str, Any]) -> dict[str, Any]:
        kept = self.controller.tolerances
        wrong = {}
        for key in ("path", "goal"):
            result = [[point.position, point.velocity, point.acceleration] for point in getattr(kept, key)]
            if not all(close(a, b) for a, b in zip(result, expect[key], strict=True)):
                wrong[key] = (result, expect[key])
        return wrong if same(kept.goal_time, expect["goal_time"]) else {**wrong, "goal_time": kept.goal_time}

    def _state_message(self, expect: dict[str, Any]) -> dict[str, Any]:
        controller, wrong = self.controller, {}
        points = {"reference": controller.desired, "feedback": controller.actual, "error": controller.error}
        for name in points.keys() & expect.keys():
            for key in QUANTITIES:
                if key in expect[name] and not close(getattr(points[name], key), expect[name][key]):
                    wrong[f"{name}.{key}"] = (getattr(points[name], key), expect[name][key])
            if points[name].time != expect[name].get("t_ns", points[name].time):
                wrong[f"{name}.t_ns"] = (points[name].time, expect[name]["t_ns"])
        if not same(controller.speed.factor, expect.get("speed_scaling_factor", controller.speed.factor)):
            wrong["speed_scaling_factor"] = (controller.speed.factor, expect["speed_scaling_factor"])
        return wrong
