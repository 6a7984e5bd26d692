import os
import subprocess
import sys

import pytest
from support.simulated import S, setup_of

from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.random_schedule import draw_schedule, known_faults
from canopen_control.simulation.simulation_run import SimulationRun

SEED = 11


def drawn(seconds):
    nodes = [node.node_id for node in setup_of().bus.nodes.values()]
    return draw_schedule(SEED, seconds * S, motions_of(setup_of()), nodes, known_faults())


def outcome(seconds=8, **how):
    run = SimulationRun(setup_of(), SEED, drawn(seconds), **how)
    run.run(seconds * S)
    result = run.outcome
    run.close()
    return result


@pytest.mark.rest
def test_what_came_of_it_is_reported():
    result = outcome()
    assert (result.seed, result.robot_s, result.breaches) == (SEED, 8.0, ())
    assert result.frames > 1000
    assert result.events > 10
    assert result.real_s > 0.0


def test_the_progress_is_reported_in_both_times():
    observed = []
    run = SimulationRun(setup_of(), 1, ())
    run.run(S, lambda robot_s, real_s: observed.append((robot_s, real_s)))
    run.close()
    assert observed[-1][0] == 1.0
    assert observed == sorted(observed)


def test_it_may_be_as_slow_as_real_time():
    run = SimulationRun(setup_of(), 1, (), speed=2.0)
    run.run(S // 2)
    assert run.real_s >= 0.25
    run.close()


@pytest.mark.process
def test_the_same_seed_does_the_same_in_another_process_whatever_the_order_of_its_sets():
    words = ["simulate", "robby", "--for", "8s", "--seed", str(SEED), "--faults", "all", "--json"]
    digests = set()
    for number in "12":
        done = subprocess.run(
            [sys.executable, "-m", "canopen_control", *words],
            env={**os.environ, "PYTHONHASHSEED": number},
            capture_output=True,
            text=True,
            check=True,
        )
        digests.add(done.stdout.partition('"sha256":"')[2][:64])
    assert digests == {outcome().sha256}
