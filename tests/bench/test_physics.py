"""The physics bench: whole runs side by side, and their processes."""

import os
import subprocess
import sys
from itertools import pairwise
from types import SimpleNamespace

import pytest
from canopen_control_bench import physics
from canopen_control_bench.figure import Figure

pytestmark = pytest.mark.process


def test_the_children_of_a_process_are_counted_with_it():
    child = subprocess.Popen([sys.executable, "-c", "sum(range(3_000_000)); input()"], stdin=subprocess.PIPE)
    try:
        assert child.pid in physics._children(os.getpid())
        assert physics._cpu_s(os.getpid()) >= physics._cpu_s(child.pid) >= 0.0
    finally:
        child.communicate(b"\n")


def test_a_run_in_physics_is_held_against_one_without():
    figure = physics._beside("robby", 0.5, 1)
    assert isinstance(figure, Figure)
    assert figure.limit == physics.CORE_LIMIT
    assert figure.absolutes["plain % of a core"] > 0.0
    assert figure.absolutes["physics % of a core"] > 0.0


def test_an_arm_goes_on_from_round_to_round_without_a_step(monkeypatch):
    commanded = []
    monkeypatch.setattr(physics, "_start", lambda _played, _robot, _kind: os.getpid())
    monkeypatch.setattr(physics.RobotClient, "connect", lambda _name: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(physics, "_command", lambda _client, _controller, values: commanded.append(values[0]))
    monkeypatch.setattr(physics, "_EVERY_S", 0.0)
    physics._beside("arm6", 0.002, 3)
    assert len(commanded) > 6
    assert max(abs(after - before) for before, after in pairwise(commanded)) < 0.02


def test_two_passes_of_umbmark_are_a_figure_of_its_own():
    figure = physics._calibrated(side=0.3)
    assert figure.limit == physics.CALIBRATION_GAIN
    assert figure.ours > 30.0  # of a small square, whose end is known to fewer parts of its error
    assert figure.absolutes["mm before"] > 20.0
