"""Tuning job of a page: plan for the user's confirmation, run within limits, results, and gains.

A run is a command source like any other. A run that a page started ends with the page: the page has to confirm
repeatedly that it is open. If no confirmation arrives for `GONE_S`, or on a limit, a fault, STOP or the user's request
to end, the drive is stopped and disabled, and there is no result.
"""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import TORQUE_ACTUAL, axis_index
from canopen_control.commissioning.driven_axis import drive_of_robot, takes_targets, users_of
from canopen_control.commissioning.jog_motion import JogKind, limits_of
from canopen_control.commissioning.quantity import JogScale
from canopen_control.commissioning.scope_capture import NamedShot, Shot
from canopen_control.commissioning.tune_gains import GainPlace, applied, reverted
from canopen_control.commissioning.tune_report import bode_of, identified, proposed, report
from canopen_control.commissioning.tune_run import PEAK_S, TuneRequest, TuneRun, TuneTest
from canopen_control.errors import ConfigError, DriveError
from canopen_control.rpc.messages.robot import PublishEvent

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.client import RobotClient
    from canopen_control.commissioning.driven_axis import JogDrive
    from canopen_control.commissioning.frequency_response import Bode
    from canopen_control.commissioning.jobs import JobRun, TuneOptions
    from canopen_control.commissioning.jog_motion import JogLimits
    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.commissioning.quantity import Quantity
    from canopen_control.commissioning.tune_gains import CascadeGains
    from canopen_control.commissioning.tune_run import TuneRecord
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.rpc.messages.state import ControllerReading


GONE_S: Final = 1.0
SCALE: Final = JogScale(math.tau, is_known=True, of_joint=True)  # a robot's joints are in rad
_DECELERATION: Final = 20.0  # assumed deceleration of a stop in rad/s^2


@dataclass(frozen=True, slots=True)
class TunePlan:
    """Plan of a tuning run within limits, which the user confirms before the drive moves."""

    request: TuneRequest
    limits: JogLimits
    axis: int = 0

    @classmethod
    def of(cls, request: TuneRequest, options: TuneOptions, scale: JogScale) -> TunePlan:
        """Return the plan of a request; raise ConfigError if the request exceeds the limits."""
        plan = cls(request, limits_of(options, scale), options.axis)
        request.check(plan.limits, scale)
        return plan

    def lines(self, scale: JogScale) -> list[str]:
        limits = self.limits
        return [
            f"excitation: {self.request.words(scale)}",
            f"limits: {scale.velocity_words(limits.speed)}, {scale.position_words(limits.travel)} in each direction,",
            f"        current {limits.current / 10:g} % of the rated current, exceeded for {PEAK_S:g} s at most",
        ]

    @property
    def mode(self) -> str:
        """Mode of operation that the run requests from a running robot."""
        return "PV" if self.request.kind is JogKind.VELOCITY else "TQ"


def request_of(
    test: TuneTest, options: TuneOptions, period: float, *, speed: Quantity | None, torque: float, signal: str
) -> TuneRequest:
    """Return the request of a test with samples every `period` s; raise ConfigError for a step without a speed."""
    if test is TuneTest.STEP and (speed is None or not speed.value):
        raise ConfigError(f"a step to {speed or 0} causes no motion; give a velocity other than 0")
    return TuneRequest(
        test=test,
        speed=speed,
        torque=torque,
        signal=signal,
        seconds=options.seconds or test.seconds,
        period=period,
        crossover=options.crossover * math.tau,
        margin=math.radians(options.phase_margin),
        loop_delay=options.loop_delay / 1e3,
    )


def excite(
    drive: JogDrive,
    plan: TunePlan,
    scale: JogScale,
    effort_unit: float | None = None,
    progress: Callable[[float], object] = lambda _seconds: None,
) -> TuneRun:
    """Return a `TuneRun` that executes a plan on a drive."""
    return TuneRun(
        drive,
        plan.request.kind,
        plan.request.excitation(scale),
        plan.limits,
        deceleration=_DECELERATION,
        effort_unit=effort_unit,
        torque_index=axis_index(TORQUE_ACTUAL, plan.axis),
        progress=progress,
    )


