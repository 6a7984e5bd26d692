"""Tuning run started from a page: excites a drive, stores results, sets gains. No toolkit; on threads.

A run is a command source like any other. It ends with the page that started it: the page has to confirm repeatedly that
it is open, and `GONE_S` without that ends the run, as a limit, a fault, STOP and the button do; the drive is stopped
and disabled then, and there is no result.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.commissioning.driven_axis import drive_of_robot, takes_targets
from canopen_control.commissioning.jog_motion import JogKind, JogLimits, JogScale, parse_quantity
from canopen_control.commissioning.scope_capture import NamedShot, Shot
from canopen_control.commissioning.tune_gains import GainPlace, applied, reverted
from canopen_control.commissioning.tune_report import bode_of, identified, proposed, report
from canopen_control.commissioning.tune_run import TuneRequest, TuneRun, TuneTest, torque_index_of
from canopen_control.errors import ConfigError, DriveError
from canopen_control.rpc.messages.robot import PublishEvent

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.client import RobotClient
    from canopen_control.commissioning.frequency_response import Bode
    from canopen_control.commissioning.jobs import JobRun
    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.commissioning.tune_gains import CascadeGains
    from canopen_control.commissioning.tune_run import TuneRecord
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.rpc.messages.state import ControllerReading


GONE_S: Final = 1.0
SCALE: Final = JogScale(math.tau, told=True, of_joint=True)  # a robot's joints are in rad
_DECELERATION: Final = 20.0  # rad/s^2
_HUNDREDTHS: Final = 100


@dataclass(frozen=True, slots=True)
class TuneForm:
    """Form of a tuning run: rad/s, travel per direction in rad, torque and current in per mille, crossover in Hz.

    `axis` is that of the drive, of one with several.
    """

    test: TuneTest
    period: float
    seconds: float
    speed: float = 3.0
    torque: float = 150.0
    signal: str = "chirp"
    crossover: float = 20.0
    margin: float = 60.0
    most_speed: float = math.tau
    most_travel: float = 10.0 * math.tau
    most_current: float = 1000.0
    axis: int = 0

    @property
    def request(self) -> TuneRequest:
        """Request of the run; ConfigError for an invalid speed."""
        return TuneRequest(
            test=self.test,
            seconds=self.seconds,
            period=self.period,
            speed=parse_quantity(f"{self.speed}rad/s", "velocity") if self.test is TuneTest.STEP else None,
            torque=self.torque,
            signal=self.signal,
            crossover=self.crossover * math.tau,
            margin=math.radians(self.margin),
        )

    @property
    def limits(self) -> JogLimits:
        """Limits of the run."""
        return JogLimits(self.most_speed, self.most_travel, self.most_current)

    def check(self) -> None:
        """Raise ConfigError for values beyond the limits before the drive moves."""
        if self.test is TuneTest.STEP and not self.speed:
            raise ConfigError("a step to 0 moves nothing")
        self.request.check(self.limits, SCALE)


def confirmed_words(wish: TuneForm) -> list[str]:
    """Return the sentence to confirm before the drive moves."""
    limits = wish.limits
    return [
        wish.request.words(SCALE),
        f"within {SCALE.velocity_words(limits.speed)}, {SCALE.position_words(limits.travel)} each way, "
        f"{limits.current / 10:g} % of the rated current",
    ]


@dataclass(slots=True)
class TuneFound:
    """Results of the last run: curves, frequency response, gains; written by its thread."""

    wish: TuneForm
    curves: NamedShot | None = None
    bode: Bode | None = None
    gains: CascadeGains | None = None
    lines: list[str] = field(default_factory=list)


def refusal(controllers: Sequence[ControllerReading], place: NodePlace, axis: int, robot: str) -> str:
    """Return the reason why `drive_of_robot` would refuse a run of this axis, "" if it would accept it."""
    if not axis < len(place.joints):
        return f"{place.name} moves no joint of {robot}: there is nothing to tune."
    joint = place.joints[axis]
    if any(takes_targets(controller, joint) for controller in controllers):
        return ""
    users = [
        controller.name
        for controller in controllers
        if controller.active and joint in controller.joints and not controller.is_broadcaster
    ]
    if not users:
        return f"No active controller takes a target for {joint}, and a run needs one."
    return (
        f"{users[0]} commands {joint}, and two must not move it. End the robot, then tune the drive alone: "
        f"canopen-control shutdown --name {robot}, then canopen-control tune {place.node_id} --can CHANNEL --step 3"
    )


class PagePresence:
    """Time of the last sign of life of a page; `clock` in s."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._seen = clock, clock()

    def here(self) -> None:
        """Register the page as present."""
        self._seen = self._clock()

    def check(self) -> None:
        """Raise DriveError if the page was closed."""
        if self._clock() - self._seen > GONE_S:
            raise DriveError("the page that began it is gone: stopped and disabled")


