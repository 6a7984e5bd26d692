"""The memory bench: a leak of a hundred bytes a cycle is seen, and without one there is none."""

import pytest
from canopen_control_bench.memory import run
from canopen_control_bench.stage import stage

pytestmark = pytest.mark.process


def test_a_leak_is_seen_and_nothing_else():
    with stage() as played:
        clean = run(played, 2, 3000)
        (played.folder / "leaky").mkdir()
        played.folder = played.folder / "leaky"
        leaky = run(played, 2, 3000, leak=1000)
    assert clean["end"] - clean["begin"] < 500_000
    assert leaky["end"] - leaky["begin"] > 2_000_000
    assert clean["frames"] > 27_000
