"""Runtimes with a mistake each, for the tests of the invariants."""

from msgspec import structs

from canopen_control.cia301.heartbeat import HeartbeatEventKind
from canopen_control.controllers.command_timeout import CommandTimeout
from canopen_control.controllers.joint_state import JointStateBroadcaster
from canopen_control.controllers.manager import ControllerManager
from canopen_control.controllers.update_loop import UpdateLoop
from canopen_control.hardware.interfaces import OK
from canopen_control.hardware.joint import JointDrive
from canopen_control.hardware.mode_targets import VelocityTarget
from canopen_control.hardware.system import CanopenSystem, Recovery
from canopen_control.host.lineserver import Connection, LineServer
from canopen_control.master.network import Network
from canopen_control.master.remote_node import RemoteNode
from canopen_control.runtime import node_readings, status
from canopen_control.runtime.core import RobotCore, RobotState
from canopen_control.runtime.node_readings import NodeReadings
from canopen_control.runtime.pacer import Pacer
from canopen_control.runtime.stop_latch import StopLatch
from canopen_control.virtual.power_machine import DriveLimits


def stop_is_late(patch):
    real = RobotCore.stop

    def stop(self, *words, **how):
        self.reactor.call_later(700_000_000, lambda: real(self, *words, **how))

    patch.setattr(RobotCore, "stop", stop)


def stop_does_nothing(patch):
    patch.setattr(RobotCore, "stop", lambda self, *words, **how: None)


def enabled_again_when_its_node_is_back(patch):
    came = JointDrive._node_ready

    def back(self):
        came(self)
        self.resume = bool(self.stopped_by)

    patch.setattr(JointDrive, "_node_ready", back)


def enabled_again_after_a_stop(patch):
    step = Recovery.step

    def again(self, now):
        for joint in self._joints:
            joint.resume = joint.resume or (
                joint.statechart.state.name == "DISABLED" and now % 5_000_000_000 < 200_000_000
            )
        step(self, now)

    patch.setattr(Recovery, "step", again)


def reset_chains_into_enable(patch):
    def reset(self):
        real(self)
        self.resume = True

    real = JointDrive.fault_reset
    patch.setattr(JointDrive, "fault_reset", reset)


def stale_commands(patch):
    patch.setattr(CommandTimeout, "expire", lambda self, now: False)


def latch_does_not_refuse(patch):
    patch.setattr(StopLatch, "refuse", lambda self, *what: None)


def told_as_running(patch):
    patch.setattr(RobotCore, "state", property(lambda self: RobotState.RUNNING))


def told_as_enabled(patch):
    patch.setattr(JointDrive, "enabled", property(lambda self: self.node.ready))


def skipped_cycles(patch):
    real = Pacer._on_edge

    def edge(self):
        if self.count % 200 == 199:
            self.count += 1
            self._arm(self._edge + self.period_ns)
            return
        real(self)

    patch.setattr(Pacer, "_on_edge", edge)


def commands_sent_again_and_again(patch):
    real = Network.cycle
    patch.setattr(Network, "cycle", lambda self, *, sync: real(self, sync=sync) + self.sync_record() * 40)


def exceptions(patch):
    real = ControllerManager.command

    def command(self, *args, **how):
        self.commands = getattr(self, "commands", 0) + 1
        if self.commands == 50:
            raise ZeroDivisionError("of a mutant")
        return real(self, *args, **how)

    patch.setattr(ControllerManager, "command", command)


def lost_heartbeats_unnoticed(patch):
    real = RemoteNode.on_heartbeat

    def hear(self, event, now, since=None):
        if event.kind is not HeartbeatEventKind.MISSED:
            real(self, event, now, since)

    patch.setattr(RemoteNode, "on_heartbeat", hear)


def slow_heartbeats(patch):
    real = Network.__init__

    def init(self, *args, **how):
        real(self, *args, **how)
        self._producer.period_ns *= 10

    patch.setattr(Network, "__init__", init)


def trouble_stops_nobody(patch):
    patch.setattr(CanopenSystem, "_stop_group", lambda self, cause, now, event: None)


