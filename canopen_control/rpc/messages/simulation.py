"""Requests about the simulation of a robot by a ros2_control plugin without drives.

Its time advances with the robot's cycles; real and virtual drives have a time of their own, so that a robot on a bus
refuses all of these; disturbances of its world are requests to its virtual drives (`drive`). A refusal has a reason
and changes nothing.
"""

from __future__ import annotations

from typing import Annotated, Final

import msgspec

from canopen_control.rpc.messages.declare import Effect, Request
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot, SetGrip

MAX_STEPS: Final = 1_000_000


class Simulation(msgspec.Struct, frozen=True, kw_only=True):
    """State of a simulation: `seconds` simulated, whether it is paused, the `period` of a cycle in s.

    In a `changeable` one, with physics, payloads, pushes, blocked joints and another friction can be requested.
    """

    seconds: float
    paused: bool
    period: float
    changeable: bool = False


class LaserScanReading(msgspec.Struct, frozen=True, kw_only=True):
    """Scan of a lidar `seconds` into the simulation: rad and m as in sensor_msgs/LaserScan; -1 for no echo.

    `topic` is where ROS gets it, `scan_time` in s how often.
    """

    name: str
    topic: str
    frame_id: str
    seconds: float
    angle_min: float
    angle_max: float
    angle_increment: float
    range_min: float
    range_max: float
    scan_time: float
    ranges: list[float]


class GetSimulation(Request[Simulation], frozen=True):
    """State of the simulation."""


class GetLaserScans(Request[tuple[LaserScanReading, ...]], frozen=True):
    """Return the present scans of the lidars of a robot in physics; empty without lidars."""


class PauseSimulation(Request[Simulation], frozen=True, kw_only=True):
    """Pause or resume the simulation.

    While it is paused no command runs out. Commands that are in force when it goes on are forgotten: nothing moves
    before a newer one.
    """

    paused: bool


class StepSimulation(Request[Simulation], frozen=True, kw_only=True):
    """Simulate a number of cycles of a paused simulation with the active commands; answered afterwards."""

    steps: Annotated[int, msgspec.Meta(ge=1, le=MAX_STEPS)]


class ResetSimulation(Request[Simulation], frozen=True, kw_only=True):
    """Reset the simulated robot to its start, or to a key frame of its MJCF, at standstill.

    Its odometry restarts and every command is forgotten; the active controllers are started again, no other one. The
    simulated time continues, since a time that goes back breaks subscribers.
    """

    keyframe: str = ""


SIMULATION_METHODS: Final = (
    ("simulation", Effect.READS, GetSimulation),
    ("laser_scans", Effect.READS, GetLaserScans),
    ("pause_simulation", Effect.CHANGES, PauseSimulation),
    ("step_simulation", Effect.CHANGES, StepSimulation),
    ("reset_simulation", Effect.CHANGES, ResetSimulation),
    ("payload", Effect.CHANGES, AddPayload),
    ("push", Effect.CHANGES, PushRobot),
    ("block", Effect.CHANGES, BlockJoint),
    ("grip", Effect.CHANGES, SetGrip),
)
