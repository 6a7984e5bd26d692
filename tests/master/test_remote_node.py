"""A node of the master with a virtual drive: entry into READY, and its end."""

import pytest
from support.makers import folder
from support.robots import LEFT, RIGHT, Bench

from canopen_control.cia301.guarding import GuardingEvent, GuardingEventKind
from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.frame import CanFrame
from canopen_control.master.remote_node import RETRY_NS, NodeState
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.testing.tested_robot import TestedRobot


@pytest.fixture
def robby():
    bench = Bench("node")
    bench.start()
    yield bench
    bench.close()


def left(robby):
    return robby.robot.nodes["left_drive"]


def test_ready_means_operational_with_live_process_data(robby):
    node = left(robby)
    assert node.ready
    assert node.nmt_state is NmtState.OPERATIONAL
    assert node.age_ns(robby.reactor.now()) <= 20_000_000
    assert [step.name for step in node.boot_steps] == ["reset", "identify", "configure", "heartbeat", "start"]


def test_a_drive_that_restarts_by_itself_is_reported_stopped_for_and_booted_again(robby):
    robby.hold(10.0, 10.0, ms=300)
    robby.power_off(LEFT)
    robby.power_on(LEFT)
    robby.until(lambda: robby.texts("restarted"))
    robby.until(lambda: left(robby).boots == 2 and left(robby).ready)
    robby.until(lambda: robby.speed(RIGHT) == 0)
    assert "node 3 (left_drive)" in robby.texts("restarted")[0]


def test_a_state_change_that_was_not_commanded_stops_the_robot_and_is_repaired(robby):
    robby.bus.inject(CanFrame(0x000, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, LEFT))))
    robby.until(lambda: robby.texts("nmt"))
    assert "PRE_OPERATIONAL" in robby.texts("nmt")[0]
    robby.until(lambda: left(robby).ready, ms=3000)
    assert left(robby).boots == 2


def test_a_command_of_the_user_is_not_a_fault_and_is_not_repaired(robby):
    left(robby).command(NmtCommand.ENTER_PRE_OPERATIONAL, robby.reactor.now())
    robby.robot.buses["can"].send_waiting()
    robby.run(3000)
    assert left(robby).state is NodeState.WAITING
    assert left(robby).nmt_state is NmtState.PRE_OPERATIONAL
    left(robby).command(NmtCommand.START, robby.reactor.now())
    robby.robot.buses["can"].send_waiting()
    robby.until(lambda: left(robby).ready)


def test_what_was_taken_out_stays_out_when_it_falls_silent_and_its_transfers_continue(robby):
    node, ended = left(robby), []
    node.command(NmtCommand.ENTER_PRE_OPERATIONAL, robby.reactor.now())
    robby.robot.buses["can"].send_waiting()
    robby.run(200)
    robby.bus.cut("drive 3")
    robby.until(lambda: robby.texts("heartbeat_lost"))
    node.read(0x1008, 0, ended.append)
    robby.run(100)
    robby.bus.uncut("drive 3")
    robby.until(lambda: robby.texts("heartbeat_back"))
    assert "taken out" in robby.texts("heartbeat_back")[0]
    robby.until(lambda: ended, ms=3000)
    robby.run(3000)
    assert node.boots == 1
    assert node.state is NodeState.WAITING
    node.command(NmtCommand.START, robby.reactor.now())
    robby.robot.buses["can"].send_waiting()
    robby.until(lambda: node.ready, ms=3000)


def test_silence_longer_than_the_heartbeat_time_is_a_loss_and_its_return_a_boot(robby):
    robby.bus.cut("drive 3")
    lost = robby.until(lambda: robby.texts("heartbeat_lost"))
    assert 400 <= lost <= 520
    assert not left(robby).ready
    assert left(robby).age_ns(robby.reactor.now()) >= 400_000_000
    robby.bus.uncut("drive 3")
    robby.until(lambda: left(robby).ready, ms=4000)


