"""The full bus: every frame is counted where it was decoded, and a lost one fails the run."""

import pytest
from canopen_control_bench.cycle import Arena
from canopen_control_bench.load import DRIVES, FULL_BUS, PERIOD_US, full_turn
from canopen_control_bench.stage import stage

from canopen_control.errors import CanopenError

pytestmark = pytest.mark.process


def test_a_full_bus_is_received_whole_and_a_dropped_frame_is_missed():
    with stage() as played:
        arena = Arena(played, DRIVES, PERIOD_US, base=False)
        turn = full_turn(arena, 0.5)
        assert turn.tpdos > 0.4 * FULL_BUS
        assert 0 < turn.cpu_ns < turn.wall_ns
        with pytest.raises(CanopenError, match="missing"):
            full_turn(arena, 0.5, drop=40)
