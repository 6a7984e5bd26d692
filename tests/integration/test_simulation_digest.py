"""The digest of a simulation is that of its seed: in another process, from the sources and compiled."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.simulated import setup_of

from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.random_schedule import draw_schedule, known_faults
from canopen_control.simulation.simulation_run import SimulationRun

pytestmark = pytest.mark.process

SOURCES = Path(__file__).parents[2]
SEED, SECONDS = 7, 4


def test_a_process_that_runs_the_sources_has_the_digest_of_this_one(tmp_path):
    """The tests of the compiled package run this too: then this process is the compiled one."""
    setup, duration_ns = setup_of(), SECONDS * 1_000_000_000
    nodes = [node.node_id for node in setup.bus.nodes.values()]
    acts = draw_schedule(SEED, duration_ns, motions_of(setup), nodes, known_faults())
    assert acts
    run = SimulationRun(setup, SEED, acts)
    run.run(duration_ns)
    mine = run.outcome
    run.close()
    words = ("simulate", "robby", "--seed", str(SEED), "--for", str(SECONDS), "--faults", "all", "--json")
    done = subprocess.run(
        [sys.executable, "-P", "-m", "canopen_control", *words],
        env={**os.environ, "PYTHONPATH": str(SOURCES), "PYTHONHASHSEED": "1"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    theirs = json.loads(done.stdout)
    assert (theirs["sha256"], theirs["frames"]) == (mine.sha256, mine.frames)