def test_the_nmt_state_is_what_the_node_reported_last_and_unknown_while_it_is_silent(robby):
    node, states = left(robby), []

    def follow(ms):
        for _ in range(ms):
            robby.run(1)
            if states[-1:] != [node.nmt_state]:
                states.append(node.nmt_state)

    for command in (NmtCommand.STOP, NmtCommand.RESET_NODE, NmtCommand.START):
        node.command(command, robby.reactor.now())
        robby.robot.buses["can"].send_waiting()
        follow(1500)
    robby.bus.cut("drive 3")
    follow(1500)
    robby.bus.uncut("drive 3")
    follow(3000)
    booted = [NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL]
    # cut off from its master, the drive has stopped itself: 0x1029
    assert states == [NmtState.OPERATIONAL, NmtState.STOPPED, *booted, None, NmtState.STOPPED, *booted]


def test_jitter_of_the_heartbeat_is_not_a_loss(robby):
    for _ in range(10):
        robby.bus.cut("drive 3")
        robby.run(300)
        robby.bus.uncut("drive 3")
        robby.run(220)
    assert robby.texts("heartbeat_lost") == []


def test_an_sdo_request_of_a_user_is_answered_while_the_robot_runs(robby):
    request = left(robby).sdo.read(0x1018, 1)
    robby.robot.buses["can"].send_waiting()
    robby.until(lambda: request.done)
    assert request.data == (0x286).to_bytes(4, "little")


def test_an_error_that_is_reset_is_discarded(robby):
    robby.bus.inject(CanFrame(0x083, bytes.fromhex("1043090201000000")))
    robby.run(20)
    assert "0x4310" in left(robby).error
    robby.bus.inject(CanFrame(0x083, bytes(8)))
    robby.run(20)
    assert left(robby).error is None
    assert robby.texts("emcy_reset")


def test_a_reset_that_is_to_boot_it_again_does(robby):
    boots = left(robby).boots
    left(robby).command(NmtCommand.RESET_NODE, robby.reactor.now(), boot=True)
    robby.robot.buses["can"].send_waiting()
    assert not left(robby).ready
    robby.until(lambda: left(robby).ready)
    assert left(robby).boots == boots + 1
    assert robby.texts("restarted") == []


def test_a_node_that_does_not_return_from_its_reset_is_looked_for(robby):
    robby.power_off(LEFT)
    left(robby).command(NmtCommand.RESET_NODE, robby.reactor.now(), boot=True)
    robby.robot.buses["can"].send_waiting()
    robby.run(10_000)
    assert not left(robby).ready
    robby.power_on(LEFT)
    robby.until(lambda: left(robby).ready)


def test_a_node_that_a_tpdo_shows_operational_is_shown_so_before_its_next_heartbeat(tmp_path):
    bus = (
        (folder(tmp_path, "csv") / "bus.yml").read_text().replace("heartbeat_producer: 100", "heartbeat_producer: 2000")
    )
    (tmp_path / "bus.yml").write_text(bus)
    robot = TestedRobot(read_robot(find_robot(str(tmp_path))))
    assert robot.state == "running"
    assert {node.nmt_state for node in robot.simulated.core.nodes.values()} == {NmtState.OPERATIONAL}
    assert robot.breaches == []
    robot.close()


def test_a_node_that_is_lost_while_it_is_disabled_is_not_booted_again_and_needs_no_tick(robby):
    node, now = left(robby), robby.reactor.now()
    node.begin_boot(now)
    node.disable(now)
    node.on_guarding(GuardingEvent(GuardingEventKind.MISSED, LEFT), now)
    assert not node.is_disabling
    assert node.disabled is False
    node.tick(now + 5 * RETRY_NS)
    assert node.state is NodeState.WAITING
    deadline = node.next_deadline()
    assert deadline is None or deadline > now + 5 * RETRY_NS, "a deadline in the past would be ticked for ever"
