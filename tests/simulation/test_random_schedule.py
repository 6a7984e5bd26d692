from hypothesis import given
from hypothesis import strategies as st

from canopen_control.simulation import random_schedule
from canopen_control.simulation.motions import SampleMotion
from canopen_control.simulation.random_schedule import draw_schedule, known_faults
from canopen_control.simulation.robot_under_test import MASTER
from canopen_control.simulation.scenario_events import KINDS

S = 1_000_000_000
MOTIONS = (
    SampleMotion("wheels", "command", ((-1.0, 1.0), (-2.0, 2.0)), starts=True),
    SampleMotion("arm", "trajectory", ((0.0, 0.5),), starts=False),
)


def drawn(seed, seconds=60, faults=None):
    return draw_schedule(seed, seconds * S, MOTIONS, (2, 3), known_faults() if faults is None else faults)


def test_a_seed_draws_the_same_each_time_and_another_something_else():
    assert drawn(1) == drawn(1) != drawn(2)
    assert drawn(7, 5)[0].words == "0.600 s: command wheels 0.259 -1.799 for 2.378 s"  # in every version of Python


@given(st.integers(0, 10_000))
def test_whatever_is_drawn_can_be_played(seed):
    acts = drawn(seed)
    assert [act.at_ns for act in acts] == sorted(act.at_ns for act in acts)
    for act in acts:
        expected = KINDS[act.kind].target
        assert act.at_ns < 60 * S
        assert expected != "node" or act.target in ("2", "3")
        assert expected != "member" or act.target in ("2", "3", MASTER, "")
        assert expected != "controller" or act.target in ("wheels", "arm")
        assert act.kind != "fault" or act.name in known_faults()
        ranges = next((motion.ranges for motion in MOTIONS if motion.controller == act.target), ())
        if act.values and ranges:
            assert all(low <= value <= high for value, (low, high) in zip(act.values, ranges, strict=True))


def test_some_seeds_have_a_drive_that_boots_later_than_the_robot():
    first = [drawn(seed)[0] for seed in range(100)]
    late = [act for act in first if act.at_ns == 0]
    assert 5 <= len(late) <= 30
    assert {(act.kind, act.target) for act in late} == {("power", "2"), ("power", "3")}
    assert all(drawn(seed, faults=[])[0].at_ns > 0 for seed in range(100))


def test_strangers_send_single_frames_and_bursts():
    counts = [sum(act.kind == "frame" for act in drawn(seed)) for seed in range(300)]
    assert 1 in counts
    assert max(counts) >= 30


def test_without_faults_nothing_breaks():
    kinds = {act.kind for seed in range(20) for act in drawn(seed, faults=[])}
    assert kinds <= {"command", "trajectory", "cancel", "stop", "latch", "release", "axis", "activate", "deactivate"}


def test_a_trajectory_is_cancelled_on_its_way_and_nothing_else_of_a_seed_changes(monkeypatch):
    cancelled = 0
    for seed in range(50):
        acts, cancels = drawn(seed), [act for act in drawn(seed) if act.kind == "cancel"]
        sent = [item for item in acts if item.kind == "trajectory"]
        assert all(any(0 <= act.at_ns - item.at_ns <= item.for_ns for item in sent) for act in cancels)
        with monkeypatch.context() as patch:
            patch.setattr(random_schedule, "_CANCELLED", 0.0)
            assert drawn(seed) == tuple(act for act in acts if act.kind != "cancel")
        cancelled += len(cancels)
    assert cancelled >= 5


def test_every_kind_of_trouble_and_every_fault_is_drawn_by_some_seed():
    acts = [act for seed in range(300) for act in drawn(seed)]
    assert {act.kind for act in acts} == KINDS.keys() - {"fault_off", "plant", "world", "quirk", "quirk_off"}
    assert {act.name for act in acts if act.kind == "fault"} == set(known_faults())


def test_on_a_floor_encoders_that_jump_are_left_out():
    assert set(known_faults()) - set(known_faults(physics=True)) == {"position_jump", "position_wrap", "hand_moved"}