def tune(
    session: NodeSession,
    work: JobRun,
    client: RobotClient,
    result: TuneFound,
    presence: PagePresence,
    run: Callable[..., TuneRun] = TuneRun,
) -> str:
    """Excite an axis of a node within its limits and store the results; return the final sentence."""
    wish, request = result.wish, result.wish.request
    wish.check()
    mode = "PV" if request.kind is JogKind.VELOCITY else "TQ"
    drive = drive_of_robot(client, session.name or str(session.node_id), wish.axis, mode)
    excitation = request.excitation(SCALE)

    client.ask(PublishEvent(kind="tune", text=f"page: {request.words(SCALE)} of {drive.joint}"))

    def told(seconds: float) -> None:
        presence.check()
        work.at(round(seconds * _HUNDREDTHS), round(excitation.seconds * _HUNDREDTHS))

    record = run(
        drive,
        request.kind,
        excitation,
        wish.limits,
        deceleration=_DECELERATION,
        effort_unit=None,
        torque_index=torque_index_of(wish.axis),
        told=told,
    ).run()
    result.curves = curves_of(record, request)
    result.lines = report(record, request, SCALE, None)
    if request.test is TuneTest.BODE:
        result.bode = bode_of(record, request)
    if request.test is TuneTest.IDENTIFY:
        try:
            result.gains = proposed(identified(record), request)
        except ConfigError:
            result.gains = None  # the reason is in the lines
    lost = f"; {record.lost} of {record.lost + len(record.samples)} cycles were lost" if record.lost else ""
    return f"{session.name}: {request.test.value} done, stopped and disabled{lost}"


def curves_of(record: TuneRecord, request: TuneRequest) -> NamedShot:
    """Return a record as a capture, over the seconds since its first sample."""
    unit = "rad/s" if request.kind is JogKind.VELOCITY else "1/1000 of the rated torque"
    rows = tuple(
        (record.seconds(sample), (sample.command, sample.velocity, sample.position, sample.effort))
        for sample in record.samples
    )
    has_effort = any(sample.effort is not None for sample in record.samples)
    names, units = ("command", "velocity", "position", "torque"), (unit, "rad/s", "rad", "1/1000 of the rated torque")
    return NamedShot(Shot(rows), names[: 3 + has_effort], units[: 3 + has_effort], request.test.value)


def apply_gains(
    session: NodeSession, work: JobRun, gains: CascadeGains, counts: float, *, axis: int = 0, stores: bool
) -> str:
    """Set proposed gains of an axis and verify them; `counts` are the user units of 0x6064 per revolution."""
    work.lines += applied(session, gains, counts / math.tau, GainPlace(axis, stores=stores))
    return f"{session.name}: gains set and proven; Revert takes them back"


def revert(session: NodeSession, work: JobRun, *, axis: int = 0, stores: bool) -> str:
    """Restore the gains of an axis from before the first change."""
    work.lines += reverted(session, GainPlace(axis, stores=stores))
    return f"{session.name}: gains are those from before"