@dataclass(slots=True)
class TuneFound:
    """Results of the last run, written by the run's thread; None for results that the run does not have."""

    plan: TunePlan
    curves: NamedShot | None = None
    bode: Bode | None = None
    gains: CascadeGains | None = None
    lines: list[str] = field(default_factory=list)


def refusal(controllers: Sequence[ControllerReading], place: NodePlace, axis: int, robot: str) -> str:
    """Return why `drive_of_robot` would refuse a run of this axis, or ""."""
    if not axis < len(place.joints):
        return f"{place.name} moves no joint of {robot}, so nothing can be tuned."
    joint = place.joints[axis]
    if any(takes_targets(controller, joint) for controller in controllers):
        return ""
    users = users_of(controllers, joint)
    if not users:
        return f"No active controller accepts targets for {joint}, which a run requires."
    return (
        f"{users[0]} commands {joint}, and only one client may move it. End the robot, then tune the drive alone: "
        f"canopen-control shutdown --name {robot}, then canopen-control tune {place.node_id} --can CHANNEL --step 3"
    )


class PagePresence:
    """Time since a page last confirmed that it is open; `clock` returns seconds."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._seen = clock, clock()

    def here(self) -> None:
        """Confirm that the page is open."""
        self._seen = self._clock()

    def check(self) -> None:
        """Raise DriveError if the page has not confirmed for `GONE_S` that it is open."""
        if self._clock() - self._seen > GONE_S:
            raise DriveError("the page that started the run was closed: stopped and disabled")


def tune(session: NodeSession, run: JobRun, client: RobotClient, result: TuneFound, presence: PagePresence) -> str:
    """Excite an axis within limits and store the results in `result`; return the final sentence."""
    plan, request = result.plan, result.plan.request
    request.check(plan.limits, SCALE)
    drive = drive_of_robot(client, session.name or str(session.node_id), plan.axis, plan.mode)
    seconds = request.excitation(SCALE).seconds
    client.ask(PublishEvent(kind="tune", text=f"page: {request.words(SCALE)} of {drive.joint}"))

    def report_progress(elapsed: float) -> None:
        presence.check()
        run.at(round(elapsed * 100), round(seconds * 100))  # in 10 ms, since progress is a whole number

    record = excite(drive, plan, SCALE, progress=report_progress).run()
    result.curves = curves_of(record, request)
    result.lines = report(record, request, SCALE, None)
    if request.test is TuneTest.BODE:
        result.bode = bode_of(record, request)
    if request.test is TuneTest.IDENTIFY:
        with contextlib.suppress(ConfigError):  # the lines contain the reason
            result.gains = proposed(identified(record), request)
    lost = f"; {record.lost} of {record.lost + len(record.samples)} cycles were lost" if record.lost else ""
    return f"{session.name}: {request.test.value} done, stopped and disabled{lost}"


def curves_of(record: TuneRecord, request: TuneRequest) -> NamedShot:
    """Convert a record to a scope capture of command, velocity, position and, if known, torque."""
    unit = "rad/s" if request.kind is JogKind.VELOCITY else "1/1000 of the rated torque"
    rows = tuple(
        (record.seconds(sample), (sample.command, sample.velocity, sample.position, sample.effort))
        for sample in record.samples
    )
    has_effort = any(sample.effort is not None for sample in record.samples)
    names, units = ("command", "velocity", "position", "torque"), (unit, "rad/s", "rad", "1/1000 of the rated torque")
    return NamedShot(Shot(rows), names[: 3 + has_effort], units[: 3 + has_effort], request.test.value)


def apply_gains(
    session: NodeSession, run: JobRun, gains: CascadeGains, counts: float, *, axis: int = 0, stores: bool
) -> str:
    """Set the proposed gains of an axis and verify them; `counts` are user units of 0x6064 per revolution."""
    run.lines += applied(session, gains, counts / math.tau, GainPlace(axis, stores=stores))
    return f"{session.name}: gains set and verified; Revert restores the previous gains"


def revert(session: NodeSession, run: JobRun, *, axis: int = 0, stores: bool) -> str:
    """Restore the gains that an axis had before the first change."""
    run.lines += reverted(session, GainPlace(axis, stores=stores))
    return f"{session.name}: previous gains restored"
