from dataclasses import replace

import pytest
from support.simulated import Judged
from support.two_motors import dictionary
from support.virtualbench import tmcm

from canopen_control.master.plan_builder import PlannedWrite
from canopen_control.od.model import DataType
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.simulation.answer_invariants import AnswerInvariants
from canopen_control.simulation.simulation_run import SimulationRun
from canopen_control.simulation.wire_invariants import ConfigurationInvariants, _holds
from canopen_control.virtual.device import make_device

WIDE = "tools/campaigner/robots/wide"


def rules(judged, views, tell):
    plans = [plan for bus in judged.robot.setup.joined.values() for plan in bus.plans.values()]
    answers = AnswerInvariants(judged.robot, views, (), judged.disturbed, tell)
    return ConfigurationInvariants(judged.robot, plans, judged.disturbed, answers, tell)


@pytest.fixture
def judged():
    created = Judged(rules)
    yield created
    created.close()


def test_what_a_boot_has_written_is_not_reported_nor_is_another_boot(judged):
    judged.run(0.5).do("power", 2, 0.5).run(2.0).do("kill", seconds=0.3).run(2.0)
    assert judged.collected == []


def test_a_parameter_that_was_not_written_is_reported_by_its_address(judged):
    judged.rules._nodes[0].boots = 0
    judged.robot.drives[3].device.store.set(0x6083, 0, 1)
    judged.run(0.2)
    text = "left_drive is ready but does not have the planned values of 0x6083:00"
    assert judged.collected == [("plan_unwritten", text)]
    judged.run(0.5)
    assert len(judged.collected) == 1


def test_an_object_that_an_rpdo_carries_is_what_the_robot_commands(judged):
    """0x6060 in `sdo` of bus.yml, as in the examples of ros2_canopen, and the mode of the controller after the boot."""
    node = judged.rules._nodes[0]
    write = PlannedWrite(0x6060, 0, b"\x01", "the mode", data_type=DataType.INTEGER8)
    node.boots, node.plan = 0, replace(node.plan, writes=(write,))
    judged.run(0.2)
    assert judged.collected == []
    node.boots, node.plan = 0, replace(node.plan, rpdos=())
    judged.run(0.2)
    assert [rule for rule, _ in judged.collected] == ["plan_unwritten"]


@pytest.mark.parametrize(
    ("index", "value", "holds"), [(0x6081, 8344, True), (0x6081, 65537, False), (0x6084, 8344, False)]
)
def test_a_speed_may_have_been_lowered_to_a_velocity_limit(index, value, holds):
    device = tmcm()
    device.store.set(index, 0, value)
    write = PlannedWrite(index, 0, (65536).to_bytes(4, "little"), "a speed", data_type=DataType.UNSIGNED32)
    assert _holds(device, write) is holds


def test_the_values_of_a_disturbed_node_are_unknown(judged):
    judged.do("fault", 3, 0.1, name="hand_moved").run(0.3)
    judged.rules._nodes[0].boots = 0
    judged.robot.drives[3].device.store.set(0x6083, 0, 1)
    judged.run(0.5)
    assert judged.collected == []


@pytest.mark.parametrize(("entry", "reported"), [(0, 1), (0x701, 1), (0x80000000, 0), (0x1FF, 0), (0x40000000, 1)])
def test_a_pdo_is_never_active_with_a_cob_id_that_it_may_not_have(judged, entry, reported):
    judged.robot.drives[2].device.store.set(0x1803, 1, entry)
    judged.run(0.3)
    assert judged.broken == ["cob_id_restricted"] * reported


@pytest.mark.parametrize(("default", "held"), [(0x180, 0x180), (None, 0)])
def test_an_impossible_cob_id_of_the_eds_is_not_a_breach(judged, default, held):
    device = judged.robot.drives[2].device
    device.od.entries[0x1803, 1] = replace(device.od[0x1803, 1], default=default)
    device.store.set(0x1803, 1, held)
    judged.run(0.3)
    assert judged.broken == []


def test_a_wide_object_is_decoded_as_it_is():
    run = SimulationRun(read_robot(find_robot(WIDE)), 1, ())
    run.run(1_500_000_000)
    assert run.breaches == ()
    [pdo] = run.robot.core.nodes["counter"].received
    assert pdo.values == (0x0123456789ABCDEF,)
    pdo.unpack = lambda data: (int.from_bytes(data[1:], "little"),)
    run.robot.run_for(4_000_000_000)
    reported = run.invariants.breaches
    run.close()
    assert [item.rule for item in reported][:1] == ["shown_wrong"]
    assert "0x2000:00 of counter is reported as 320255973501901 but is 81985529216486895" in reported[0].text


@pytest.mark.parametrize(("value", "holds"), [(20000, True), (1, False)])
def test_a_value_of_the_second_of_two_motors_is_looked_at_in_its_subindex(value, holds):
    device = make_device(dictionary(), 2)
    device.store.set(0x6883, 0, value)
    write = PlannedWrite(0x6083, 2, (20000).to_bytes(4, "little"), "a ramp", data_type=DataType.UNSIGNED32)
    assert _holds(device, write) is holds
