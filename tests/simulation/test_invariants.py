import sys

import pytest
from support.mutants import MUTANTS
from support.observers import Watch
from support.simulated import Judged, Played, S, setup_of

from canopen_control.controllers.manager import ControllerManager
from canopen_control.runtime.core import RobotCore, RobotState
from canopen_control.simulation import invariants
from canopen_control.simulation.invariants import Breach, ClientInvariants, Invariants, ReportInvariants
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.random_schedule import draw_schedule, known_faults
from canopen_control.simulation.simulation_run import SimulationRun


@pytest.fixture
def judged():
    created = Judged(lambda judged, views, tell: ReportInvariants(judged.robot, views, tell))
    yield created
    created.close()


def test_the_truth_is_not_reported(judged):
    judged.drive(5.0, 5.0).run(1.0).do("fault", 3, 0.5, name="drive_fault").run(1.0).do("power", 2, 1.0).run(4.0)
    assert judged.collected == []


@pytest.mark.sources
def test_running_while_a_drive_is_in_fault_or_silent_is_reported_once(judged, monkeypatch):
    monkeypatch.setattr(RobotCore, "state", property(lambda self: RobotState.RUNNING))
    judged.do("fault", 3, name="drive_fault").run(1.5)
    assert judged.collected == [("state_told", "the state is RUNNING although node 3 is in fault")]
    judged.do("power", 2).run(2.0)
    assert judged.collected[1:] == [("state_told", "the state is RUNNING although node 2 is silent")]


def test_an_error_of_the_program_is_reported(judged):
    judged.robot.errors.append(ValueError("no"))
    judged.rules.on_sample(judged.robot.now_ns)
    judged.rules.on_sample(judged.robot.now_ns)
    assert judged.collected == [("program_error", "ValueError: no")]


def test_memory_that_grows_is_reported(judged, monkeypatch):
    weights = iter((1000, 50_000, 80_000))
    monkeypatch.setattr(sys, "getallocatedblocks", lambda: next(weights))
    for minute in range(1, 4):
        judged.rules.on_sample(judged.robot.now_ns + 61 * minute * S)
    assert judged.broken.count("memory") == 1


def test_a_latch_holds_until_it_is_released_even_if_its_client_leaves_or_restarts(judged):
    judged.do("latch").run(0.3).do("ask", seconds=0.2).run(0.5).do("kill", seconds=0.3).run(1.5)
    assert judged.robot.core.latch.held
    judged.do("release").run(0.5).do("axis", name="fault-reset").run(0.3).do("axis", name="enable").run(0.5)
    assert judged.collected == []
    assert judged.robot.core.state is RobotState.RUNNING


@pytest.mark.parametrize(
    ("kind", "held", "words"), [("latch", None, "a client has latched it"), ("", "me", "no client has requested it")]
)
def test_a_latch_that_is_lost_is_reported_and_one_that_is_not_requested(judged, kind, held, words):
    if kind:
        judged.do(kind).run(0.3)
    judged.robot.core.latch.by = held
    judged.run(0.6)
    assert judged.broken == ["state_told"]
    assert judged.collected[0][1].endswith(words)


@pytest.mark.sources
def test_running_is_a_lie_while_a_claimed_drive_is_off(judged, monkeypatch):
    monkeypatch.setattr(RobotCore, "state", property(lambda self: RobotState.RUNNING))
    judged.do("axis", name="disable").run(1.0)
    reported = {
        f"the state is RUNNING although {side}_wheel_joint is claimed by a controller and disabled"
        for side in ("left", "right")
    }
    assert {text for _, text in judged.collected} == reported


@pytest.mark.sources
def test_a_command_is_not_taken_while_its_drives_are_off(judged, monkeypatch):
    judged.robot.observers.append(Watch(applied=judged.rules.applied))
    judged.do("axis", name="disable").run(1.0).drive(5.0, 5.0, seconds=0.1).run(0.3)
    assert (judged.collected, judged.player.refused) == ([], 1)
    monkeypatch.setattr(ControllerManager, "_require_enabled", lambda self, controller: None)
    judged.drive(5.0, 5.0, seconds=0.1).run(0.3)
    assert judged.broken == ["command_taken"]


@pytest.fixture
def made():
    robots = []

    def make():
        robots.append(Judged(lambda judged, _views, tell: ClientInvariants(judged.robot, judged.player.clients, tell)))
        return robots[-1]

    yield make
    robots[-1].close()


@pytest.mark.rest
def test_clients_that_hang_are_not_news(made):
    judged = made()
    judged.do("silent", values=(80.0,)).do("ask", seconds=2.0).do("deaf").run(6.0)
    judged.do("kill", seconds=0.3).run(2.0).do("ask", seconds=1.0).run(2.0)
    assert judged.collected == []


def test_a_robot_that_is_stalled_owes_no_answer(made):
    judged = made()
    judged.do("ask").run(0.1).do("stall", "master", 3.0).run(4.0)
    assert judged.collected == []


