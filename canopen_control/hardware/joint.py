"""Joint with its drive axis: SI units for controllers, process data and CiA 402 for the drive.

The statechart (`axis_statechart`), whose triggers are fired here, decides whether the axis may move: targets reach the
drive only in FOLLOWING; in every other state the target is standstill at the actual position, or a ramp to standstill
(`joint_targets`). An operational drive without a statusword gets a quick stop, because its motion cannot be observed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402.events import FaultEntered, ModeTimedOut
from canopen_control.cia402.homing import HomingPosition
from canopen_control.cia402.modes import OperationMode, mode_of, require_mode
from canopen_control.cia402.objects import INTERPOLATION_BUFFER, POSITION_ACTUAL
from canopen_control.cia402.setpoint import SetPointDeferred, SetPointReached, SetPointTaken
from canopen_control.cia402.state import POWERED_STATES, State
from canopen_control.errors import DriveError
from canopen_control.hardware.axis import (
    BLIND_STOP_NS,
    AxisProcessData,
    AxisStatus,
    InterpolationBuffer,
    configured_machine,
)
from canopen_control.hardware.axis_parameters import AxisParameters, has_target, listed_modes, unlisted_modes
from canopen_control.hardware.axis_statechart import (
    ENABLING,
    STOPPED,
    AxisPhase,
    AxisStatechart,
    BaseJoints,
    PhaseTrigger,
    StopGroup,
    holds_load,
)
from canopen_control.hardware.feedback import Feedback, FeedbackStatus
from canopen_control.hardware.interfaces import DIGITAL_OUTPUTS, TARGET, StateInterface
from canopen_control.hardware.joint_events import (
    JUMP_TEXT,
    FaultWatch,
    ForeignRpdoWatch,
    JointEvent,
    StatusWatch,
    joint_event_of,
)
from canopen_control.hardware.joint_homing import HomePosition, HomingPhase, JointHoming
from canopen_control.hardware.joint_targets import JointTargets
from canopen_control.hardware.motion_watch import MotionWatch
from canopen_control.master.event_log import Level
from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.urdf.joint_element import POSITION, VELOCITY

if TYPE_CHECKING:
    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.cia402.units import Scale
    from canopen_control.master.cycle import ProcessImage
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.urdf.ros2_control import ControlJoint


class JointStatus:
    """Status of a joint and of its drive axis: state, power, homing and feedback; base class of `JointDrive`.

    This class only reports; `JointDrive` moves the axis. `tracking` measures how well the joint follows its set-points.
    """

    def __init__(self, description: ControlJoint, node: RemoteNode, image: ProcessImage, axis: int = 0) -> None:
        self.joint, self.node = description.name, node
        self.axis = AxisProcessData(description.name, node, image, axis)
        self.machine: DriveMachine = configured_machine(node)
        is_profile_target = TARGET in description.command_interfaces
        self.parameters = AxisParameters(
            self.axis, self._on_parameters, self._on_parameter, is_profile_target=is_profile_target
        )
        self.targets: JointTargets = JointTargets(description, self.axis, self.machine, self.parameters)
        self.commands = self.targets.commands
        self.home_position = HomePosition(self.axis, self.machine, self.parameters)
        self.buffer = InterpolationBuffer(self.axis)
        self.feedback = Feedback(description, self.axis)
        self.states = self.feedback.states
        self.statechart = AxisStatechart(
            self.machine,
            [command for name, command in self.commands.items() if name != DIGITAL_OUTPUTS],
            holds_load=holds_load(description),
        )
        self.tracking = self.targets.tracking
        unknown = StateInterface(description.name, POSITION)  # always nan
        self._measured = {name: self.states.get(name, unknown) for name in (POSITION, VELOCITY)}
        self._mode_when_off: int | None = None  # mode to request when the drive has no power
        self._blind_stop_ns = BLIND_STOP_NS
        self._steady_from = 0  # before this time a standstill may be the turning point of an oscillation
        self._events: list[JointEvent] = []
        self.faults = FaultWatch(self.axis, self._events)

    @property
    def scale(self) -> Scale:
        return self.axis.scale

    @property
    def state(self) -> State | None:
        """CiA 402 state of the drive, or None if unknown or while the node is absent."""
        return self.machine.state if self.node.ready else None

    @property
    def statusword(self) -> int | None:
        """Latest statusword, from its TPDO or by SDO; None if unknown."""
        status = self.axis.statusword
        return status.value if status.fresh and not status.pdo.overdue else self.machine.statusword

    @property
    def claimed(self) -> str | None:
        """Command interface that a controller has claimed, or None."""
        return self.targets.claimed

    @property
    def lacks_target(self) -> bool:
        """Whether a joint with the interface TARGET cannot be enabled because no RPDO contains a target."""
        return TARGET in self.commands and not has_target(self.axis)

    @property
    def enable_requested(self) -> bool:
        return self.statechart.enable_requested

    @property
    def following(self) -> bool:
        """Whether commands are sent to the drive; equals `enabled` of the command interfaces."""
        return self.statechart.following

    @property
    def enabled(self) -> bool:
        """Whether the joint follows commands and its node is operational."""
        return self.statechart.following and self.node.ready

    @property
    def homing(self) -> JointHoming | None:
        return self.home_position.homing

    @property
    def homed(self) -> bool:
        """Whether the last homing was successful and the home position is still valid."""
        return self.home_position.known

    @property
    def is_enabled_or_ready(self) -> bool:
        """Whether the joint is enabled, or could be enabled as soon as its group permits."""
        machine = self.machine
        if machine.enabled or not (machine.waiting and self.parameters.loaded) or self.buffer.is_open:
            return machine.enabled
        return self.uncommanded_motion is None and not self.targets.awaits_position(self.targets.mode)

    @property
    def uncommanded_motion(self) -> str | None:
        """Reason why the axis would move without a command as soon as it is enabled, or None."""
        mode = self.targets.mode if self._mode_when_off is None else self._mode_when_off
        return None if self.homing is not None else self.targets.uncommanded_motion(mode)

    @property
    def at_standstill(self) -> bool:
        return self.feedback.at_standstill

    @property
    def fault(self) -> FaultEvent | None:
        """Fault of the drive, or None; it has only the statusword until the error code is known."""
        if not self.machine.fault:
            return None
        return self.faults.fault or FaultEvent(statusword=self.machine.statusword)

    def age_ns(self, now: int) -> int | None:
        """Return the age in ns of the latest statusword from a TPDO, or None before the first TPDO."""
        return self.axis.statusword.age_ns(now)

    def has_settled(self, now: int) -> bool:
        """Whether the controlled stop has ended, so that the drive may be disabled."""
        if not self.node.ready or self.machine.state is not State.OPERATION_ENABLED:
            return True
        if self.axis.is_stale:
            return now - self.statechart.since > self._blind_stop_ns
        return self.statechart.state is AxisPhase.AWAITING_STANDSTILL and self._stands(now)

    def _stands(self, now: int) -> bool:
        """Whether the feedback shows standstill, and no position jump was handled just before."""
        return now >= self._steady_from and self.feedback.stands(now)

    def events(self) -> list[JointEvent]:
        events = self._events.copy()
        self._events.clear()
        return events

    def _on_parameter(self, text: str) -> None:
        self._events.append(JointEvent("parameters", text))

    def _on_parameters(self) -> None:
        self.feedback.refresh_scale()
        self.targets.refresh()
        self.buffer.booted(self.parameters.get(INTERPOLATION_BUFFER, 6))
        self._events += [JointEvent("parameters", text) for text in self.parameters.failed]
        self._events += [JointEvent("mode", text) for text in unlisted_modes(self.axis, self.parameters)]


_INFO_EVENTS = (SetPointTaken, SetPointReached, SetPointDeferred)
_FOLLOWING: Final = AxisPhase.FOLLOWING  # faster than the enum member, see `hardware.interfaces.OK`

_MAY_HOME: Final = (AxisPhase.READY, AxisPhase.HOMING)
_POSITION_NS: Final = 1_000_000_000  # time for the TPDO with the position of a drive that is being enabled
_ZERO_NS: Final = 500_000_000  # time for the TPDO with the position after homing
_LONGEST_REST_NS: Final = 5_000_000_000
_NEVER: Final = 1 << 62
_TURNS_ON_TEXT: Final = "it still turns 5 s after another mode was requested; brake it, then enable it in the new mode"
_REST_AFTER_JUMP_NS: Final = 300_000_000
_REST_NS: Final = 100_000_000  # a motor below the speed of a standstill still needs this time to stop
_BOOTING: Final = "; booting it again"  # the end of a text that the node has reported already
_LOST: Final = FeedbackStatus.LOST  # faster than the enum member
_STALE: Final = FeedbackStatus.STALE
_LIVE: Final = FeedbackStatus.LIVE


class JointDrive(JointStatus):
    """Joint bound to one axis of a drive; enables, moves and stops the axis for controllers and users.

    `statechart` is the statechart of the axis. `resume` is set by a stop whose cause may disappear without user
    action, if the joint was enabled before the stop. `<param name="holds_load">true</param>` means that the load would
    fall without power.
    """

    def __init__(self, description: ControlJoint, node: RemoteNode, image: ProcessImage, axis: int = 0) -> None:
        super().__init__(description, node, image, axis)
        self.stop_group: StopGroup[JointDrive] = StopGroup()
        """Stop group in the description; `group` is this group, or the group into which a base controller merged it."""
        self.group = self.stop_group
        self.group.joints.append(self)
        self.base: BaseJoints[JointDrive] | None = None
        self.partners: tuple[JointDrive, ...] = ()
        """Joints of the other motors with the same controlword, which are enabled, stopped and reset together."""
        self.resume = False
        self.stopped_by = ""
        """Cause of the last stop since the joint was enabled, or "" if a user requested the stop."""
        self._foreign = ForeignRpdoWatch(node)
        self._watch = StatusWatch(self.axis, node.config.motion.following_error_action)
        self._motion = MotionWatch(self.axis, self.machine, node.config.motion.following_error_action)
        self._settle_ns = node.config.motion.enable_settle_ms * 1_000_000
        self._settled_at = 0  # a newly enabled drive may lose set-points before this time
        self._status = AxisStatus(self.axis, self.machine, holds_load=self.statechart.holds_load)
        node.uses.append(self.statechart)
        self._limits, self._controlword, self._mode = self.axis.limits, self.axis.controlword, self.axis.mode
        self._evaluations = -1
        self._feedback_status: FeedbackStatus = _LOST
        self._now = 0
        self._mode_after_homing: int | None = None  # requested when the axis has come to a standstill
        self._rests_from = 0  # end of the wait for this standstill
        self._rest_by: int | None = None  # end of the ramp before a mode change

    # ------------------------------------------------------------------------------------------- commands

    def check_enable(self) -> None:
        """Raise the DriveError that `enable` would raise, without requesting anything."""
        # CiA 402-2, 0x6041 bit 9 (remote): 0 while the controlword is not processed
        if not self.machine.remote:
            raise DriveError(
                f"{self.axis.label}: under local control (statusword bit 9 is 0), "
                "so it would ignore commands; give control to the bus at the drive, or for a drive that never sets "
                "the bit set `ignore_remote: true` in bus.yml"
            )
        if self.axis.is_stale:
            raise DriveError(f"{self.axis.label}: cannot be enabled because a TPDO with its feedback is overdue")
        if (reason := self.uncommanded_motion) is not None:
            raise DriveError(f"{self.axis.label}: {reason}")
        self.machine.check_enable()

    def enable(self) -> None:
        """Request OPERATION_ENABLED, in which the joint follows commands; raise DriveError if impossible."""
        self.check_enable()
        self.resume, self.stopped_by = False, ""
        self._take_mode_when_off()
        self.targets.feed_forward.zero()
        self.tracking.begin()
        self._fire(PhaseTrigger.ENABLE)
        for pdo in self.node.sent:
            pdo.changed = True  # the drive gets targets at standstill before it is enabled

    def stop(self, now: int) -> None:
        """Ramp to a standstill, then disable the drive together with its group."""
        self._now = now
        self.resume = False
        if self._motion.unmoved:
            self.targets.hold()  # an axis that has not moved must not jump to its targets
        if self._fire(PhaseTrigger.STOP) and self.statechart.falling:
            self._blind_stop_ns = self.feedback.ramp_ns(BLIND_STOP_NS)
        self._abort_homing("stopped")
        if self.statechart.falling and not self.machine.enabled:
            self._fire(PhaseTrigger.DRIVE_LOST_ENABLE)

    @property
    def stopped(self) -> bool:
        """Whether the drive has no power or has completed a quick stop, as far as observable."""
        return self.statechart.state in STOPPED and (self.machine.reached or self._status.invisible)

    def quick_stop(self) -> None:
        """Request a quick stop; 0x605A determines whether the drive then holds position or is disabled."""
        self.resume = False
        self._fire(PhaseTrigger.QUICK_STOP)
        self._abort_homing("quick stop")

    def halt(self) -> None:
        """Stop the motion with the halt bit of the controlword, until the next `enable`."""
        self._fire(PhaseTrigger.HALT)

    def fault_reset(self) -> None:
        """Request a fault reset, after which the drive stays disabled; no effect without a fault."""
        self._fire(PhaseTrigger.FAULT_RESET)

    def give_up(self) -> None:
        """Treat the axis as disabled after the drive has left OPERATION_ENABLED or its node was lost."""
        self._fire(PhaseTrigger.DRIVE_LOST_ENABLE if self.node.ready else PhaseTrigger.NODE_LOST)
        self._abort_homing("the drive left operation")

    def home(self, method: int | None) -> None:
        """Start homing by a method of 0x6098 (None: the method set in the drive); raise DriveError if impossible."""
        # CiA 402-2, 0x6502 bit 5: mode HM
        require_mode(OperationMode.HM, listed_modes(self.axis, self.parameters))
        self.home_position.begin(method, was_enabled=self.enable_requested)
        self._fire(PhaseTrigger.STANDSTILL_REQUIRED)

    # ------------------------------------------------------------------------------------------- cycle

    def read(self, now: int) -> None:
        """Update the state interfaces from the latest process data; nan while the node is absent."""
        node = self.node
        status = _LOST if not node.ready else _STALE if node.stale else _LIVE
        if status is not self._feedback_status:
            self._change_feedback_status(status, now)
        if node.contradicted != self._foreign.seen:
            self._events += self._foreign.check(now, enabled=self.enable_requested)
        if status is not _LOST:
            jump = self.feedback.read(now) or self.feedback.unexplained
            homing = self.homing is not None and self.homing.phase is HomingPhase.RUN  # it changes the zero
            if jump and not homing:
                self._take_jump(jump)

    def step(self, now: int) -> bool:
        """Run one cycle of the drive's state machine; return whether `events` has entries."""
        self._now = now
        machine, status, statechart = self.machine, self._status, self.statechart
        pdo, shown = status.pdo, status.shown
        word: int | None
        display: int | None
        if self._feedback_status is _LIVE and shown is not None and pdo.stamp >= 0 and shown.stamp >= 0:
            # same as `AxisStatus.update`, but faster; both values are integers
            status.word = word = pdo.values[status.place]  # type: ignore[assignment]
            status.display = display = shown.values[status.shown_place]  # type: ignore[assignment]
        else:
            status.update(now)
            word, display = status.word, status.display
        before = machine.statusword
        if word == before and display == machine.mode_request.display and now < machine.next_update:
            control = machine.controlword  # same as `update`, but faster
            current = self.targets.current
            if current is not None and current.handshakes:
                self._take_events()
        else:
            machine.standstill = self.feedback.at_standstill
            control = machine.update(word, display, now)
            self._take_update(word, before)
        if statechart.watched:
            self._check_transitions(now)
        if self._limits.blocked and not self._events and machine.may_move and self._commands_into_limit():
            self._events.append(self._watch.limit_event())
        if word is None:
            control = status.blind_word(now)
        output = self._controlword
        if control != output.value:
            output.set(control)
            if control & 6 == 2 or (self._feedback_status is _STALE and not statechart.enable_requested):
                status.send(control)  # CiA 402-2, table 24: quick stop, bit 1 without bit 2
        return bool(self._events)

    def _take_update(self, word: int | None, before: int | None) -> None:
        """Collect the events of a new statusword, mode or timeout; stop following targets if motion is not allowed."""
        machine, current = self.machine, self.targets.current
        if machine.evaluations != self._evaluations or word != before:
            self._evaluations = machine.evaluations
            if self.statechart.following and not machine.may_move:
                self._fire(PhaseTrigger.STANDSTILL_REQUIRED)
            if word is not None and word != before:
                self._events += self._watch.check(word, machine.mode, current, self._stops_at_limits)
            self._take_events()
        elif current is not None and current.handshakes:
            self._take_events()

    def write(self, now: int, period: float) -> None:
        """Set the mode and the targets; call after `step` of all joints, so that the group has its new state."""
        targets, statechart = self.targets, self.statechart
        if self._mode_after_homing is not None:
            self._restore_mode()
        if targets.pending is not None:
            self._change_mode(now, period)
        elif (run := self.home_position.homing) is not None:
            waits = run.phase in (HomingPhase.METHOD, HomingPhase.KNOWN) and targets.ends_abruptly
            if not waits or self._comes_to_rest(now, period):
                targets.hold()
                self._step_homing(run, now)
        elif statechart.state is _FOLLOWING:
            targets.follow(now, period)
            if (command := targets.tracked) is not None:
                self.tracking.step(command.value, self._measured[command.quantity].value)
        elif self._may_follow(now):
            self._fire(PhaseTrigger.MOTION_PERMITTED)
            self.tracking.restart()
            targets.follow(now, period)
        elif statechart.falling:
            self._brake(period)
        else:
            targets.hold()
        mode = self._mode
        if targets.has_outputs or (mode is not None and mode.value != self.machine.mode_request.sent):
            targets.write_outputs()

    def _change_mode(self, now: int, period: float) -> None:
        """Change to the pending mode, at standstill if this mode or the present one has no ramp in the drive."""
        targets = self.targets
        if targets.changes_abruptly and not self._comes_to_rest(now, period):
            return
        self._rest_by = None
        targets.change()
        if targets.claimed == TARGET:
            self._fire(PhaseTrigger.STANDSTILL_REQUIRED)  # the old command was for the previous mode

    def _comes_to_rest(self, now: int, period: float) -> bool:
        """Ramp an axis down; return whether it is at standstill or has no power; report one that does not stop."""
        if not self.machine.may_move:
            self._rest_by = None
            return True
        if self._rest_by is None:
            self._rest_by = now + _LONGEST_REST_NS
        if self.statechart.falling:
            self._brake(period)
            at_rest = True
        else:
            self._fire(PhaseTrigger.STANDSTILL_REQUIRED)
            at_rest = self.targets.come_to_rest(now, period)
        if at_rest and self.feedback.at_standstill:
            self._rest_by = None
            return True
        if now >= self._rest_by:
            self._rest_by = _NEVER
            self._events.append(JointEvent("mode_timeout", _TURNS_ON_TEXT, Level.ERROR, stops=True))
        return False

    def _may_follow(self, now: int) -> bool:
        """Whether the axis waits only for the permission to follow its commands."""
        ready = self.statechart.state is AxisPhase.READY and self._mode_after_homing is None
        if not (ready and self.machine.may_move and now >= self._settled_at):
            return False
        return not self.targets.interpolates or self.buffer.set(True, now)

    def supervise(self) -> None:
        """Run the checks that are needed only ten times a second."""
        if self._watch.leaves_limit():
            self._events.append(JointEvent("limit_left", "the axis has left its limit", Level.INFO))
        self._motion.check(self.targets.current, self.enabled)
        self._motion.check_slowing(self._measured[VELOCITY].value, self.targets.current, self.statechart, self._now)
        wrong_way = self._watch.turns_the_wrong_way(self.enabled)
        self._events += self._motion.events(wrong_way=wrong_way, in_base=self.base is not None)
        if (unit := self.feedback.velocity_unit_mismatch(self._now)) is not None:
            self._events.append(JointEvent("velocity_unit", unit.text, stops=unit.faster))
        if self.enabled:
            self.targets.hold_others()
        self._supervise_buffer()
        warnings = (
            ("velocity_hidden", self.feedback.hidden_motion),
            ("feed_forward", self.targets.feed_forward.refused()),
            ("held_back", self._watch.held_back()),
            ("target_refused", self._watch.refuses(self.targets.claimed)),
        )
        self._events += [JointEvent(kind, text) for kind, text in warnings if text is not None]

    # ------------------------------------------------------------------------------------------- internals

    def _supervise_buffer(self) -> None:
        """Close the buffer of mode IP while it is not needed; report an enabled axis whose buffer cannot be set."""
        used = self.machine.may_move and self.targets.interpolates  # the set-points of a ramp are still needed
        if not used and (self.enable_requested or not self.buffer.refusal):
            self.buffer.set(False, self._now)
        if self.buffer.refusal and self.enable_requested:
            self._events.append(JointEvent("not_enabled", self.buffer.failure, Level.ERROR, stops=True))

    def _take_jump(self, jump: int) -> None:
        """Report a jump, which stops the group; the drive gets its target in its new coordinates at once."""
        if jump == self.feedback.unexplained:
            if not self.targets.is_left_by(self.axis.raw_position, jump):
                return  # an axis that is free to move, or moves to its target
            self.feedback.discount(jump)
        self.home_position.forget()
        self.targets.shift()
        self._steady_from = self._now + _REST_AFTER_JUMP_NS
        command = self.targets.tracked
        sent = command.value if command is not None and command.quantity == VELOCITY else 0.0
        unit = self.feedback.unit_mismatch_of_jump(sent)
        text = JUMP_TEXT.format(self.axis.index(POSITION_ACTUAL), jump)
        event = ("position_jump", text) if unit is None else ("velocity_unit", unit.text)
        self._events.append(JointEvent(*event, stops=True))

    @property
    def _stops_at_limits(self) -> bool:
        """Whether an active limit stops the group.

        False while homing, in a group of one joint, and for a joint in a position mode that belongs to no base.
        """
        target = self.targets.current
        positions = target is not None and target.interface == POSITION and self.base is None
        return self.homing is None and len(self.group.joints) > 1 and not positions

    def _commands_into_limit(self) -> bool:
        target, claimed = self.targets.current, self.targets.claimed
        if not self.enable_requested or target is None or claimed is None or not self._stops_at_limits:
            return False
        command = self.commands[claimed]
        return target.interface == command.quantity and target.commands_into_limit(command.value)

    def _fire(self, trigger: PhaseTrigger) -> bool:
        """Fire a trigger of the statechart and mark the group for its checks; return whether the state has changed."""
        changed = self.statechart.fire(trigger, self._now)
        self.group.busy |= changed
        if changed and self.statechart.state is AxisPhase.DISABLED:
            self._take_mode_when_off()
        return changed

    def _check_transitions(self, now: int) -> None:
        """Fire the triggers that depend on the drive's state; report stops that take too long."""
        statechart, machine, state = self.statechart, self.machine, self.machine.state
        if statechart.state in ENABLING:
            if machine.enabled and self._fire(PhaseTrigger.DRIVE_ENABLED):
                self._settled_at = now + self._settle_ns
                if machine.halted:
                    self._fire(PhaseTrigger.HALT)
            elif machine.waiting:
                self._check_position(now)
            return
        if not self.node.ready:
            self._fire(PhaseTrigger.NODE_LOST)
        # CiA 402-2, 6.3: only in these states the motor may have torque
        elif state is not None and state not in POWERED_STATES:
            self._fire(PhaseTrigger.DRIVE_DISABLED)
        elif state is not None and state is not State.OPERATION_ENABLED and self._stands(now):
            self._fire(PhaseTrigger.AT_STANDSTILL)
        if not (statechart.falling and self.has_settled(now)) and statechart.overdue(now):
            text = self._status.force_stop(statechart.state, now)
            self._events.append(JointEvent("stop_overdue", text, Level.ERROR))

    def _check_position(self, now: int) -> None:
        """Report a drive that is not enabled because its position is unknown or outside its limits."""
        reason = self.uncommanded_motion
        if self.targets.awaits_position(self.targets.mode) and now - self.statechart.since > _POSITION_NS:
            reason = self.targets.unknown_position
        if reason is not None:
            self._events.append(JointEvent("not_enabled", reason, Level.ERROR, stops=True))

    def _take_mode_when_off(self) -> None:
        mode, self._mode_when_off = self._mode_when_off, None
        if mode is not None:
            self.targets.take_mode(mode)

    def _brake(self, period: float) -> None:
        """Run one cycle of a controlled stop.

        If the drive no longer follows targets, they are set to standstill at once.
        """
        at_standstill = True
        if self.machine.may_move:
            at_standstill = self.targets.ramp_down(period)
        else:
            self.targets.hold()
        if at_standstill:
            self._fire(PhaseTrigger.TARGET_AT_STANDSTILL)

    def _change_feedback_status(self, status: FeedbackStatus, now: int) -> None:
        before, self._feedback_status = self._feedback_status, status
        if status is _LOST:
            self._node_lost(now)
            return
        if before is _LOST:
            self._node_ready()
        if status is _STALE:
            self._report_stale_feedback()
        elif before is _STALE:
            self._status.restart()

    def _node_ready(self) -> None:
        self._status.restart()
        self.feedback.node_ready()
        self.targets.node_ready()
        self.faults.fault = None
        self.parameters.load()

    def _node_lost(self, now: int) -> None:
        self._fire(PhaseTrigger.STANDSTILL_REQUIRED)
        self._status.node_lost(now)
        self.feedback.node_lost()
        self.parameters.forget()
        self.home_position.forget()
        self._abort_homing("its node was lost")
        self.machine.disable()
        why = (self.node.reason or "it left OPERATIONAL").removesuffix(_BOOTING)
        self._events.append(JointEvent("node_lost", f"lost: {why}", Level.ERROR, stops=True))

    def _report_stale_feedback(self) -> None:
        """Report stale feedback, which stops the group, and read the statusword by SDO in the meantime."""
        self._status.restart()
        if self.axis.is_stale:
            self._events.append(JointEvent("feedback_stale", "its feedback is stale", Level.ERROR, stops=True))

    def _step_homing(self, run: JointHoming, now: int) -> None:
        """Run one cycle of homing: enable the drive in mode HM, home, and finally restore its mode and power state."""
        if run.phase is HomingPhase.KNOWN:
            run.phase = HomingPhase.ENABLE
            try:
                self.enable()
            except DriveError as error:
                run.abort(str(error))
            else:
                self.targets.take_mode(OperationMode.HM)
        ready, position = self.statechart.state in _MAY_HOME, self.axis.position
        shown = None
        if position is not None and position.fresh:
            shown = HomingPosition(position.value, position.pdo.count)
        standing = self.at_standstill and shown is not None
        self.machine.mode_bits = run.step(self.enable_requested, ready, now, standing=standing, position=shown)
        if run.phase is HomingPhase.RUN:
            self._fire(PhaseTrigger.HOMING_STARTED)
        waits = run.homed and run.ended_within(now, _ZERO_NS) and self._motion_in(run.mode_before)
        if run.over and not waits:
            self._leave_homing(run)

    def _abort_homing(self, reason: str) -> None:
        if self.homing is not None:
            self.homing.abort(reason)
            self._leave_homing(self.homing)

    def _motion_in(self, mode: int | None) -> str | None:
        """Return why an enabled axis would move without a command in a mode, or None."""
        return self.targets.uncommanded_motion(mode) if self.machine.state is State.OPERATION_ENABLED else None

    def _leave_homing(self, run: JointHoming) -> None:
        """Restore the mode and the power state after homing; after a success, positions count from the new zero."""
        self.home_position.end(run)
        self.machine.mode_bits = 0
        self._fire(PhaseTrigger.HOMING_ENDED)
        if run.homed:
            self.feedback.restart()
            self._events.append(JointEvent("homed", "homed", Level.INFO))
        else:
            self._events.append(JointEvent("homing_failed", run.result or ""))
        if run.mode_before is not None:
            self._mode_after_homing = mode_of(run.mode_before)
            self._restore_mode()
        if not run.was_enabled and self.enable_requested:
            self.stop(self._now)

    def _restore_mode(self) -> None:
        """Request the mode from before the homing once the axis is at standstill; until then, mode HM ends its motion.

        In a cyclic mode, a drive that still turns would reverse towards the target at its last position.
        """
        mode, machine = self._mode_after_homing, self.machine
        if machine.state in POWERED_STATES and not self.feedback.at_standstill:
            self._rests_from = self._now + _REST_NS
        if mode is None or (machine.state in POWERED_STATES and self._now < self._rests_from):
            return
        self._mode_after_homing = None
        if machine.mode != OperationMode.HM:
            return  # another mode was requested meanwhile
        moves = self._motion_in(mode)
        if moves is None:
            self.targets.take_mode(mode)
        else:
            self._mode_when_off = mode
            self._events.append(JointEvent("not_enabled", moves, Level.ERROR, stops=True))

    def _mode_event(self, event: ModeTimedOut, joint_event: JointEvent) -> JointEvent:
        """Add the reason of a refused mode to an event, and whether the event stops the group."""
        refusal, unserved = self._status.mode_refusal, event.enabled and self.targets.is_unserved_in(event.restored)
        text = f"{joint_event.text}; {refusal}" if refusal else joint_event.text
        return joint_event._replace(text=text, stops=joint_event.stops or unserved)

    def _take_events(self) -> None:
        for event in self.machine.events():
            joint_event = joint_event_of(event)
            if isinstance(event, FaultEntered):
                assert joint_event.fault is not None
                self.faults.enter(joint_event.fault)
            elif isinstance(event, ModeTimedOut):
                joint_event = self._mode_event(event, joint_event)
            self._events.append(joint_event)
        if self.targets.current is not None:
            self._events += [
                JointEvent("set_point", event.text, Level.INFO if isinstance(event, _INFO_EVENTS) else Level.WARNING)
                for event in self.targets.current.events()
            ]
