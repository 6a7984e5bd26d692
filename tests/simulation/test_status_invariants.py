import math

import pytest
from support.generic import write_generic
from support.mutants import MUTANTS
from support.simulated import MS, Judged, S, setup_of

from canopen_control.master.event_log import Event
from canopen_control.master.remote_node import RemoteNode
from canopen_control.master.supervision import EmcyGate
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.simulation.simulation_run import SimulationRun
from canopen_control.simulation.status_invariants import StatusInvariants
from canopen_control.virtual.scenario import ScenarioEvent


@pytest.fixture
def made():
    robots = []

    def make():
        robots.append(Judged(lambda judged, views, tell: StatusInvariants(judged.robot, views, judged.disturbed, tell)))
        return robots[-1]

    yield make
    robots[-1].close()


@pytest.fixture
def judged(made):
    return made()


@pytest.mark.rest
def test_what_is_shown_as_it_is_is_not_reported(judged):
    judged.drive(5.0, -5.0, seconds=1.0).run(2.0).do("stop").run(1.0).do("axis", name="enable").run(1.0)
    judged.do("fault", 3, 0.5, name="drive_fault").run(1.0).do("power", 2, 1.0).run(4.0)
    judged.do("axis", name="fault-reset").run(0.3).do("axis", name="enable").run(0.5).drive(3.0, 3.0).run(2.5)
    judged.do("kill", seconds=0.5).run(3.0)
    assert judged.collected == []


def test_the_offset_of_bus_yml_is_part_of_a_position(tmp_path):
    folder = write_generic(tmp_path, extra="offset_pos_from_dev: 2.0")
    simulation = SimulationRun(read_robot(find_robot(str(folder)), controllers=["velocity"]), 1, [])
    simulation.run(2 * S)
    simulation.close()
    assert simulation.breaches == ()


def test_the_units_of_a_drive_apply_where_bus_yml_has_no_scales(tmp_path):
    """As with ros2_canopen's own files: 0x608F has the counts of a turn, and the robot reads it after the boot."""
    setup = read_robot(find_robot(str(write_generic(tmp_path))), controllers=["velocity"])
    drives = ScenarioEvent(2 * S, "command", "velocity", values=(2.0, -1.0), for_ns=2 * S)
    simulation = SimulationRun(setup, 1, [drives])
    simulation.run(5 * S)
    assert simulation.robot.core.joints["one"].scale.pos_to_dev == pytest.approx(65536 / math.tau)
    assert simulation.robot.core.joints["one"].states["position"].value > 3.0
    simulation.close()
    assert simulation.breaches == ()


def test_a_node_with_slow_heartbeats_may_be_shown_in_its_former_state_until_the_next_one(tmp_path):
    folder = write_generic(tmp_path, modes="heartbeat_producer: 2000")  # as in a public bus.yml
    acts = [ScenarioEvent(9508 * MS, "fault", "2", "silent", for_ns=925 * MS)]
    simulation = SimulationRun(read_robot(find_robot(str(folder)), controllers=["velocity"]), 3, acts)
    simulation.run(14 * S)
    simulation.close()
    assert simulation.breaches == ()


@pytest.mark.sources
def test_joint_states_that_stand_are_reported_by_their_stamp_and_by_their_values(judged, monkeypatch):
    MUTANTS["joint_states_stand"](monkeypatch)
    judged.run(2.5)
    assert [text.split(" is 0")[0] for _, text in judged.collected] == ["joint_states: the time stamp"]
    judged.drive(5.0, 5.0, seconds=1.0).run(1.5)
    assert {text.split(" of ")[0] for _, text in judged.collected[1:]} == {
        "joint_states: the position",
        "joint_states: the velocity",
    }


@pytest.mark.sources
def test_a_velocity_with_the_wrong_sign_is_reported_each_face_once(judged, monkeypatch):
    judged.run(1.0)
    MUTANTS["velocities_told_reversed"](monkeypatch)
    judged.drive(5.0, 0.0, seconds=1.0).run(0.9)
    assert [(rule, text.split(" is reported")[0]) for rule, text in judged.collected] == [
        ("shown_wrong", "status: the velocity of left_wheel_joint"),
        ("shown_wrong", "sample: the velocity of left_wheel_joint"),
    ]


@pytest.mark.sources
def test_a_state_from_before_is_reported(judged, monkeypatch):
    judged.run(1.0)
    MUTANTS["states_told_as_they_were"](monkeypatch)
    judged.run(0.2).do("stop").run(1.5)
    expected = "left_drive is reported as OPERATION_ENABLED but is SWITCH_ON_DISABLED"
    assert {text for _, text in judged.collected} >= {f"status: {expected}", f"sample: {expected}"}


