"""Requests for a robot that is simulated by a ros2_control plugin without drives.

The simulated time advances with the cycles of the robot. A robot with drives on a bus refuses all these requests, since
real and virtual drives cannot be paused; use the `drive` socket of a virtual drive to request disturbances. A
refusal has a reason and changes nothing.
"""

from __future__ import annotations

from typing import Annotated, Final

import msgspec

from canopen_control.rpc.messages.declare import Effect, Request
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot, SetGrip

MAX_STEPS: Final = 1_000_000


class Simulation(msgspec.Struct, frozen=True, kw_only=True):
    """State of a simulation; `seconds` is the simulated time, `period` the cycle time in s.

    If `changeable`, the simulation has physics, and payloads, pushes, blocked joints and another friction can be
    requested.
    """

    seconds: float
    paused: bool
    period: float
    changeable: bool = False


class LaserScanReading(msgspec.Struct, frozen=True, kw_only=True):
    """Scan of a simulated lidar, in rad and m as in sensor_msgs/LaserScan; -1 means no echo.

    `seconds` is the simulated time, `topic` the ROS topic, `scan_time` the period in s.
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
    """Return the state of the simulation."""


class GetLaserScans(Request[tuple[LaserScanReading, ...]], frozen=True):
    """Return the current scans of the robot's simulated lidars; empty without lidars or physics."""


class PauseSimulation(Request[Simulation], frozen=True, kw_only=True):
    """Pause or resume the simulation.

    No command times out while the simulation is paused. When it is resumed, previous commands are dropped: nothing
    moves before a new command.
    """

    paused: bool


class StepSimulation(Request[Simulation], frozen=True, kw_only=True):
    """Execute `steps` cycles of a paused simulation with the active commands, then answer."""

    steps: Annotated[int, msgspec.Meta(ge=1, le=MAX_STEPS)]


class ResetSimulation(Request[Simulation], frozen=True, kw_only=True):
    """Reset the simulated robot to its initial state, or to a key frame of the MJCF, at standstill.

    Odometry restarts and all commands are dropped; active controllers are restarted, and no other controller is
    activated. The simulated time continues, because a time that jumps back breaks subscribers.
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
