"""The cycle bench on the whole path: every contender on one bus with real processes, its bytes looked at."""

import pytest
from canopen_control_bench import cycle
from canopen_control_bench.cycle import (
    CANOPEN,
    NAMES,
    OURS,
    Arena,
    absolutes_of,
    cpu_figures,
    realtime_figures,
    rounds_of,
    wake_figure,
    wakeups_figure,
)
from canopen_control_bench.stage import stage
from canopen_control_bench.turns import Turn

from canopen_control.bus.local import ask_hub
from canopen_control.errors import CanopenError
from canopen_control.rpc.messages.hub import DropFrames


@pytest.mark.process
def test_every_contender_has_the_right_bytes_and_is_measured():
    with stage() as played:
        turns = rounds_of(Arena(played, 2, 5000), NAMES, 1, lambda contender: contender.turn(30, 0))
    assert {name: turn.cycles for name, (turn,) in turns.items()} == dict.fromkeys(NAMES, 30)
    assert all(turn.cpu_ns > 0 for (turn,) in turns.values())
    assert all(sum(turn.others_ns.values()) > 0 for (turn,) in turns.values()), turns
    assert all(turn.wakeups > 0 for (turn,) in turns.values())
    assert [figure.peer_name for figure in cpu_figures("free", turns)] == list(NAMES[1:])


@pytest.mark.process
def test_a_paced_turn_of_ours_tells_lateness_and_work_of_every_cycle():
    with stage() as played:
        turns = rounds_of(Arena(played, 2, 5000), (OURS,), 1, lambda contender: contender.turn(20, 5_000_000))
    (turn,) = turns[OURS]
    assert len(turn.late_ns) == len(turn.work_ns) == 20
    assert min(turn.late_ns) >= 0
    assert min(turn.work_ns) > 0


@pytest.mark.process
@pytest.mark.parametrize("can_id", [0x182, 0x302, None])
def test_a_bus_that_loses_frames_is_seen_by_the_listener_and_one_that_does_not_passes(can_id):
    anything = range(-4000, 4001)
    with stage() as played:
        arena = Arena(played, 2, 5000)
        with arena.contender(OURS, check=False) as contender:
            if can_id is None:
                arena.check(contender, lambda number, position: anything)
                return
            ask_hub("bench", DropFrames(can_id=can_id, every=20))
            with pytest.raises(CanopenError, match="mistakes"):
                arena.check(contender, lambda number, position: anything)


def test_absolutes_have_percentiles_of_all_turns():
    turns = [Turn(cycles=2, late_ns=[1000, 2000], work_ns=[5000, 6000], others_ns={"hub": 4000})] * 2
    found = absolutes_of(turns)
    assert (found["cycles"], found["late max us"], found["wake to RPDO p50 us"], found["hub CPU us"]) == (4, 2, 6, 2)


def test_wake_ups_are_those_of_a_cycle():
    once, often = (Turn(cycles=200, wakeups=each, others_wakeups={"hub": 400}) for each in (210, 420))
    assert [wakeups_figure("100 Hz", [each]).good for each in (once, often)] == [True, False]
    assert absolutes_of([once])["hub wake-ups"] == 2


def test_what_processors_that_sleep_cost_is_judged_of_what_is_compiled(monkeypatch):
    turns = {OURS: [Turn(cycles=1, cpu_ns=50, late_ns=[1])], CANOPEN: [Turn(cycles=1, cpu_ns=100, late_ns=[1])]}
    for built, as_is, limit in (("compiled", True, 0.45), ("compiled", False, None), ("pure Python", True, None)):
        monkeypatch.setattr(cycle, "build", lambda built=built: built)
        (figure,) = cpu_figures("100 Hz", turns, as_is=as_is)
        assert figure.limit == limit


def test_waking_is_compared_by_its_p99():
    fast, slow = Turn(cycles=1, work_ns=[10_000]), Turn(cycles=1, work_ns=[40_000])
    assert wake_figure("1 kHz", {OURS: [fast], CANOPEN: [slow]}).ratio == 0.25


@pytest.mark.parametrize(("witnessed", "left_out"), [([], 5), ([(11_000_000, 11_100_000)], 3)])
def test_a_cycle_left_out_is_ours_unless_the_machine_stood_still(witnessed, left_out):
    stalls = [(10_000_000, 12_100_000), (50_000_000, 53_000_000)]
    turn = Turn(cycles=60, missed=5, late_ns=[100] * 59 + [300_000], work_ns=[5], stalls=stalls)
    left, late = realtime_figures(turn, witnessed, 1_000_000)
    assert (left.ours, left.good) == (left_out, False)
    assert left.absolutes["missed"] == 5
    assert (late.ours, late.good) == (300.0, False)
