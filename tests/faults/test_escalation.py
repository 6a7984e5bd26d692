"""A drive that ignores commands: escalation of its stop, and the reports at the end."""

import pytest
from support.faultbench import LEFT, RIGHT, FaultBench
from support.robots import copy_robby

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.errors import RobotConfigError
from canopen_control.hardware.axis_statechart import Action, AxisPhase

RPDOS = [base + LEFT for base in (0x200, 0x300, 0x400, 0x500)]
SDO_REQUESTS = 0x600 + LEFT
DEVICE = '<param name="device_name">${side}_drive</param>'


@pytest.fixture
def turning(request, tmp_path):
    created = []

    def make(**edits):
        name = f"escalation{abs(hash(request.node.nodeid)) % 10**9}"
        created.append(FaultBench(name, config=copy_robby(tmp_path, **edits)))
        return created[-1].turning()

    yield make
    for bench in created:
        bench.close()


def deaf(bench):
    """Let the left drive receive no RPDO and no SDO request any more; returns its joint."""
    bench.bus.drop(lambda _label, frame: frame.can_id in (*RPDOS, SDO_REQUESTS))
    return bench.joint(LEFT)


@pytest.mark.rest
def test_a_drive_that_does_not_stop_is_commanded_to_quick_stop_then_to_disable_voltage(turning):
    bench = turning()
    joint = deaf(bench)
    bench.robot.stop(lambda _error: None)
    bench.until(lambda: bench.standing(RIGHT))
    assert joint.statechart.state is AxisPhase.AWAITING_STANDSTILL
    assert bench.powered(RIGHT), "its group waits for it"
    bench.until(lambda: joint.statechart.state is AxisPhase.FORCED_QUICK_STOP, ms=2500)
    bench.run(100)
    assert not bench.powered(RIGHT)
    assert joint.axis.controlword.value == 0x02
    bench.until(lambda: joint.statechart.state is AxisPhase.VOLTAGE_DISABLED, ms=4000)
    bench.run(40)
    assert joint.axis.controlword.value == 0x00
    bench.until(lambda: bench.texts("stop_overdue")[2:], ms=2000)
    assert [text.split(": ")[1].split(";")[0] for text in bench.texts("stop_overdue")] == [
        "has not stopped in time",
        "its quick stop did not end in time",
        "no stop command had a visible effect, so it may have power",
    ]
    assert bench.powered(LEFT)
    bench.until(lambda: not bench.powered(LEFT))  # it reacts to NMT stop, and RPDOs and SDO still do not reach it
    assert bench.standing(LEFT)
    assert "NMT stop was sent" in bench.texts("stop_overdue")[-1]
    assert joint.statechart.state is AxisPhase.DISABLED
    bench.bus.drop(None)
    bench.run(2000)
    assert joint.node.nmt_state is NmtState.STOPPED
    assert "nmt start left_drive" in bench.axis_refused()
    joint.node.command(NmtCommand.START, bench.reactor.now())
    bench.until(lambda: joint.node.ready)
    bench.run(100)
    assert bench.axis(Action.FAULT_RESET) is None
    bench.goes_on()


@pytest.mark.rest
def test_the_power_of_a_drive_that_holds_a_load_is_never_taken(turning):
    bench = turning(description={DEVICE: DEVICE + '<param name="holds_load">true</param>'})
    joint = deaf(bench)
    bench.robot.stop(lambda _error: None)
    bench.until(lambda: joint.statechart.state is AxisPhase.STOP_FAILED, ms=14_000)
    bench.run(1000)
    assert joint.axis.controlword.value == 0x02
    assert bench.powered(LEFT)
    assert joint.node.nmt_state is NmtState.OPERATIONAL
    assert "NMT stop" not in bench.texts("stop_overdue")[-1]


@pytest.mark.rest
def test_the_last_sentence_names_the_drive_that_has_power_still(turning):
    bench = turning(description={DEVICE: DEVICE + '<param name="holds_load">true</param>'})
    deaf(bench)
    bench.robot.shutdown("a test")
    bench.until(lambda: bench.texts("stopped"), ms=16_000)
    assert bench.texts("stopped") == [
        "robby has stopped, left_drive still has power (OPERATION ENABLED): cut its supply if it moves"
    ]
    assert bench.robot.failure == (
        "the drives did not confirm the stop in time; left_drive still has power (OPERATION ENABLED): "
        "cut its supply if it moves; check the drives before you approach the robot"
    )


@pytest.mark.rest
def test_the_last_sentence_names_the_drive_that_obeyed_no_stop_command(turning):
    bench = turning()
    deaf(bench)
    bench.robot.shutdown("a test")
    bench.until(lambda: bench.texts("stopped"), ms=16_000)
    text = "left_drive obeyed no stop command and may have power: cut its supply if it moves"
    assert bench.texts("stopped") == [f"robby has stopped, {text}"]
    assert bench.robot.failure == f"{text}; check the drives before you approach the robot"
    nmt = [frame.data for label, frame in bench.bus.history if label == "master" and frame.can_id == 0]
    assert nmt[-2:] == [b"\x02\x03", b"\x82\x02"], "it keeps its monitoring of the master; the other is released"


def test_a_drive_whose_supply_was_switched_off_after_nmt_stop_is_asked_whether_it_has_power(turning):
    bench = turning()
    bench.joint(LEFT).node.stop_as_last_resort(bench.reactor.now())
    bench.run(500)
    bench.power_off(LEFT)
    bench.power_on(LEFT)
    bench.run(1000)
    assert not bench.joint(LEFT).node.ready
    bench.robot.shutdown("a test")
    bench.until(lambda: bench.texts("stopped"))
    assert bench.texts("stopped") == ["robby has stopped, its drives are disabled"]
    assert bench.robot.failure is None


def test_the_last_sentence_names_the_drive_without_feedback(turning):
    bench = turning()
    bench.switch("silent")
    bench.until(lambda: not bench.joint(LEFT).node.ready)
    bench.robot.shutdown("a test")
    bench.until(lambda: bench.texts("stopped"), ms=16_000)
    assert bench.texts("stopped") == ["robby has stopped, could not confirm that left_drive is disabled"]
    assert bench.robot.failure == (
        "could not confirm that left_drive is disabled; check the drives before you approach the robot"
    )


def test_a_drive_that_stops_in_time_is_not_escalated(turning):
    bench = turning()
    bench.robot.shutdown("a test")
    bench.until(lambda: bench.texts("stopped"))
    assert bench.texts("stop_overdue") == []
    assert bench.texts("stopped") == ["robby has stopped, its drives are disabled"]
    assert bench.robot.failure is None


def test_the_stop_of_a_halted_axis_does_not_wait_for_a_target_that_stands_already(turning):
    bench = turning()
    assert bench.axis(Action.HALT) is None
    assert bench.joint(LEFT).statechart.state is AxisPhase.HALTED
    bench.robot.stop(lambda _error: None)
    assert bench.until(lambda: bench.robot.systems[0].stopped) < 1000


def test_whether_it_holds_a_load_is_true_or_false(tmp_path):
    config = copy_robby(tmp_path, description={DEVICE: DEVICE + '<param name="holds_load">maybe</param>'})
    with pytest.raises(RobotConfigError, match="holds_load is 'maybe'; it must be true or false"):
        FaultBench("noload", config=config)
