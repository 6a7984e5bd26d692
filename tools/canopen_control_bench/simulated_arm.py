"""A six-axis arm in simulated time on a host that may be late, with an adapter that may bunch frames.

The host and the drives have a loop and a clock of their own: while the host is late the drives, and a node that sends
SYNC, go on. The adapter hands over what has come, in both directions, at the edges of a grid of its own, as one does
that is asked over USB once a millisecond. Times in ns, steps of `STEP_NS`: no frame is under way for longer.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Final

from canopen_control.bus.channel import open_port
from canopen_control.bus.memory import MemoryBus
from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.trajectory.goal import TrajectoryGoal
from canopen_control.errors import CanopenError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.od.eds import read_eds
from canopen_control.runtime.core import RobotCore, RobotState
from canopen_control.runtime.observer import RobotObserver
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeHost
from canopen_control_bench.arm import CONTROLLER, JOINTS, planned

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from canopen_control.bus.port import Port
    from canopen_control.hardware.joint import JointDrive
    from canopen_control.rpc.messages.drive import SetPointQuality
    from canopen_control.virtual.device_model import DeviceModel
    from canopen_control.virtual.virtual_node import VirtualNode


MS: Final = 1_000_000
STEP_NS: Final = MS // 10
PPM: Final = 200  # clock error of a node that sends SYNC; its clock is slow
_START_NS: Final = 1000 * MS
_SETTLE_MS: Final = 150


class SimulatedArm(RobotObserver):
    """The arm of a folder, enabled: `robot` is the runtime, `drives` are the devices by node-ID, `bus` is their wire.

    `late` says for each cycle by how much the host wakes late, `batch_ns` how often the adapter hands frames over.
    `own_sync`: the host sends SYNC, else somebody does whose clock is `ppm` slow: a node, or a kernel with 0. `model`
    is what the drives are instead of what their EDS says.
    """

    def __init__(
        self, name: str, config: Path, *, own_sync: bool = True, ppm: int = PPM, model: DeviceModel | None = None
    ) -> None:
        self.late: Callable[[], int] = lambda: 0
        self.batch_ns = STEP_NS
        self._clock = ManualClock(_START_NS)
        self.host, self.field = Reactor(self._clock), Reactor(ManualClock(_START_NS))
        self.now = _START_NS
        self._asleep: tuple[int, int] | None = None
        self.bus = MemoryBus.get(name)
        self._errors: list[BaseException] = []
        self.host.on_error = self.field.on_error = self._errors.append
        self._held = contextlib.ExitStack()
        self._held.callback(self.host.close)
        self._held.callback(self.field.close)
        with contextlib.ExitStack() as failed:
            failed.callback(self.close)
            near = f"memory:{name}_host"
            self._near, self._far = self._port(near, "adapter"), self._port(self.bus.channel, "adapter")
            self.robot = RobotCore(read_robot(find_robot(str(config)), name=name, can=[near]), self.host)
            self._held.callback(self.robot.close)
            self.drives = self._power_on(model)
            if not own_sync:
                self._produce_sync(self.robot.pacer.period_ns * (1_000_000 + ppm) // 1_000_000)
            self.robot.observers.append(self)
            self.robot.start()
            self.until(self._moves)
            self.run(_SETTLE_MS)
            failed.pop_all()

    def close(self) -> None:
        """Close the robot and its drives."""
        self._held.close()

    def _port(self, channel: str, label: str) -> Port:
        port = open_port(channel, label=label)
        self._held.callback(port.close)
        return port

    def _power_on(self, model: DeviceModel | None) -> dict[int, VirtualNode]:
        bus = self.robot.setup.bus
        dictionaries = {path: read_eds(path).od for path in set(bus.eds_paths.values())}
        made = {
            node.node_id: make_device(dictionaries[bus.eds_paths[node.name]], node.node_id, model=model)
            for node in bus.nodes.values()
        }
        self._held.callback(NodeHost(self.field, self._port(self.bus.channel, "drives"), list(made.values())).close)
        return made

    def _produce_sync(self, period: int) -> None:
        producer, sync = self._port(self.bus.channel, "producer"), pack_records([CanFrame(0x80)])

        def produce(due: int) -> None:
            producer.send(sync)
            self.field.call_at(due + period, lambda: produce(due + period))

        produce(self.field.now())

    def _moves(self) -> bool:
        robot = self.robot
        return robot.state is RobotState.RUNNING and all(joint.enabled for joint in robot.joints.values())

    # ------------------------------------------------------------------------------------------------------ time

    def run(self, ms: float) -> None:
        """Advance simulated time by milliseconds; exceptions of callbacks are raised here."""
        end = self.now + round(ms * MS)
        while self.now < end:
            if self.now % self.batch_ns == 0:
                self._hand_over(self._near, self._far)
                self._hand_over(self._far, self._near)
            self.now += STEP_NS
            self.field.run_until(self.now)
            self._run_host(self.now)
        if self._errors:
            raise self._errors[0]

    def serve(self) -> None:
        """Process pending events without advancing time."""
        self.host.run_until(self.host.now())

    def until(self, condition: Callable[[], object], ms: float = 8000) -> None:
        """Advance time until `condition` holds; CanopenError after `ms`."""
        end = self.now + round(ms * MS)
        while not condition():
            if self.now >= end:
                raise CanopenError(f"not within {ms} ms: {[event.text for event in self.robot.events.recent][-3:]}")
            self.run(1)

    @staticmethod
    def _hand_over(begin: Port, end: Port) -> None:
        if records := begin.receive():
            end.send(records)

    def _run_host(self, now: int) -> None:
        if self._asleep is not None and self._asleep[0] < now:
            begin, end = self._asleep
            self.host.run_until(max(begin, self._clock.now_ns))
            if now < end:
                return
            self._clock.now_ns = max(end, self._clock.now_ns)
            self._asleep = None
        self.host.run_until(now)

    def after_cycle(self, now: int) -> None:
        """Delay the next cycle as if the host were busy; its edge may move slightly."""
        del now
        late, pacer = self.late(), self.robot.pacer
        if late:
            edge = pacer.edge + pacer.period_ns
            self._asleep = edge - pacer.period_ns // 32, edge + late

    def command_by_wake_up(self) -> None:
        """Use the wake-up time for controllers instead of the grid time: one set-point per wake-up."""
        robot = self.robot
        components, buses, manager, last = robot.registry.components, robot.buses.values(), robot.manager, self.now
        sync_first = [bus for bus in buses if bus.sends_sync_first]
        for bus in buses:
            bus.watch()

        def cycle(now: int) -> None:
            nonlocal last
            elapsed, last = (now - last) / 1e9, now
            for bus in sync_first:
                bus.send_sync(now)
            for component in components:
                component.read(now, elapsed)
            manager.update(now, elapsed)
            for component in components:
                component.write(now, elapsed)
            for bus in buses:
                bus.send_cycle(now)
                bus.tick(now)
            for observer in robot.observers:
                observer.after_cycle(now)

        robot.pacer.on_edge = cycle

    # ---------------------------------------------------------------------------------------------------- motion

    def positions(self) -> list[float]:
        """Return the joint positions in rad."""
        return [self.robot.registry.state(f"{joint}/position").value for joint in JOINTS]

    def send(self, end: Sequence[float], seconds: float, count: int = 50) -> TrajectoryGoal:
        """Send a goal of `count` points from the current joint positions."""
        goal = TrajectoryGoal(planned(self.positions(), end, seconds, count))
        self.robot.send_goal(CONTROLLER, goal, "bench")
        return goal

    def play(self, end: Sequence[float], seconds: float) -> None:
        """Follow a trajectory until its last set-points have been applied; CanopenError if it fails."""
        goal = self.send(end, seconds)
        self.until(lambda: goal.ended, 1000 * seconds + 4000)
        self.run(50)
        if goal.state is not GoalState.SUCCEEDED:
            raise CanopenError(f"the goal was {goal.state.value}: {goal.text}")

    def measure_anew(self) -> None:
        """Reset the set-point statistics of the drives, and the recorded frames."""
        self.bus.clear_history()
        for drive in self.drives.values():
            drive.drives[0].meter.restart()

    def quality(self, node: int) -> SetPointQuality:
        """Return a drive's set-point statistics since the last reset."""
        found = self.drives[node].drives[0].meter.quality(1.0)
        if found is None:
            raise CanopenError(f"node {node} was in no cyclic mode")
        return found

    def taken(self, node: int) -> list[list[int]]:
        """Return the number of set-points at each recorded SYNC: none, one or several."""
        taken: list[list[int]] = []
        newest: list[int] = []
        for _, frame in self.bus.history:
            if frame.can_id == 0x200 + node:
                newest.append(int.from_bytes(frame.data[3:7], "little", signed=True))
            elif frame.can_id == 0x80:
                taken.append(newest)
                newest = []
        return taken[1:-1]

    def joint(self, node: int) -> JointDrive:
        """Return the joint of a node."""
        return next(joint for joint in self.robot.joints.values() if joint.node.node_id == node)
