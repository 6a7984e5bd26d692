"""Set-points that arrive smoothly: six axes on a trajectory, and a host that is late, at 100 and 250 Hz."""

import functools
import itertools
import random

import pytest
from support.arm6 import ENDS, JOINTS, copy_arm, planned
from support.robots import MS, Bench

from canopen_control.bus.channel import open_port
from canopen_control.controllers.trajectory.goal import Goal, GoalState
from canopen_control.frame import CanFrame, pack_records

NODES = (2, 3, 4, 5, 6, 7)
MOST_LATE = 2 * MS


def arm_at(folder, hertz, keys=""):
    """Copy arm6 with another SYNC period."""
    config = copy_arm(folder)
    edits = {
        "bus.yml": {
            "sync_period: 20000 ": f"sync_period: {1_000_000 // hertz}{keys} ",
            "value: 20}       # interpolation": f"value: {1000 // hertz}}}  # interpolation",
        },
        "ros2_controllers.yaml": {"update_rate: 50 ": f"update_rate: {hertz} "},
    }
    for name, changes in edits.items():
        path = config / name
        text = path.read_text()
        for old, new in changes.items():
            assert old in text, old
            text = text.replace(old, new)
        path.write_text(text)
    return config


class Arm:
    """arm6 on its way along a trajectory; `late` says for each cycle how late the process wakes, in ns."""

    def __init__(self, name, config, *, late=lambda: 0, own_sync=True):
        self.bench = Bench(name, config=config, drives=NODES)
        self.late, self.producer = late, None
        self.produce = lambda until: None
        if not own_sync:
            self._produce(self.bench.robot.pacer.period_ns * 1_000_200 // 1_000_000)  # a clock of 200 ppm less
        self.bench.start()
        self.bench.until(lambda: all(joint.enabled for joint in self.bench.robot.joints.values()))
        self.bench.robot.after_cycle.append(self._after)
        self.bench.run(150)

    def _produce(self, period):
        self.producer = open_port(self.bench.channel, label="producer")
        reactor = self.bench.reactor
        self.due = reactor.now()

        def produce(until):
            while self.due <= until:
                self.producer.send(pack_records([CanFrame(0x80)]))
                self.due += period

        def tick():
            produce(reactor.now())
            reactor.call_at(self.due, tick)

        self.produce = produce
        tick()

    def _after(self, _now):
        """Let the process be busy when the next edge comes; what comes to the port meanwhile waits."""
        bench, pacer = self.bench, self.bench.robot.pacer
        late = self.late()

        def busy():
            self.produce(bench.reactor.now() + late)  # a node goes on meanwhile
            bench.reactor.clock.now_ns += late

        if late:
            bench.reactor.call_at(pacer.edge + pacer.period_ns - 1000, busy)

    def play(self, seconds=0.6, missed=0):
        """Follow a trajectory and return what each drive has got at each SYNC, from its begin to its end."""
        bench = self.bench
        begin = [bench.robot.registry.state(f"{each}/position").value for each in JOINTS]
        goal = Goal(planned(begin, [0.3 * each for each in ENDS], seconds))
        bench.bus.clear_history()
        for node in NODES:
            bench.drives[node].drives[0].meter.restart()
        bench.robot.manager.get("arm_controller").send_goal(goal, bench.reactor.now())
        bench.until(lambda: goal.ended, 4000)
        bench.run(50)  # the last set-points are taken
        assert goal.state is GoalState.SUCCEEDED
        assert bench.robot.pacer.missed <= missed
        return {node: self._taken(0x200 + node) for node in NODES}

    def quality(self, node):
        """Return what a drive says of the set-points of the last trajectory."""
        return self.bench.drives[node].drives[0].meter.tell(1.0)

    def _taken(self, cob_id):
        """Return the set-points that were there at each SYNC: None where none had come since the last one."""
        taken, newest = [], []
        for _, frame in self.bench.bus.history:
            if frame.can_id == cob_id:
                newest.append(int.from_bytes(frame.data[3:7], "little", signed=True))
            elif frame.can_id == 0x80:
                taken.append(newest)
                newest = []
        return taken[1:-1]

    def close(self):
        if self.producer is not None:
            self.producer.close()
        self.bench.close()


@pytest.fixture
def arms():
    made = []

    def make(*args, **how):
        made.append(Arm(*args, **how))
        return made[-1]

    yield make
    for arm in made:
        arm.close()


def ripple(points):
    """Return the standard deviation of the second differences of what a drive got: its acceleration."""
    differences = [c - 2 * b + a for a, b, c in zip(points, points[1:], points[2:], strict=False)]
    mean = sum(differences) / len(differences)
    return (sum((each - mean) ** 2 for each in differences) / len(differences)) ** 0.5


def moving(points):
    """Return the part of a motion between its ends."""
    first = next(place for place, value in enumerate(points) if value != points[0])
    last = next(place for place, value in enumerate(reversed(points)) if value != points[-1])
    return points[first : len(points) - last]


def jitter(seed):
    chance = random.Random(seed)
    return lambda: round(chance.random() * MOST_LATE)


@pytest.fixture(scope="module")
def calm(tmp_path_factory):
    """Return what gives the set-points of a host that is never late, and what its drives say, by the rate."""

    @functools.cache
    def of(hertz):
        arm = Arm(f"calm{hertz}", arm_at(tmp_path_factory.mktemp("calm"), hertz))
        try:
            taken = arm.play()
            return {node: ([points for (points,) in taken[node]], arm.quality(node)) for node in NODES}
        finally:
            arm.close()

    return of


@pytest.mark.parametrize(("hertz", "order"), [(100, "last"), (250, "first")])
def test_a_late_host_sends_the_set_points_of_the_grid_each_once(arms, calm, tmp_path, hertz, order):
    config = arm_at(tmp_path, hertz, f"\n  sync_order: {order}")
    late = arms(f"late{order}{hertz}", config, late=jitter(hertz)).play()
    for node in NODES:
        assert {len(each) for each in late[node]} == {1}, "none lost, none doubled"
        got = [points for (points,) in late[node]]
        sent, wanted = moving(got), moving(calm(hertz)[node][0])
        count = min(len(sent), len(wanted))
        assert abs(len(sent) - len(wanted)) <= 1, "one may lie before the first SYNC that was looked at"
        assert sent[-count:] == wanted[-count:], "to the count what a host that is never late sends"


@pytest.mark.parametrize("hertz", [100, 250])
def test_behind_the_sync_of_a_node_at_200_ppm_a_late_host_loses_and_doubles_none(arms, calm, tmp_path, hertz):
    config = arm_at(tmp_path, hertz, "\n  sync_producer: other\n  sync_order: first")
    arm = arms(f"lateother{hertz}", config, own_sync=False, late=jitter(hertz))
    late = arm.play()
    for node in NODES:
        assert {len(each) for each in late[node]} == {1}, "none lost, none doubled"
        assert arm.bench.joint(node).tracking.skipped == 0
        quality, (wanted, calm_quality) = arm.quality(node), calm(hertz)[node]
        assert (quality.missed, quality.doubled, quality.overwritten) == (0, 0, 0)
        assert quality.acceleration_ripple <= 1.1 * calm_quality.acceleration_ripple, "of what the motor is to do"
        assert ripple(moving([points for (points,) in late[node]])) <= 1.1 * ripple(moving(wanted))


def test_one_set_point_for_each_wake_up_is_what_makes_a_drive_vibrate(arms, calm, tmp_path):
    arm = arms("otherway", arm_at(tmp_path, 250), late=jitter(7))
    robot = arm.bench.robot
    (bus,), components, last = robot.buses.values(), robot.registry.components, [arm.bench.reactor.now()]

    def by_wake_up(now):
        elapsed = (now - last[-1]) / 1e9
        last.append(now)
        for component in components:
            component.read(now, elapsed)
        robot.manager.update(now, elapsed)
        for component in components:
            component.write(now, elapsed)
        bus.send_cycle(now)
        bus.tick(now)
        for hook in robot.after_cycle:
            hook(now)

    robot.pacer.on_edge = by_wake_up
    other = arm.play()
    for node in NODES:
        got = [points for (points,) in other[node]]
        assert ripple(moving(got)) > 10 * ripple(moving(calm(250)[node][0]))


def test_a_cycle_that_is_too_late_for_the_sync_of_a_node_is_told_of_each_joint(arms, tmp_path):
    late = iter([0] * 60 + [4 * MS] + [0] * 1000)
    arm = arms("tolate", arm_at(tmp_path, 250, "\n  sync_producer: other"), own_sync=False, late=lambda: next(late))
    taken = arm.play(missed=1)
    for node in NODES:
        lost = sum(not each for each in taken[node])
        assert lost >= 1
        assert arm.bench.joint(node).tracking.skipped == lost


@pytest.mark.parametrize("order", ["first", "last"])
def test_a_run_tells_how_well_the_joints_followed_and_that_no_set_point_was_missed(arms, tmp_path, order):
    arm = arms(f"told{order}", arm_at(tmp_path, 100, f"\n  sync_order: {order}"), late=jitter(3))
    arm.play()
    for joint in arm.bench.robot.joints.values():
        figures = joint.tracking.figures()
        assert (figures.repeated, figures.skipped) == (0, 0)
        assert 0.0 < figures.rms <= figures.worst == figures.worst_since_enable < 0.02
    quick = max(abs(b[0] - a[0]) for a, b in itertools.pairwise(arm._taken(0x202)))
    assert figures.worst < 0.5 * quick / 1043037.8, "less than the way of a cycle: the dead time of the bus is no error"
