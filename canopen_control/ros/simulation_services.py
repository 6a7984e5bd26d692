"""`~/set_pause`, `~/step_simulation` and `~/reset_world` of a simulated robot, as mujoco_ros2_control has them.

The law of the file: names and types are upstream's (mujoco_ros2_control_msgs), on the node that runs the controllers
there, `ros2_control_node`, and on the plugin's own, `mujoco_ros2_control_node`. A step is a cycle of the robot here,
which is what controllers and hardware do once; upstream it is one of the physics. They are there once the robot says
what time its simulation has: a real robot has none of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.ros.endpoint import Endpoint
from canopen_control.rpc.messages.simulation import MAX_STEPS, PauseSimulation, ResetSimulation, StepSimulation

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.ros.endpoint import Handler, Reply, Ros, RosMessage
    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.simulation import Simulation
    from canopen_control.rpc.messages.state import StateSample

__all__ = ["SimulationServices"]

_NODES: Final = ("ros2_control_node", "mujoco_ros2_control_node")
_SERVICES: Final[dict[str, tuple[str, Callable[[RosMessage], Request[Simulation]]]]] = {
    "set_pause": ("SetPause", lambda request: PauseSimulation(paused=request.paused)),
    "step_simulation": ("StepSimulation", lambda request: StepSimulation(steps=request.steps)),
    "reset_world": ("ResetWorld", lambda request: ResetSimulation(keyframe=request.keyframe)),
}
"""Service -> its type, and what the robot is asked."""


class SimulationServices(Endpoint):
    """The services, made with the first sample that carries a simulated time."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._services: list[object] = []

    def on_state(self, state: StateSample) -> None:
        """Serve them from the first simulated time on."""
        if self._services or state.sim_epoch is None:
            return
        for name, (kind, asking) in _SERVICES.items():
            service = f"mujoco_ros2_control_msgs/srv/{kind}"
            self._services += [self._ros.serve(service, f"{node}/{name}", self._handler(asking)) for node in _NODES]

    def _handler(self, asking: Callable[[RosMessage], Request[Simulation]]) -> Handler:
        def handler(request: RosMessage, response: RosMessage, reply: Reply) -> None:
            def answer(done: Simulation | None, error: str | None) -> None:
                response.success, response.message = error is None, error or _told(done)
                reply(response)

            if getattr(request, "steps", 1) not in range(1, MAX_STEPS + 1):
                answer(None, f"steps is {request.steps}; it is a number of cycles from 1 to {MAX_STEPS}")
            else:
                self._ros.ask(asking(request), answer)

        return handler

    def close(self) -> None:
        """Leave the graph."""
        for service in self._services:
            self._ros.unserve(service)


def _told(simulation: Simulation | None) -> str:
    if simulation is None:
        return ""
    how = "paused" if simulation.paused else "running"
    return f"{how} at {simulation.seconds:.6g} s; a step is a cycle of {1000.0 * simulation.period:g} ms"
