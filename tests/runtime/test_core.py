"""The whole path, bus.yml to drive and back, in milliseconds of simulated time."""

import itertools
import math

import pytest
from support.generic import write_generic
from support.observers import Observer
from support.robots import FORWARD, LEFT, MS, RIGHT, Bench, copy_robby, split_robby
from support.samples import status_dict
from support.watching import Witness, watch

from canopen_control.bus.channel import open_port
from canopen_control.bus.memory import MemoryBus
from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cia402.state import State
from canopen_control.errors import ControlError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.hardware.axis_statechart import Action
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.runtime.core import RobotCore, RobotState
from canopen_control.runtime.robot_cycle import CAUGHT_UP
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeHost
from canopen_control.virtual.virtual_drive import VirtualDrive

PERIOD = 20 * MS
RPDOS = (0x202, 0x203, 0x302, 0x303)


@pytest.fixture
def benches():
    created = []

    def make(name, **how):
        created.append(Bench(name, **how))
        return created[-1]

    yield make
    for bench in created:
        bench.close()


def delay(bench, *delays_ms):
    """Let the next cycles come late, each by its delay: the process is busy just before the edge."""
    delays = iter(delays_ms)

    def busy():
        bench.reactor.clock.now_ns += round(next(delays, 0.0) * MS)

    def after(now):
        bench.reactor.call_at(bench.robot.pacer.edge + PERIOD - 1000, busy)

    bench.robot.observers.append(Observer(after_cycle=after))


def test_a_late_cycle_gets_the_time_of_its_edge_and_the_period_of_the_grid(benches):
    bench = benches("cycle1")
    bench.start()
    observed = watch(bench)
    delay(bench, *[0.0, 5.0, 0.0, 12.0, 19.0] * 10)
    bench.run(1200)
    assert {later[0] - sooner[0] for sooner, later in itertools.pairwise(observed)} == {PERIOD}
    assert {period for _, period, _ in observed} == {0.02}
    lateness = [now - edge for edge, _, now in observed]
    assert max(lateness) == pytest.approx(19 * MS, abs=1000)
    assert bench.robot.pacer.missed == 0


@pytest.mark.parametrize("edges", [1, 2, 3, 7])
def test_skipped_edges_are_caught_up_in_time_up_to_a_bound_and_reported_with_what_they_cost(benches, edges):
    bench = benches(f"cycle2{edges}")
    bench.start()
    bench.hold(5.0, 5.0, ms=500)
    observed = watch(bench)
    written = []
    bench.robot.registry.register(Witness(on_write=lambda _now, period: written.append(period)))
    delay(bench, 0.0, 20.0 * edges + 1.0)
    bench.publish(5.0, 5.0)
    bench.run(1500)
    assert set(written) == {0.02}, "no target moves by more than the drive can go in a period"
    longest = max(period for _, period, _ in observed)
    assert longest == pytest.approx(0.02 * (1 + min(edges, CAUGHT_UP)))
    assert max(later[0] - sooner[0] for sooner, later in itertools.pairwise(observed)) == (1 + edges) * PERIOD
    (event,) = [item for item in bench.events if item.kind == "cycle_missed"]
    assert event.count == edges
    cost = f"set-points that moving axes missed since they were enabled: left_wheel_joint {edges}"
    assert cost in event.text
    assert bench.joint(LEFT).tracking.skipped == edges


def test_what_stands_misses_nothing_when_edges_are_skipped(benches):
    bench = benches("cycle3")
    bench.start()
    delay(bench, 0.0, 50.0)
    bench.run(300)
    (event,) = [item for item in bench.events if item.kind == "cycle_missed"]
    assert "moving axes" not in event.text


def frames_of(bench):
    """Return what the master sent, as "S" for SYNC and "R" for an RPDO, in order."""
    kinds = {0x80: "S", **dict.fromkeys(RPDOS, "R")}
    return "".join(kinds.get(frame.can_id, "") for label, frame in bench.bus.history if label == "master")


def syncs_of(bench):
    return [frame for label, frame in bench.bus.history if label == "master" and frame.can_id == 0x80]


def test_sync_last_is_the_default_and_goes_behind_the_rpdos_of_its_cycle(benches):
    bench = benches("order1")
    bench.start()
    bench.hold(5.0, 5.0, ms=500)
    assert "RRS" in frames_of(bench)
    assert bench.robot.buses["can"].sync_words == "SYNC every 20 ms, after the RPDOs of its cycle (sync_order: last)"