@pytest.mark.sources
@pytest.mark.parametrize("act", [("fault", 3, 0.8, {"name": "drive_fault"}), ("power", 3, 2.0, {})])
def test_a_trouble_without_an_event_is_reported_once(made, monkeypatch, act):
    kind, node, lasts, more = act
    MUTANTS["troubles_without_an_event"](monkeypatch)
    judged = made()
    judged.run(1.0).do(kind, node, lasts, **more).run(1.9)
    reported = ["left_drive was lost"] if kind == "power" else ["left_drive is in fault", "left_drive has sent an EMCY"]
    assert [(rule, text.split(",")[0]) for rule, text in judged.collected] == [
        ("event_missing", item) for item in reported
    ]


@pytest.mark.sources
def test_a_drive_without_supply_that_is_reported_as_ready_is_reported(judged, monkeypatch):
    MUTANTS["lost_nodes_told_as_ready"](monkeypatch)
    judged.run(0.5).do("power", 2, 2.0).run(1.9)
    assert judged.collected == [("shown_wrong", "status: right_drive is reported as ready but has no supply")]


def test_a_drive_that_counts_again_continues_where_it_was_seen_last(judged):
    judged.drive(5.0, 5.0, seconds=1.0).run(1.5).do("power", 2, 0.5).run(4.0)
    judged.do("axis", name="enable").run(0.5).drive(5.0, 5.0, seconds=1.0).run(1.5)
    assert judged.collected == []


@pytest.mark.rest
def test_a_drive_whose_count_passes_over_its_32_bits_continues():
    """Seed 1582 of the forklift: the count of a drive is brought to its end, and its wheel turns on."""
    acts = (
        ScenarioEvent(612 * MS, "fault", "2", "position_wrap", for_ns=11 * MS),
        ScenarioEvent(1228 * MS, "axis", name="enable"),
        ScenarioEvent(1828 * MS, "command", "forklift_base_controller", values=(0.386, -0.459), for_ns=19 * MS),
    )
    run = SimulationRun(setup_of("forklift"), 1582, acts)
    run.run(4847 * MS)
    counted = run.robot.drives[2].device.get(0x6064)
    run.close()
    assert counted < 0  # it has passed over
    assert run.breaches == ()


@pytest.mark.sources
def test_an_emcy_that_the_robot_does_not_report_is_a_violation(judged, monkeypatch):
    judged.run(1.2).do("fault", 3, 0.3, name="device_error").run(2.5)
    assert judged.collected == []
    monkeypatch.setattr(EmcyGate, "passes", lambda self, now: False)
    judged.do("fault", 3, 0.3, name="device_error").run(2.5)
    assert judged.collected == [("event_missing", "left_drive has sent an EMCY, and no event reports it")]


@pytest.mark.rest
@pytest.mark.sources
def test_a_wrong_toggle_bit_that_the_robot_does_not_report_is_a_violation(monkeypatch):
    acts = [
        ScenarioEvent(3 * S + at * MS, "frame", values=(0x702, answer))
        for at, answer in ((0, 5), (50, 0x85), (100, 0x85))
    ]

    def breaches():
        run = SimulationRun(read_robot(find_robot("tools/campaigner/robots/guarded")), 1, acts)
        run.run(5 * S)
        run.close()
        return [breach.text for breach in run.invariants.breaches]

    assert breaches() == []
    monkeypatch.setattr(RemoteNode, "on_guarding", lambda self, event, now: None)
    assert breaches() == ["the guarding toggle bit of rotor_drive was wrong, and no event reports it"]


def test_a_count_that_goes_over_the_end_of_its_bits_is_not_a_jump(judged):
    judged.do("fault", 2, 0.1, name="position_wrap").run(1.0).do("axis", name="enable").run(3.0)
    judged.drive(8.0, 8.0, seconds=2.0).run(2.5)
    assert judged.collected == []
    judged.robot.core.report(Event(judged.robot.now_ns, "position_jump", "right_drive", "its position jumped"))
    judged.run(0.3)
    assert judged.collected == [("shown_wrong", "events: its position jumped, but the shaft has not jumped")]


def test_a_place_is_the_shafts_from_boot_on_whatever_the_bus_has_lost_since(judged):
    judged.drive(5.0, 5.0, seconds=1.0).run(2.0).do("lose", 2, 0.1, values=(2.0,)).run(1.5)
    assert judged.collected == []
    judged.robot.core.joints["right_wheel_joint"].axis.unwrap.count += 500
    judged.drive(5.0, 5.0, seconds=0.5).run(1.0)
    assert {text.split(" is reported")[0] for _, text in judged.collected} == {
        f"{face}: the position of right_wheel_joint" for face in ("status", "sample", "joint_states")
    }


def test_a_velocity_that_the_drive_itself_shows_is_not_reported(judged):
    """Quirk velocity_shown_zero: an event says that 0x606C is not the velocity of the shaft."""
    for node_id in (2, 3):
        judged.do("quirk", node_id, name="velocity_shown_zero")
    judged.drive(5.0, 5.0, seconds=2.0).run(2.5)
    assert judged.collected == []