def others_go_on(patch):
    def stop(self, cause, now, event):
        cause.stop(now)
        if not cause.node.ready or not cause.machine.enabled:
            cause.give_up()

    patch.setattr(CanopenSystem, "_stop_group", stop)


def targets_too_great(patch):
    real = VelocityTarget.factor
    patch.setattr(VelocityTarget, "factor", lambda self: 1.5 * real(self))


def targets_of_one_joint_held(patch):
    real = VelocityTarget.follow

    def follow(self, value, now, period):
        if self._axis.scale.vel_to_dev > 0 or not self.output.value:
            real(self, value, now, period)

    patch.setattr(VelocityTarget, "follow", follow)


def shafts_overshoot(patch):
    real = DriveLimits.ramp_velocity
    patch.setattr(DriveLimits, "ramp_velocity", lambda self, target, *how: real(self, 1.2 * target, *how))


def shafts_stay_behind(patch):
    real = DriveLimits.ramp_velocity
    patch.setattr(DriveLimits, "ramp_velocity", lambda self, target, up, *how: real(self, target, 0.2 * up, *how))


def commands_outlast_an_enable(patch):
    patch.setattr(UpdateLoop, "_power_changed", lambda self, slot, part, now: None)


def joint_states_stand(patch):
    real = JointStateBroadcaster.update

    def update(self, now, period):
        self.updates = getattr(self, "updates", 0) + 1
        return real(self, now, period) if self.updates < 75 else OK

    patch.setattr(JointStateBroadcaster, "update", update)


def states_told_as_they_were(patch):
    real, first = node_readings._axis, {}
    patch.setattr(node_readings, "_axis", lambda joint: first.setdefault(joint, real(joint)))
    patch.setattr(node_readings._ReadNode, "_inputs", lambda self: (object(),))  # read again each time


def velocities_told_reversed(patch):
    real = status._joints

    def joints(robot):
        return {name: structs.replace(state, velocity=-(state.velocity or 0.0)) for name, state in real(robot).items()}

    patch.setattr(status, "_joints", joints)


def troubles_without_an_event(patch):
    real = RobotCore.report
    patch.setattr(RobotCore, "report", lambda self, event: None if event.node else real(self, event))


def lost_nodes_told_as_ready(patch):
    real = NodeReadings.at

    def nodes(self, now):
        return {name: structs.replace(state, ready=True) for name, state in real(self, now).items()}

    patch.setattr(NodeReadings, "at", nodes)


def gone_clients_hold_commands(patch):
    patch.setattr(RobotCore, "client_disconnected", lambda self, *who: None)


def deaf_clients_are_waited_for(patch):
    def write(self, data):
        self._socket.sendall(data)
        return len(data)

    patch.setattr(Connection, "_write", write)


def deaf_clients_are_kept(patch):
    real = LineServer.__init__

    def init(self, *args, **how):
        real(self, *args, **how)
        self.limit = 1 << 40

    patch.setattr(LineServer, "__init__", init)


def silent_clients_keep_all_places(patch):
    patch.setattr(LineServer, "_make_room", lambda self: False)


MUTANTS = {
    mutant.__name__: mutant
    for mutant in (
        stop_is_late,
        stop_does_nothing,
        enabled_again_when_its_node_is_back,
        enabled_again_after_a_stop,
        reset_chains_into_enable,
        stale_commands,
        latch_does_not_refuse,
        told_as_running,
        told_as_enabled,
        skipped_cycles,
        commands_sent_again_and_again,
        exceptions,
        lost_heartbeats_unnoticed,
        slow_heartbeats,
        trouble_stops_nobody,
        others_go_on,
        targets_too_great,
        targets_of_one_joint_held,
        shafts_overshoot,
        shafts_stay_behind,
        commands_outlast_an_enable,
        joint_states_stand,
        states_told_as_they_were,
        velocities_told_reversed,
        troubles_without_an_event,
        lost_nodes_told_as_ready,
        gone_clients_hold_commands,
        deaf_clients_are_waited_for,
        deaf_clients_are_kept,
        silent_clients_keep_all_places,
    )
}