def test_sync_first_begins_the_cycle_and_its_rpdos_follow_at_once(benches, tmp_path):
    config = copy_robby(tmp_path, bus={"sync_period: 20000": "sync_period: 20000\n  sync_order: first"})
    bench = benches("order2", config=config)
    bench.start()
    order = []
    count = bench.robot.pacer

    def on_read(_now, _period):
        order.append(len(syncs_of(bench)) - count.count)

    bench.robot.registry.register(Witness(on_read=on_read))
    bench.hold(10.0, -10.0, ms=1000)
    assert set(order) == {0}, "as many as cycles have begun, before anything is read"
    assert [bench.velocity(node) for node in (LEFT, RIGHT)] == pytest.approx([10.0, -10.0], rel=0.01)
    assert len(syncs_of(bench)) == bench.robot.pacer.count
    assert bench.texts("feedback_stale") == []
    assert bench.robot.buses["can"].sync_words.endswith("before the RPDOs of its cycle (sync_order: first)")


def test_a_tpdo_that_stays_away_is_noticed_with_sync_first_as_well(benches, tmp_path):
    config = copy_robby(tmp_path, bus={"sync_period: 20000": "sync_period: 20000\n  sync_order: first"})
    bench = benches("order3", config=config)
    bench.start()
    bench.hold(5.0, 5.0, ms=300)
    bench.power_off(LEFT)
    bench.until(lambda: bench.texts("stop"), 1500)
    bench.run(1500)
    assert bench.speed(RIGHT) == 0


