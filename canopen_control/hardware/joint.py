"""One joint and the drive axis behind it: SI on one side, process data and the CiA 402 machine on the other.

The law of this file: a target reaches the drive only while the joint is enabled, the drive says OPERATION_ENABLED in
the mode that was asked for, and the node is ready; in every other case the target is standstill at the actual
position. A stop first ramps down (`axis_modes`) and waits for standstill, then disables together with its group
(`groups`); the wait ends after `STOP_NS` whatever the drive says. A drive whose statusword is gone while its node
lives is told to quick stop, since nobody can see what else it would do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402.drive import DriveMachine
from canopen_control.cia402.events import FaultEntered
from canopen_control.cia402.modes import OperationMode, require_mode
from canopen_control.cia402.setpoint import SetPointReached, SetPointTaken
from canopen_control.cia402.state import POWERED_STATES, State
from canopen_control.errors import DriveError
from canopen_control.hardware.axis import Axis
from canopen_control.hardware.axis_parameters import AxisParameters
from canopen_control.hardware.axis_status import BLIND_STOP_NS, AxisStatus
from canopen_control.hardware.choice import listed_modes
from canopen_control.hardware.fault_reason import FaultReason
from canopen_control.hardware.feedback import Feedback
from canopen_control.hardware.groups import StopGroup
from canopen_control.hardware.homing_run import HomingRun
from canopen_control.hardware.joint_targets import JointTargets
from canopen_control.hardware.news import News, news_of
from canopen_control.hardware.watch import Watch
from canopen_control.hardware.wishes import Action, Wish
from canopen_control.master.events import Level

if TYPE_CHECKING:
    from canopen_control.cia402.units import Scale
    from canopen_control.hardware.description import ControlJoint
    from canopen_control.master.cycle import ProcessImage
    from canopen_control.master.node import RemoteNode

__all__ = ["Action", "JointDrive", "Wish"]

STOP_NS: Final = 10_000_000_000  # a ramp that takes longer ends in the drive's own disable ramp
_FINE = (SetPointTaken, SetPointReached)
_OFF: Final = Wish.OFF  # for every cycle, see `hardware.interfaces.OK`
_STOPPING: Final = Wish.STOPPING
_FAULTED = (State.FAULT, State.FAULT_REACTION_ACTIVE)


class JointDrive:
    """A joint bound to one axis of one node; the interfaces are what controllers claim.

    `resume` is set by a stop whose cause may be mended without a user: the joint was enabled before it.
    """

    def __init__(self, description: ControlJoint, node: RemoteNode, image: ProcessImage, axis: int = 0) -> None:
        config = node.config
        self.joint, self.node = description.name, node
        self.axis = Axis(description.name, node, image, axis)
        self.machine = DriveMachine(
            node.name,
            transition_timeout_ns=config.transition_timeout_ms * 1_000_000,
            transition_timeouts={number: ms * 1_000_000 for number, ms in config.transition_timeouts_ms.items()},
        )
        self.parameters = AxisParameters(self.axis, self._on_parameters)
        self.group = StopGroup()
        self.group.joints.append(self)
        self.wish = Wish.OFF
        self.resume = False
        self.targets = JointTargets(description, self.axis, self.machine, self.parameters)
        self.commands = self.targets.commands
        self.homing: HomingRun | None = None
        self.homed = False
        self.homing_result: str | None = None
        self.feedback = Feedback(description, self.axis)
        self.states = self.feedback.states
        self.reason = FaultReason(self.axis, lambda text: self._news.append(News("error_code", text, Level.INFO)))
        self._watch = Watch(self.axis, config.following_error_action)
        self._status = AxisStatus(self.axis, self.machine)
        self._evaluations = -1
        self._may_move = False
        self._now = 0
        self._since = 0  # when it began to stop
        self._slowed = False
        self._blind_stop_ns = BLIND_STOP_NS
        self._news: list[News] = []
        self._was_ready = self._was_stale = False

    # ------------------------------------------------------------------------------------------- what is

    @property
    def scale(self) -> Scale:
        """Device units and SI."""
        return self.axis.scale

    @property
    def state(self) -> State | None:
        """The CiA 402 state, None while the node is not there."""
        return self.machine.state if self.node.ready and self.axis.statusword.fresh else None

    @property
    def statusword(self) -> int | None:
        """The newest statusword, None before the first."""
        if self.axis.statusword.pdo.overdue:
            return self.machine.statusword
        return self.axis.statusword.value if self.axis.statusword.fresh else None

    @property
    def claimed(self) -> str | None:
        """The command interface that a controller drives."""
        return self.targets.claimed

    @property
    def wanted(self) -> bool:
        """Whether it is to follow commands."""
        return self.wish is Wish.ON

    @property
    def enabled(self) -> bool:
        """Whether the drive follows commands."""
        ready = self.wish is Wish.ON and self.node.ready and self.group.open
        return ready and self.machine.may_move and self.homing is None

    @property
    def rising(self) -> bool:
        """Whether it is being enabled."""
        return self.wish is Wish.ON and not self.machine.enabled

    @property
    def may_rise(self) -> bool:
        """Whether nothing but its group keeps it from being enabled."""
        machine = self.machine
        return machine.enabled or (machine.waiting and self.parameters.loaded)

    @property
    def falling(self) -> bool:
        """Whether it is ramping down to be disabled."""
        return self.wish is Wish.STOPPING

    @property
    def standing(self) -> bool:
        """Whether the drive reports (nearly) no motion."""
        return self.feedback.standing

    def age_ns(self, now: int) -> int | None:
        """How old the newest statusword is."""
        return self.axis.statusword.age_ns(now)

    def has_come_to_rest(self, now: int) -> bool:
        """Whether a stop may end in disabling the drive."""
        took = now - self._since
        if not self.node.ready or self.machine.state is not State.OPERATION_ENABLED or took > STOP_NS:
            return True
        if self.axis.is_stale:
            return took > self._blind_stop_ns
        return self._slowed and self.feedback.standing

    def reached(self, action: Action) -> bool:
        """Whether what was asked for has been done."""
        state = self.state
        if action is Action.ENABLE:
            return self.enabled and self.machine.reached
        if action is Action.HALT:
            return self.standing
        if action is Action.FAULT_RESET:
            return state is not None and state not in _FAULTED
        if action is Action.HOME:
            return self.homing is None and self.homed
        if action is Action.MODE:
            machine = self.machine
            return self.targets.pending is None and machine.mode_confirmed and not machine.mode_failed
        if action is Action.QUICK_STOP:
            return state is None or (state is not State.OPERATION_ENABLED and self.standing)
        return state is None or state not in POWERED_STATES

    def news(self) -> list[News]:
        """Return what happened since the last call."""
        news, self._news = self._news, []
        return news

    # ------------------------------------------------------------------------------------------- verbs

    def enable(self) -> None:
        """Ask the drive into OPERATION_ENABLED; it follows commands from there. DriveError in a fault."""
        if not self.machine.remote:
            raise DriveError(
                f"{self.node.who}: under local control (statusword bit 9 is 0), "
                "it would not obey; give control to the bus at the drive"
            )
        if self.axis.is_stale:
            raise DriveError(f"{self.node.who}: cannot be enabled, a TPDO with its feedback stays away")
        self.machine.enable()
        self.machine.halt(False)
        self.machine.hold(True)
        self.resume = False
        self.wish = Wish.ON
        self.group.busy, self.group.open = True, False
        for pdo in self.node.sent:
            pdo.changed = True  # whatever stands in the drive, its targets are at rest before it is enabled

    def stop(self, now: int) -> None:
        """Ramp to zero, then disable."""
        self._end_homing("stopped")
        self.resume = False
        if self.wish is Wish.ON:
            self.wish, self._since, self._slowed = Wish.STOPPING, now, False
            self.group.busy = True
            self.machine.hold(False)
            self._blind_stop_ns = self.feedback.ramp_ns(BLIND_STOP_NS)
            if not self.machine.enabled:
                self.switch_off()
        elif self.wish is Wish.OFF:
            self.machine.disable()

    def switch_off(self) -> None:
        """Disable now; for the end of a stop."""
        self.wish = Wish.OFF
        self.machine.hold(False)
        self.machine.disable()

    def quick_stop(self) -> None:
        """Use the drive's quick stop (0x605A); it is disabled or holds afterwards, as that says."""
        self._end_homing("quick stop")
        self.wish, self.resume = Wish.OFF, False
        self.machine.hold(False)
        self.machine.quick_stop()

    def halt(self) -> None:
        """Hold the motion with the halt bit; `enable` goes on."""
        self.machine.halt(True)

    def fault_reset(self) -> None:
        """Acknowledge a fault; the drive stays disabled. Without a fault nothing changes."""
        if self.machine.fault:
            self.wish = Wish.OFF
        self.machine.fault_reset()

    def give_up(self) -> None:
        """Forget the wish: the drive left on its own, or its node is gone."""
        self._end_homing("the drive left operation")
        self.switch_off()

    def home(self, method: int | None) -> None:
        """Begin homing; DriveError where the drive has no such method, or no homing."""
        require_mode(OperationMode.HM, listed_modes(self.axis, self.parameters))
        if self.homing is not None:
            raise DriveError(f"{self.node.who}: homing is under way already")
        timeout = round(self.node.config.homing_timeout_seconds * 1e9)
        self.homing, self.homed = HomingRun(self, method, timeout_ns=timeout), False

    def begin_homing(self) -> None:
        """Go into mode HM and enable; for the homing under way."""
        try:
            self.enable()
        except DriveError as error:
            self._end_homing(str(error))
            return
        self.targets.take_mode(OperationMode.HM)

    def end_homing(self, mode: int | None, enabled: bool, *, homed: bool) -> None:
        """Go back to the mode and power from before; a homed axis counts from its new zero."""
        run, self.homing = self.homing, None
        self.homed, self.homing_result = homed, run.result if run is not None else None
        if homed:
            self.feedback.restart()
            self._news.append(News("homed", "homed", Level.INFO))
        elif run is not None:
            self._news.append(News("homing_failed", run.result or ""))
        if mode is not None:
            self.targets.take_mode(OperationMode(mode))
        if not enabled and self.wish is Wish.ON:
            self.stop(self._now)

    # ------------------------------------------------------------------------------------------- cycle

    def read(self, now: int) -> None:
        """Latch the newest process data into the state interfaces; nan while the node is not there."""
        ready = self.node.ready
        if ready is not self._was_ready:
            self._was_ready = ready
            self._came() if ready else self._went(now)
        if ready:
            if self.node.stale is not self._was_stale:
                self._became_stale(self.node.stale)
            jump = self.feedback.read(now)
            if jump:
                self.homed = False
                self._news.append(
                    News("position_jump", f"its position jumped by {jump} counts; home it again", stops=True)
                )

    def step(self, now: int) -> bool:
        """Advance the state machine by one cycle; returns whether `news` tells anything."""
        self._now = now
        machine, axis, status = self.machine, self.axis, self._status
        status.update(now)
        word, before = status.word, machine.statusword
        machine.standstill = self.feedback.standing
        control = machine.update(word, status.display, now)
        if machine.evaluations != self._evaluations or word != before:
            self._evaluations = machine.evaluations
            self._may_move = machine.may_move
            if word is not None and word != before:
                self._news += self._watch.look(word, machine.mode, self.targets.current)
            self._take_events()
        elif self.targets.handshakes:
            self._take_events()
        if word is None:
            control = status.blind_word(now)
        if control != axis.controlword.value:
            axis.controlword.set(control)
        return bool(self._news)

    def write(self, now: int, period: float) -> None:
        """Set mode and targets, after every joint of the group has seen its statusword."""
        targets = self.targets
        if targets.pending is not None:
            targets.change()
        elif self.homing is not None:
            targets.hold()
            self.machine.mode_bits = self.homing.step(now)
        elif not self._may_move or self.wish is _OFF or not self.group.open:
            targets.hold()
        elif self.wish is _STOPPING:
            self._slowed = targets.slow(period)
        else:
            targets.follow(now, period)
        targets.write_mode()

    def supervise(self) -> None:
        """Look at what need not be seen in every cycle; ten times a second."""
        if self._watch.leaves_limit():
            self._news.append(News("limit_left", "the limit is left", Level.INFO))
        if self._watch.turns_the_wrong_way(self.enabled):
            text = "it turns against its command; check polarity (0x607E), the scale's sign and the wiring"
            self._news.append(News("direction", text, stops=True))
        if self.enabled:
            self.targets.hold_others()

    # ------------------------------------------------------------------------------------------- inside

    def _came(self) -> None:
        self._status.came()
        self.feedback.came()
        self.reason.code = None
        self.parameters.load()

    def _went(self, now: int) -> None:
        self._status.went(now)
        self.feedback.went()
        self.parameters.forget()
        self.homed = self._was_stale = False
        self._end_homing("its node is gone")
        self.machine.disable()
        why = (self.node.error or "it left OPERATIONAL").removeprefix(self.node.who)
        self._news.append(News("node_lost", f"lost: {why.lstrip(': ')}", Level.ERROR, stops=True))

    def _became_stale(self, stale: bool) -> None:
        """Stop when feedback stays away; the statusword is asked for by SDO meanwhile."""
        self._was_stale = stale
        self._status.came()
        if stale and self.axis.is_stale:
            self._news.append(News("feedback_stale", "its feedback is stale", Level.ERROR, stops=True))

    def _on_parameters(self) -> None:
        self.feedback.refresh_scale()
        self._news += [News("parameters", text) for text in self.parameters.failed]

    def _end_homing(self, reason: str) -> None:
        if self.homing is not None:
            self.homing.abort(reason)

    def _take_events(self) -> None:
        for event in self.machine.events():
            self._news.append(news_of(event))
            if isinstance(event, FaultEntered):
                self.reason.ask()
        if self.targets.current is not None:
            self._news += [
                News("set_point", event.text, Level.INFO if isinstance(event, _FINE) else Level.WARNING)
                for event in self.targets.current.events()
            ]
