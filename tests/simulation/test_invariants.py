import pytest
from support.mutants import MUTANTS
from support.simulated import Played, S, setup_of

from canopen_control.simulation import invariants
from canopen_control.simulation.drawn_schedule import draw_schedule, known_faults
from canopen_control.simulation.invariants import Breach, Invariants
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.simulation_run import SimulationRun

#: mutant -> the first seed that catches it, and the rules that may tell; all are caught within a hundred seeds
CAUGHT = {
    "stop_is_late": (4, "stop_late"),
    "stop_does_nothing": (4, "stop_late"),
    "enabled_again_when_its_node_is_back": (1, "enable_unasked"),
    "enabled_again_after_a_stop": (1, "enable_unasked"),
    "reset_chains_into_enable": (3, "enable_unasked"),
    "stale_commands": (2, "motion_uncommanded"),
    "latch_does_not_refuse": (4, "enable_unasked"),
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


def test_rules_of_users_are_asked_and_told_once_each_time(monkeypatch):
    played = Played()
    wrong = []
    rule = lambda robot: f"it is {robot.core.state.value}" if wrong else None  # noqa: E731 - a user's rule
    found = Invariants(played.robot, played.player, (), [("mine", rule)])
    played.run(0.1)
    assert found.breaches == []
    wrong.append(True)
    played.run(0.1)
    wrong.clear()
    played.run(0.1)
    wrong.append(True)
    played.run(0.1)
    assert [(each.rule, each.text) for each in found.breaches] == [("mine", "it is running")] * 2
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