@pytest.mark.parametrize(("order", "behind"), [("last", PERIOD // 2), ("first", PERIOD // 8)])
def test_the_cycle_follows_the_sync_of_a_node(benches, tmp_path, order, behind):
    keys = f"sync_period: 20000\n  sync_producer: other\n  sync_order: {order}"
    bench = benches(f"other{order}", config=copy_robby(tmp_path, bus={"sync_period: 20000": keys}))
    port, period = open_port(bench.channel, label="producer"), PERIOD + 4000  # 200 ppm slower

    def produce():
        port.send(pack_records([CanFrame(0x80)]))
        bench.reactor.call_later(period, produce)

    produce()
    sent = bench.reactor.now()
    cycles = []
    bench.robot.observers.append(Observer(after_cycle=cycles.append))
    bench.start()
    bench.hold(10.0, -10.0, ms=2000)
    assert [bench.velocity(node) for node in (LEFT, RIGHT)] == pytest.approx([10.0, -10.0], rel=0.01)
    assert {label for label, frame in bench.bus.history if frame.can_id == 0x80} == {"producer"}
    phases = [(cycle - sent) % period for cycle in cycles[-50:]]
    assert all(abs(phase - behind) <= PERIOD // 64 for phase in phases)
    assert bench.texts("sync_lost") == []
    assert "by another node" in bench.robot.buses["can"].sync_words
    port.close()


PPS = 1600 / (2 * math.pi)  # microsteps per radian, as bus.yml configures the drives
RAMP_S = 10 * PPS / 16000  # to 10 rad/s at the configured acceleration


@pytest.fixture
def bench(request):
    benches = []

    def make(**how):
        benches.append(Bench(f"core{abs(hash(request.node.nodeid)) % 10**8}", **how))
        return benches[-1]

    yield make
    for benche in benches:
        benche.close()


@pytest.fixture
def robby(bench):
    robby = bench()
    robby.start()
    return robby


def test_both_drives_boot_in_parallel_and_are_enabled_only_once_the_controller_is_active(bench):
    robby = bench()
    enabled = []
    robby.robot.observers.append(
        Observer(
            after_cycle=lambda now: enabled.append(
                (
                    any(drive.get(0x6041) & 0x6F == 0x27 for drive in robby.drives.values()),
                    FORWARD in robby.robot.manager.active,
                )
            )
        )
    )
    assert robby.start() < 500
    assert (True, False) not in enabled
    assert (True, True) in enabled
    assert all(joint.enabled for joint in robby.robot.joints.values())


def test_the_wheels_reach_ten_rad_per_second_along_the_drives_own_ramp(robby):
    robby.command(10.0, 10.0)
    halfway = robby.until(lambda: robby.speed(RIGHT) >= 5 * PPS)
    full = robby.until(lambda: robby.speed(RIGHT) >= 9.99 * PPS) + halfway
    assert halfway == pytest.approx(full / 2, abs=12)
    assert full / 1000 == pytest.approx(RAMP_S, abs=0.03)
    robby.run(100)
    assert robby.velocity(LEFT) == pytest.approx(10.0, rel=0.01)
    assert robby.velocity(RIGHT) == pytest.approx(10.0, rel=0.01)


def test_the_mirrored_drive_turns_the_other_way_and_its_wheel_the_same(robby):
    robby.hold(10.0, 10.0, ms=500)
    assert robby.speed(LEFT) == -robby.speed(RIGHT)
    left, right = (robby.joint(node).states["position"].value for node in (LEFT, RIGHT))
    assert left == pytest.approx(right, abs=0.01)
    assert left > 1.0


def test_position_and_velocity_agree(robby):
    robby.hold(10.0, 10.0, ms=1000)
    before = robby.joint(RIGHT).states["position"].value
    robby.hold(10.0, 10.0, ms=1000)
    assert robby.joint(RIGHT).states["position"].value - before == pytest.approx(10.0, rel=0.01)


def test_without_commands_the_wheels_stop_after_the_timeout_of_the_controller(robby):
    robby.command(10.0, 10.0)
    robby.run(1900)
    assert robby.velocity(LEFT) == pytest.approx(10.0, rel=0.01)
    robby.run(300 + 1000 * RAMP_S)
    assert robby.speed(LEFT) == robby.speed(RIGHT) == 0
    assert robby.texts("command_timeout")


def test_a_publisher_of_one_hertz_keeps_them_turning(robby):
    robby.command(10.0, 10.0)
    slowest = math.inf
    for _ in range(4):
        robby.run(500)
        slowest = min(slowest, robby.velocity(LEFT))
        robby.run(500)
        robby.command(10.0, 10.0)
    assert slowest == pytest.approx(10.0, rel=0.01)


@pytest.mark.parametrize("values", [[math.nan, 1.0], [math.inf, 1.0], [1.0], [1.0, 2.0, 3.0], []])
def test_a_bad_command_is_refused_and_changes_nothing(robby, values):
    robby.hold(5.0, 5.0, ms=300)
    with pytest.raises(ControlError):
        robby.robot.command(FORWARD, values, "test")
    robby.run(100)
    assert robby.velocity(LEFT) == pytest.approx(5.0, rel=0.01)


def test_shutdown_ramps_disables_and_leaves_the_drives_in_peace(robby):
    robby.hold(10.0, 10.0, ms=500)
    robby.robot.shutdown("test")
    fastest_step = 0
    last = robby.speed(RIGHT)
    while robby.robot.state is not RobotState.STOPPED:
        robby.run(10)
        fastest_step = max(fastest_step, last - robby.speed(RIGHT))
        last = robby.speed(RIGHT)
    assert fastest_step <= 16000 * 0.01 * 1.05, "a ramp, no jump"
    robby.run(3000)
    for drive in robby.drives.values():
        assert drive.get(0x6041) & 0x4F == 0x40, "switch on disabled"
        assert drive.get(0x1001) == 0, "no heartbeat error: the drives no longer wait for this master"
    assert robby.robot.failure is None


@pytest.mark.sources
def test_a_drive_that_may_have_power_at_the_end_still_watches_the_master_and_stops_by_itself(robby, monkeypatch):
    robby.hold(10.0, 10.0, ms=500)
    monkeypatch.setattr(robby.drives[LEFT].drives[0].power, "obey", lambda *_: None)
    since = len(robby.bus.history)
    robby.robot.shutdown("a test")
    robby.until(lambda: robby.texts("stopped"), ms=20_000)
    assert "left_drive obeyed no stop command and may have power" in robby.robot.failure
    commands = [frame.data for label, frame in robby.bus.history[since:] if label == "master" and frame.can_id == 0]
    # NMT stop; reset communication, which clears the heartbeat consumer
    assert commands == [bytes((0x02, LEFT)), bytes((0x82, RIGHT))]
    robby.run(1000)
    assert robby.drives[LEFT].get(0x6041) & 0x4F == 0x08, "fault"


def test_stop_is_answered_at_standstill_and_only_enable_permits_motion_again(robby):
    robby.hold(10.0, 10.0, ms=300)
    answers = []
    robby.robot.stop(answers.append)
    robby.until(lambda: answers)
    assert answers == [None]
    assert robby.speed(LEFT) == 0
    robby.hold(10.0, 10.0, ms=500)
    assert robby.speed(LEFT) == 0
    robby.robot.axis(Action.ENABLE, "all", answers.append)
    robby.until(lambda: len(answers) == 2)
    robby.hold(10.0, 10.0, ms=500)
    assert robby.velocity(LEFT) == pytest.approx(10.0, rel=0.01)


def test_a_drive_that_loses_its_bus_stops_the_other_within_its_heartbeat_time(robby):
    robby.hold(10.0, 10.0, ms=500)
    robby.power_off(LEFT)
    lost = robby.until(lambda: robby.texts("heartbeat_lost"))
    assert lost <= 520
    robby.until(lambda: robby.speed(RIGHT) == 0)
    robby.until(lambda: robby.drives[RIGHT].get(0x6041) & 0x6F != 0x27)
    assert robby.robot.state is RobotState.FAULT
    assert "node 3 (left_drive)" in robby.texts("heartbeat_lost")[0]
    assert any("right_wheel_joint" in text for text in robby.texts("stop"))


def test_a_drive_that_returns_is_booted_by_itself_and_waits_for_an_enable(robby):
    robby.hold(10.0, 10.0, ms=500)
    position = robby.joint(LEFT).states["position"].value
    robby.power_off(LEFT)
    robby.until(lambda: robby.robot.state is RobotState.FAULT)
    robby.run(1000)
    robby.power_on(LEFT)
    robby.until(lambda: robby.robot.state is RobotState.DISABLED)
    robby.hold(5.0, 5.0, ms=500)
    assert robby.speed(LEFT) == robby.speed(RIGHT) == 0
    assert robby.joint(LEFT).states["position"].value == pytest.approx(position, abs=10.0)
    answers = []
    robby.robot.axis(Action.ENABLE, "all", answers.append)
    robby.until(lambda: answers)
    assert answers == [None]
    robby.hold(5.0, 5.0, ms=500)
    assert robby.velocity(LEFT) == pytest.approx(5.0, rel=0.01)


def test_a_drive_that_faults_stops_the_robot_and_is_named_with_its_emcy(robby):
    robby.hold(10.0, 10.0, ms=500)
    robby.drives[RIGHT].drives[0].fault(0x4310, robby.reactor.now())
    robby.hosts[RIGHT].wake(robby.drives[RIGHT])
    robby.until(lambda: robby.texts("stop"))
    robby.until(lambda: robby.speed(LEFT) == 0)
    assert "node 2 (right_drive)" in robby.texts("stop")[0]
    assert any("0x4310" in text for text in robby.texts("emcy"))
    assert robby.robot.state is RobotState.FAULT
    answers = []
    with pytest.raises(Exception, match="fault"):
        robby.robot.axis(Action.ENABLE, "right_drive", answers.append)


def test_garbage_on_the_bus_changes_nothing_but_a_counter(robby):
    robby.command(10.0, 10.0)
    robby.run(300)
    network = robby.robot.buses["can"].network
    before = network.unknown
    port = robby.bus.open("noise")
    for number in range(0x7FF):
        if not network.image.inputs.get(number) and number & 0x780 not in (
            0x000,
            0x080,
            0x180,
            0x200,
            0x280,
            0x300,
            0x600,
        ):
            robby.bus.inject(CanFrame(number, bytes((number * k & 0xFF) for k in range(number % 9))))
    port.close()
    robby.run(300)
    assert network.unknown > before
    assert robby.velocity(LEFT) == pytest.approx(10.0, rel=0.01)
    assert robby.robot.state is RobotState.RUNNING


def test_a_missing_drive_fails_the_start_by_name_and_stops_the_other(bench):
    robby = bench(drives=(RIGHT,))
    robby.robot.start()
    robby.until(lambda: robby.robot.state is RobotState.STOPPED, ms=20_000)
    assert "node 3 (left_drive)" in robby.robot.failure
    assert "right_drive" not in robby.robot.failure


def test_a_bus_without_an_answer_names_all_of_them(bench):
    robby = bench(drives=())
    robby.robot.start()
    robby.until(lambda: robby.robot.state is RobotState.STOPPED, ms=20_000)
    assert "left_drive" in robby.robot.failure
    assert "right_drive" in robby.robot.failure


def test_the_wrong_device_at_a_node_id_is_refused(bench, tmp_path):
    config = copy_robby(tmp_path, bus={'  dcf: "TMCM-1270.eds"': '  dcf: "TMCM-1270.eds"\n  serial_number: 99'})
    robby = bench(config=config)
    robby.robot.start()
    robby.until(lambda: robby.robot.state is RobotState.STOPPED, ms=20_000)
    assert "boot error O" in robby.robot.failure


def test_without_the_consumer_reaction_the_drives_would_turn_on(bench, tmp_path):
    """Why 0x1029:1 = 2 is written: the factory setting only leaves operational, and the motor goes on."""
    turned_off = "error_behavior: {1: 0}\n  allow_unsupervised: true"
    config = copy_robby(tmp_path, bus={"error_behavior: {1: 2}": turned_off})
    for which, stops in ((str(config), False), ("robby", True)):
        robby = bench(config=which)
        robby.start()
        robby.hold(10.0, 10.0, ms=500)
        robby.robot.pacer.stop()
        robby.robot.buses["can"].close()
        robby.run(500 + 1000 * RAMP_S + 20)
        assert (robby.speed(RIGHT) == 0) is stops
        robby.close()


def test_the_unmodified_bus_of_the_tutorial_boots_and_turns(bench, tmp_path):
    config = copy_robby(tmp_path)
    (config / "bus.yml").write_text(
        (__import__("pathlib").Path(__file__).parents[1] / "data/robby_tutorial/bus.yml").read_text()
    )
    robby = bench(config=config)
    robby.robot.start()
    robby.until(lambda: robby.robot.state is RobotState.RUNNING)
    robby.hold(10.0, 10.0, ms=800)
    assert robby.velocity(LEFT) == pytest.approx(10.0, rel=0.01)


def test_one_robot_on_two_buses_drives_both_wheels_in_one_cycle(tmp_path):
    buses = MemoryBus.get("two-left"), MemoryBus.get("two-right")
    reactor = Reactor(ManualClock(1_000_000_000))
    setup = read_robot(find_robot(str(split_robby(tmp_path))), can=["memory:two-left", "right=memory:two-right"])
    core = RobotCore(setup, reactor)
    hosted = []
    for name, node_id in (("can", LEFT), ("right", RIGHT)):
        port = open_port(setup.channels[name], label=f"drive {node_id}")
        device = make_device(next(iter(setup.buses[name].eds_paths.values())), node_id)
        hosted.append((device, port, NodeHost(reactor, port, [device])))
    try:
        core.start()
        reactor.run_for(2_000_000_000)
        assert core.state is RobotState.RUNNING, core.failure
        for _ in range(10):
            core.command(FORWARD, [10.0, 10.0], "test")
            reactor.run_for(100_000_000)
        left, right = (device.get(0x606C) for device, _, _ in hosted)
        assert left == -right != 0
        status = status_dict(core)
        assert {name: node["bus"] for name, node in status["nodes"].items()} == {
            "left_drive": "can",
            "right_drive": "right",
        }
        assert {bus: state["channel"] for bus, state in status["buses"].items()} == {
            "can": "memory:two-left",
            "right": "memory:two-right",
        }
        syncs = [sum(frame.can_id == 0x80 for _, frame in bus.history) for bus in buses]
        assert syncs[0] == syncs[1] > 100
    finally:
        core.close()
        for _, port, host in hosted:
            host.close()
            port.close()
        reactor.close()


def test_sdo_traffic_of_each_node_is_in_the_status(robby):
    sdo = status_dict(robby.robot)["nodes"]["left_drive"]["sdo"]
    requested = [
        frame.data[0] >> 5
        for label, frame in robby.bus.history
        if label == "master" and frame.can_id == 0x600 + LEFT and frame.data[0] >> 5 in (1, 2)
    ]
    assert (sdo["writes"], sdo["reads"], sdo["failed"]) == (requested.count(1), requested.count(2), 0)
    assert sdo["writes"] > 30


def test_an_optional_node_is_not_waited_for_and_joins_when_it_appears(bench, tmp_path):
    config = copy_robby(tmp_path, bus={"nodes:\n": "nodes:\n  lift:\n    node_id: 9\n    mandatory: false\n"})
    robby = bench(config=config)
    robby.start()
    lift = robby.robot.nodes["lift"]
    assert not lift.ready
    assert robby.robot.state is RobotState.RUNNING
    robby.power_on(9)
    robby.until(lambda: lift.ready)
    assert robby.robot.state is RobotState.RUNNING


@pytest.mark.rest
def test_with_boot_time_0_a_required_node_is_waited_for_for_ever(bench, tmp_path):
    config = copy_robby(tmp_path, bus={"sync_period: 20000": "sync_period: 20000\n  boot_time: 0"})
    robby = bench(config=config, drives=(LEFT,))
    robby.robot.start()
    robby.run(30_000)
    assert robby.robot.state is RobotState.STARTING
    robby.power_on(RIGHT)
    robby.until(lambda: robby.robot.state is RobotState.RUNNING)


def test_a_drive_that_was_left_operational_is_reset_before_it_is_configured(bench):
    robby = bench()
    for drive in robby.drives.values():
        drive.receive(CanFrame(0x000, bytes((1, drive.node_id))), robby.reactor.now())
    robby.start()
    for node_id in (LEFT, RIGHT):
        mine = [
            frame
            for label, frame in robby.bus.history
            if label == "master" and (frame.can_id == 0x600 + node_id or frame.data[1:2] == bytes((node_id,)))
        ]
        assert str(mine[0]) == f"000#82{node_id:02X}"


def test_a_second_boot_of_a_drive_writes_only_what_a_reset_took_from_it(robby):
    node = robby.robot.nodes["left_drive"]
    first = node.identity
    node.begin_boot(robby.reactor.now())
    robby.robot.buses["can"].send_waiting()
    robby.until(lambda: node.boots == 2 and node.ready)
    assert node.identity.writes < first.writes
    assert node.identity.reads < first.reads


def test_a_robot_runs_without_a_wheel_that_is_not_required_but_moves_none_before_it_is_there(bench, tmp_path):
    config = copy_robby(tmp_path, bus={"    node_id: 2\n": "    node_id: 2\n    required: false\n"})
    robby = bench(config=str(config), drives=(LEFT,))
    assert robby.start() < 1500
    robby.hold(5.0, 5.0, ms=1000)
    assert not robby.robot.joints["left_wheel_joint"].enabled
    robby.power_on(RIGHT)
    robby.until(lambda: all(joint.enabled for joint in robby.robot.joints.values()))


AT_THE_END = {
    "axis enable": lambda robot: robot.axis(Action.ENABLE, "all", print),
    "axis home": lambda robot: robot.axis(Action.HOME, "left_drive", print),
    f"activating {FORWARD}": lambda robot: robot.switch([FORWARD], [], strict=True),
    f"a command to {FORWARD}": lambda robot: robot.command(FORWARD, [1.0, 1.0], "test"),
    "a goal to arm": lambda robot: robot.send_goal("arm", None, "test"),
}


@pytest.mark.parametrize("what", AT_THE_END)
def test_what_would_enable_or_move_is_refused_while_the_robot_stops_and_the_stop_ends(robby, what):
    robby.hold(5.0, 5.0, ms=500)
    robby.robot.shutdown("a test")
    robby.run(40)
    with pytest.raises(ControlError, match=f"^{what} is refused: the robot is stopping$"):
        AT_THE_END[what](robby.robot)
    robby.until(lambda: robby.texts("stopped"), ms=1000)
    assert robby.texts("stopped") == ["robby has stopped, its drives are disabled"]


@pytest.mark.parametrize("action", [Action.DISABLE, Action.HALT, Action.QUICK_STOP, Action.FAULT_RESET])
def test_what_stops_is_never_refused(robby, action):
    robby.robot.shutdown("a test")
    robby.robot.axis(action, "all", lambda _error: None)
    robby.robot.stop(lambda _error: None)
    robby.until(lambda: robby.texts("stopped"), ms=1000)
    assert robby.texts("stopped") == ["robby has stopped, its drives are disabled"]


def test_a_stop_in_the_last_cycle_has_succeeded(robby):
    robby.robot.shutdown("a test")
    robby.until(lambda: all(system.stopped for system in robby.robot.systems))
    answers = []
    robby.robot.stop(answers.append)
    assert robby.texts("stopped") == []
    robby.until(lambda: robby.texts("stopped"), ms=100)
    assert answers == [None]


def test_a_wheel_that_never_booted_is_not_a_doubt_about_the_stop(bench, tmp_path):
    config = copy_robby(tmp_path, bus={"    node_id: 2\n": "    node_id: 2\n    required: false\n"})
    robby = bench(config=str(config), drives=(LEFT,))
    robby.start()
    robby.robot.shutdown("a test")
    robby.until(lambda: robby.texts("stopped"))
    assert robby.texts("stopped") == ["robby has stopped, right_drive was not booted"]
    assert robby.robot.failure is None


def test_a_start_that_is_interrupted_while_the_nodes_boot_has_not_failed(bench):
    robby = bench(drives=())
    robby.robot.start()
    robby.until(lambda: robby.robot.nodes["left_drive"].boot_step)
    robby.robot.shutdown("a test")
    robby.until(lambda: robby.texts("stopped"))
    assert robby.texts("stopped") == ["robby has stopped, left_drive, right_drive were not booted"]
    assert robby.robot.failure is None


def test_a_stop_begins_in_the_next_cycle_and_takes_the_command_back(robby):
    robby.command(10.0, 10.0)
    robby.until(lambda: robby.speed(RIGHT) >= 9 * PPS)
    robby.robot.stop(lambda _error: None, by="the test")
    assert not robby.robot.manager.get(FORWARD).command_timeout.live  # at once, whatever the drives do
    robby.run(60)
    assert robby.speed(RIGHT) < 9 * PPS


def test_a_client_that_leaves_takes_no_latch_along(robby):
    robby.robot.stop(lambda _error: None, "who latched it")
    for holder in (object(), None):
        robby.robot.client_disconnected(holder)
    assert robby.robot.latch.by == "who latched it"


def show_no_mode_while_off(monkeypatch, shown):
    """Let virtual drives show mode 0 (0x6061) while they are off, and `shown` of their own while they are enabled."""
    attach = VirtualDrive._attach

    def attached(drive):
        attach(drive)
        own = drive._store.source_of(0x6061, 0)
        drive._store.on_read(0x6061, 0, lambda: shown(own()) if drive.state is State.OPERATION_ENABLED else 0)

    monkeypatch.setattr(VirtualDrive, "_attach", attached)


@pytest.mark.sources
def test_a_drive_that_shows_no_mode_until_it_is_enabled_is_enabled_and_moves(bench, monkeypatch):
    show_no_mode_while_off(monkeypatch, lambda mode: mode)
    robby, answers = bench(), []
    robby.start()
    assert robby.robot.state is RobotState.RUNNING
    for _ in range(2):
        robby.hold(10.0, 10.0, ms=1500)
        assert robby.velocity(LEFT) == pytest.approx(10.0, rel=0.02)
        robby.robot.axis(Action.DISABLE, "all", answers.append)
        robby.until(lambda: robby.speed(LEFT) == 0 and robby.robot.state is RobotState.DISABLED)
        robby.run(3000)  # longer than a mode may take: that it shows none is no news while it is off
        robby.robot.axis(Action.ENABLE, "all", answers.append)
        robby.until(lambda: robby.robot.state is RobotState.RUNNING)
    assert not [event for event in robby.events if "not confirmed" in event.text]


@pytest.mark.sources
def test_a_drive_that_is_enabled_and_never_shows_its_mode_is_disabled_again_and_has_not_moved(bench, monkeypatch):
    show_no_mode_while_off(monkeypatch, lambda _: 0)
    robby = bench()
    robby.robot.start()
    robby.until(lambda: any("mode PV not confirmed, 0x6061 shows NONE" in event.text for event in robby.events), 15000)
    robby.until(lambda: robby.joint(LEFT).machine.state is not State.OPERATION_ENABLED)
    assert robby.robot.state is not RobotState.RUNNING
    assert [robby.drives[node].get(0x6064) for node in (LEFT, RIGHT)] == [0, 0]


def turning_without_master(make, folder):
    """Return a bench whose drives turn on after their master has died, as with 0x6007 = 0, and a new robot for it."""
    config = write_generic(folder, modes="velocity_mode: 3")
    bench = make(f"left{id(folder)}", config=config, drives=(2, 3), controllers=["velocity"])
    bench.start()
    for _ in range(5):
        bench.robot.command("velocity", [2.0, 2.0], "test")
        bench.run(100)
    bench.robot.close()
    for drive in bench.drives.values():
        drive.store.set(0x6007, 0, 0)  # CiA 402-2: no reaction to a lost master, nor to a reset of the communication
    bench.robot = RobotCore(bench.setup, bench.reactor)
    bench.events.clear()
    bench.robot.observers.append(Observer(event=bench.events.append))
    assert abs(bench.speed(2)) > 1000
    return bench


@pytest.mark.parametrize("ms", [0, 1, 8, 12, 100])
def test_drives_that_an_earlier_master_left_turning_are_disabled_although_the_boot_is_interrupted(
    benches, tmp_path, ms
):
    bench = turning_without_master(benches, tmp_path)
    bench.robot.start()
    bench.run(ms)
    assert not any(node.ready for node in bench.robot.nodes.values())
    bench.robot.shutdown("SIGINT")
    bench.until(lambda: bench.robot.state is RobotState.STOPPED)
    assert bench.texts("stopped") == ["generic has stopped, its drives are disabled"]
    assert bench.robot.failure is None
    bench.run(1000)
    assert [drive.get(0x6041) & 0x04 for drive in bench.drives.values()] == [0, 0]
    assert [bench.speed(node) for node in bench.drives] == [0, 0]


def test_a_drive_that_refuses_to_be_disabled_during_its_boot_is_reported_and_keeps_its_monitoring(benches, tmp_path):
    def refuse(_entry, _value):
        raise SdoServerAbort(AbortCode.DEVICE_STATE)

    bench = turning_without_master(benches, tmp_path)
    bench.drives[2].store.guard([0x6040], refuse)
    bench.robot.start()
    bench.run(12)
    bench.robot.shutdown("SIGINT")
    bench.until(lambda: bench.robot.state is RobotState.STOPPED, 10_000)
    assert "could not confirm that drive_one is disabled" in bench.robot.failure
    (event,) = [event for event in bench.events if event.kind == "not_disabled"]
    assert "node 2 (drive_one): could not be disabled" in event.text
    assert "it refuses 0x6040:00" in event.text
    assert not bench.drives[3].get(0x6041) & 0x04
    resets = [frame for label, frame in bench.bus.history if label == "master" and frame.data[:1] == b"\x82"]
    assert [frame.data[1] for frame in resets] == [2, 3, 2, 3, 3], "two boots; the other one alone is released"


@pytest.mark.parametrize(("boot_ms", "longest_ms"), [(1000, 2100), (20_000, 11_100)])
def test_a_run_without_drives_ends_soon_after_it_is_interrupted(benches, tmp_path, boot_ms, longest_ms):
    config = write_generic(tmp_path, extra=f"boot_timeout_ms: {boot_ms}")
    bench = benches("none", config=config, drives=(), controllers=["velocity"])
    bench.robot.start()
    bench.run(12)
    bench.robot.shutdown("SIGINT")
    assert bench.until(lambda: bench.robot.state is RobotState.STOPPED, 20_000) <= longest_ms
    assert bench.texts("stopped") == ["generic has stopped, drive_one, drive_two were not booted"]
    assert bench.robot.failure is None


def test_the_drives_of_the_other_bus_are_ramped_down_if_one_of_two_buses_is_lost(tmp_path):
    buses = MemoryBus.get("one-left"), MemoryBus.get("one-right")
    reactor = Reactor(ManualClock(1_000_000_000))
    setup = read_robot(find_robot(str(split_robby(tmp_path))), can=["memory:one-left", "right=memory:one-right"])
    core, events = RobotCore(setup, reactor), []
    core.observers.append(Observer(event=events.append))
    left_port = open_port(setup.channels["can"], label="left")
    left = make_device(next(iter(setup.buses["can"].eds_paths.values())), LEFT)
    right_port = open_port(setup.channels["right"], label="right")
    right = make_device(next(iter(setup.buses["right"].eds_paths.values())), RIGHT)
    hosts = NodeHost(reactor, left_port, [left]), NodeHost(reactor, right_port, [right])
    try:
        core.start()
        reactor.run_for(2_000_000_000)
        for _ in range(10):
            core.command(FORWARD, [10.0, 10.0], "test")
            reactor.run_for(100_000_000)
        before = left.get(0x606C)
        buses[1].close()
        reactor.run_for(100_000_000)  # the drive would notice the missing heartbeat after 500 ms
        assert 0 < abs(left.get(0x606C)) < 0.8 * abs(before)
        reactor.run_for(1_000_000_000)
        assert core.state is RobotState.STOPPED
        assert left.get(0x606C) == 0
        assert left.get(0x6041) & 0x4F == 0x40, "disabled, not in the fault of a lost master"
        assert "memory:one-right" in core.failure
        (stopped,) = [event.text for event in events if event.kind == "stopped"]
        assert "could not confirm that right_drive is disabled" in stopped
    finally:
        core.close()
        for part in (*hosts, left_port, right_port, reactor):
            part.close()


@pytest.mark.parametrize("restarts", [False, True])
def test_a_node_with_boot_false_is_left_to_the_master_of_another_robot(benches, tmp_path, restarts):
    bench = benches("theirs", config=write_generic(tmp_path, modes="velocity_mode: 3"), drives=(2, 3))
    bench.start()
    (tmp_path / "ours").mkdir()
    config = write_generic(tmp_path / "ours", joints=("one",), modes="velocity_mode: 3\nboot: false")
    core = RobotCore(read_robot(find_robot(str(config)), can=["memory:theirs"]), bench.reactor)
    since = len(bench.bus.history)
    core.start()
    bench.run(1000)
    if restarts:
        bench.robot.nodes["drive_one"].command(NmtCommand.RESET_NODE, bench.reactor.now(), boot=True)
        bench.run(3000)
    assert core.nodes["drive_one"].nmt_state is NmtState.OPERATIONAL
    assert bench.joint(2).node.ready
    powered = bench.drives[2].get(0x6041) & 0x04
    assert bool(powered) is not restarts
    core.shutdown("SIGINT")
    bench.until(lambda: core.state is RobotState.STOPPED)
    bench.run(500)
    assert bench.drives[2].get(0x6041) & 0x04 == powered
    ours = [frame for label, frame in bench.bus.history[since:] if label == "master" and frame.can_id == 0]
    assert [frame.data for frame in ours] == ([b"\x81\x02", b"\x01\x02"] if restarts else [])
    core.close()