@pytest.mark.sources
@pytest.mark.parametrize(
    ("mutant", "acts", "rule"),
    [
        ("silent_clients_keep_all_places", [("silent", {"values": (80.0,)}), ("ask", {})], "client_waits"),
        ("deaf_clients_are_kept", [("deaf", {})], "client_kept"),
    ],
)
def test_a_server_that_does_not_part_with_a_client_is_reported_once(made, monkeypatch, mutant, acts, rule):
    MUTANTS[mutant](monkeypatch)
    judged = made()
    for kind, more in acts:
        judged.do(kind, **more).run(0.1)
    judged.run(5.5)
    assert judged.broken == [rule]


@pytest.mark.sources
def test_a_server_that_waits_for_a_client_is_reported(made, monkeypatch):
    MUTANTS["deaf_clients_are_waited_for"](monkeypatch)
    judged = made()
    judged.do("deaf").run(1.0)
    assert judged.broken[0] == "client_blocks"


#: mutant -> the first seed that catches it, and the rules that may tell; all are caught within a hundred seeds
CAUGHT = {
    "stop_is_late": (4, "stop_late"),
    "stop_does_nothing": (4, "stop_late"),
    "enabled_again_when_its_node_is_back": (1, "enable_unasked"),
    "enabled_again_after_a_stop": (1, "enable_unasked"),
    "reset_chains_into_enable": (3, "enable_unasked"),
    "stale_commands": (2, "motion_uncommanded"),
    "latch_does_not_refuse": (10, "enable_unasked"),
    "told_as_running": (1, "state_told"),
    "told_as_enabled": (1, "state_told"),
    "skipped_cycles": (0, "late"),
    "commands_sent_again_and_again": (0, "bus_budget"),
    "exceptions": (0, "program_error"),
    "lost_heartbeats_unnoticed": (21, "stop_late"),
    "slow_heartbeats": (0, "stop_late"),
    "trouble_stops_nobody": (1, "enabled_still"),
    "others_go_on": (1, "enabled_still"),
    "targets_too_great": (0, "target_wrong"),
    "targets_of_one_joint_held": (0, "target_wrong"),
    "shafts_overshoot": (0, "target_missed"),
    "shafts_stay_behind": (0, "target_missed"),
    "commands_outlast_an_enable": (23, "motion_uncommanded"),
    "joint_states_stand": (0, "shown_wrong"),
    "states_told_as_they_were": (1, "shown_wrong"),
    "velocities_told_reversed": (0, "shown_wrong"),
    "troubles_without_an_event": (1, "event_missing"),
    "lost_nodes_told_as_ready": (1, "shown_wrong"),
    "gone_clients_hold_commands": (24, "motion_uncommanded"),
    "deaf_clients_are_waited_for": (4, "client_blocks"),
    "deaf_clients_are_kept": (4, "client_kept"),
    "silent_clients_keep_all_places": (34, "client_waits"),
}


def breaches_of(seed, seconds=20):
    """Return what the observer tells of a seed, as soon as it tells something."""
    motions = motions_of(setup_of())
    acts = draw_schedule(seed, seconds * S, motions, (2, 3), known_faults())
    run = SimulationRun(setup_of(), seed, acts, motions=motions)
    try:
        run.robot.start()
        for _ in range(10 * seconds):
            run.robot.run_for(S // 10)
            if run.invariants.breaches:
                break
        return run.invariants.breaches
    finally:
        run.close()


def test_there_are_enough_mutants_and_each_is_looked_for():
    assert CAUGHT.keys() == MUTANTS.keys()
    assert len(MUTANTS) >= 30
    assert all(seed < 100 for seed, _ in CAUGHT.values())


@pytest.mark.rest
@pytest.mark.sources
@pytest.mark.parametrize("name", MUTANTS)
def test_a_mutated_runtime_is_caught(monkeypatch, name):
    seed, rule = CAUGHT[name]
    MUTANTS[name](monkeypatch)
    assert breaches_of(seed)[0].rule == rule


@pytest.mark.rest
@pytest.mark.parametrize("seed", sorted({seed for seed, _ in CAUGHT.values()}))
def test_the_runtime_as_it_is_is_not_caught_by_these_seeds(seed):
    assert breaches_of(seed) == []


def test_a_breach_is_a_line():
    assert Breach(1.25, "late", "it came late").sentence == "1.250 s: late: it came late"


def test_rules_of_users_are_asked_and_reported_once_each_time(monkeypatch):
    played = Played()
    wrong = []
    rule = lambda robot: f"it is {robot.core.state.value}" if wrong else None  # noqa: E731 - a user's rule
    result = Invariants(played.robot, played.player, (), [("mine", rule)])
    played.run(0.1)
    assert result.breaches == []
    wrong.append(True)
    played.run(0.1)
    wrong.clear()
    played.run(0.1)
    wrong.append(True)
    played.run(0.1)
    assert [(breache.rule, breache.text) for breache in result.breaches] == [("mine", "it is running")] * 2
    played.close()


def test_rules_of_users_come_by_entry_points(monkeypatch):
    class Point:
        name = "mine"

        def load(self):
            return len

    monkeypatch.setattr(invariants.importlib.metadata, "entry_points", lambda group: [Point()])
    invariants._entry_points.cache_clear()
    assert invariants.user_rules() == [("mine", len)]
    monkeypatch.undo()
    invariants._entry_points.cache_clear()
