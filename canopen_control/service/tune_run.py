"""The loop of a tuning run: an excitation to commands, cycle by cycle, and what the drive showed to a record.

The law of this file is that of `jog_run`: each command dies with this connection, and every way out of `run` asks for
the stop and waits until the drive is disabled. Samples carry the number of their cycle, so what was lost is counted.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import TORQUE_ACTUAL, axis_index
from canopen_control.client import RobotClient
from canopen_control.errors import DriveError
from canopen_control.rpc.messages.robot import AxisRequest, ProcessData, Subscribe
from canopen_control.rpc.messages.state import StateSample
from canopen_control.service.driven_axis import (
    ENABLE_S,
    AxisCommand,
    DriveCurrent,
    axis_reading,
    choose_mode,
    ended_words,
    stop_drive,
)
from canopen_control.service.jog_motion import JogEnd, JogKind
from canopen_control.service.tune_motion import TuneMotion, TuneRecord, TuneSample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.rpc.messages.robot import RobotPush
    from canopen_control.service.driven_axis import JogDrive
    from canopen_control.service.excitation import Excitation
    from canopen_control.service.jog_motion import JogLimits

__all__ = ["TuneRun", "torque_index_of"]

_SOURCE: Final = "tune"
_REMEDIES: Final = {
    JogEnd.CURRENT: "; excite it less, or raise --max-current, if it is safe",
    JogEnd.SPEED: "; excite it less, or raise --max-speed, if it is safe",
    JogEnd.TRAVEL: "; make it shorter (--for), or raise --max-travel, if it is safe",
}
_WAIT_S: Final = 1.0  # for the first sample
_SILENCE_S: Final = 0.3  # without a sample, after which nothing is commanded any more


def _newest(client: RobotClient, timeout: float) -> Iterator[RobotPush]:
    """Yield what comes next within a time, and what is there behind it."""
    for message in client.messages(timeout):
        yield message
        break
    yield from client.messages(0)


def torque_index_of(axis: int) -> int:
    """Return the object that tells the torque of an axis: 0x6077, or that of a further one."""
    return axis_index(TORQUE_ACTUAL, axis)


class TuneRun:
    """One excitation of a drive; `run` returns the record, or raises DriveError with what ended it.

    `told` is called with the seconds that are over, again and again; what it raises ends the run, which stops first.
    `effort_unit` is how many per mille of the rated torque the unit of its effort is, None where nobody knows: then its
    torque is that of the object `torque_index`, if a TPDO carries it.
    """

    def __init__(
        self,
        drive: JogDrive,
        kind: JogKind,
        excitation: Excitation,
        limits: JogLimits,
        *,
        deceleration: float,
        effort_unit: float | None,
        told: Callable[[float], object] = lambda _seconds: None,
        torque_index: int = TORQUE_ACTUAL,
    ) -> None:
        self._drive, self._kind, self._excitation = drive, kind, excitation
        self._limits, self._deceleration, self._effort_unit = limits, deceleration, effort_unit
        self._current = DriveCurrent(drive)
        self._sender = AxisCommand(drive, kind.value, _SOURCE)
        self._sample: StateSample | None = None
        self._gone = self._told = False
        self._tell = told
        self._torque_index = torque_index
        self._torque: float | None = None

    def run(self) -> TuneRecord:
        """Enable, excite, stop and disable."""
        with RobotClient.connect(self._drive.robot) as client:
            try:
                motion, record = self._begin(client)
                self._move(client, motion, record)
            finally:
                stop_drive(client, self._drive, _SOURCE)
        if motion.ended is JogEnd.STATE:
            raise DriveError(f"{self._drive.joint}: {ended_words(self._sample, self._drive)}")
        if motion.ended is not JogEnd.OVER:
            raise DriveError(
                f"{motion.ended.value}: stopped and disabled; nothing is concluded of half a run"
                f"{_REMEDIES.get(motion.ended, '')}"
            )
        return record

    def leave(self) -> None:
        """End it at the next sample: it stops and is disabled, and nothing is concluded."""
        self._gone = True

    def _begin(self, client: RobotClient) -> tuple[TuneMotion, TuneRecord]:
        """Choose the mode, enable, and return the motion, which begins now."""
        node, joint = self._drive.node, self._drive.joint
        if self._drive.mode:
            choose_mode(
                client, AxisRequest(action="mode", node=node, joint=joint, mode=self._drive.mode, source=_SOURCE)
            )
        client.ask(Subscribe(state_rate=1000.0, pdos=self._effort_unit is None))  # every cycle
        period = self._first(client)
        client.ask(AxisRequest(action="enable", node=node, joint=joint, source=_SOURCE), ENABLE_S)
        for message in client.messages(0):  # of the time before: what has not changed since is not told again
            if isinstance(message, ProcessData):
                self._take_torque(message)
        now = time.monotonic_ns()
        motion = TuneMotion(self._kind, self._excitation, self._limits, now=now, deceleration=self._deceleration)
        return motion, TuneRecord(period)

    def _first(self, client: RobotClient) -> float:
        """Return the period of the cycle, which the first sample tells."""
        deadline = time.monotonic() + _WAIT_S
        while time.monotonic() < deadline:
            for message in client.messages(_WAIT_S):
                if isinstance(message, ProcessData):
                    self._take_torque(message)
                if isinstance(message, StateSample) and message.cycle.period_s:
                    return message.cycle.period_s
        raise DriveError(f"{self._drive.joint}: its robot tells nothing of its cycles")

    def _move(self, client: RobotClient, motion: TuneMotion, record: TuneRecord) -> None:
        heard = time.monotonic()
        while motion.ended is JogEnd.NONE:
            for message in _newest(client, record.period):
                if isinstance(message, StateSample):
                    heard = time.monotonic()
                    self._take(message, motion, record)
                elif isinstance(message, ProcessData):
                    self._take_torque(message)
            motion.tick(time.monotonic_ns())
            self._tell(motion.elapsed)
            if time.monotonic() - heard > _SILENCE_S:
                motion.end(JogEnd.STATE)
            if self._gone:
                motion.end(JogEnd.ASKED)
            self._command(client, motion)
        self._keep_torque(record)

    def _take_torque(self, data: ProcessData) -> None:
        """Take the torque that a TPDO carries: of the cycle whose sample came before it."""
        for mapped in data.nodes.get(self._drive.node, ()):
            if (mapped.index, mapped.subindex) == (self._torque_index, 0):
                self._torque = float(int.from_bytes(mapped.data, "little", signed=True))

    def _keep_torque(self, record: TuneRecord) -> None:
        if self._torque is not None and record.samples and record.samples[-1].effort is None:
            record.samples[-1] = replace(record.samples[-1], effort=self._torque)

    def _take(self, sample: StateSample, motion: TuneMotion, record: TuneRecord) -> None:
        """Judge a sample and keep it."""
        self._sample = sample
        joint, axis = sample.joints.get(self._drive.joint), axis_reading(sample, self._drive)
        enabled = axis is None or axis.state == "OPERATION_ENABLED"
        if joint is None:
            motion.see(None, None, None, enabled=enabled)
            return
        unit = self._effort_unit
        self._keep_torque(record)
        effort = None if joint.effort is None or unit is None else joint.effort * unit
        known = self._torque if effort is None else effort
        motion.see(joint.position, joint.velocity, self._current.value if known is None else known, enabled=enabled)
        cycle = sample.cycle.count + sample.cycle.missed
        record.put(TuneSample(cycle, joint.command or 0.0, joint.position, joint.velocity, effort))
        self._told = known is not None

    def _command(self, client: RobotClient, motion: TuneMotion) -> None:
        """Send what is commanded, and ask for the current where no sample tells it."""
        if not self._told:
            self._current.ask(client)
        if not self._sender.send(client, motion.command):
            motion.end(JogEnd.STATE)
