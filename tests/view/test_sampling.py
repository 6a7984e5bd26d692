import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.pages import TARGET, drive_state, state
from support.samples import controllers_of

from canopen_control.view.sampling import History, Sampler, Stillness, charts, commanded_interfaces, names


def test_news_are_reported_once_and_when_they_are_finished():
    history = History(["a"])
    for step in range(4):
        history.add(5.0 + step / 10, {"a": float(step)})
    assert [row[1] for row in history.take_new_rows()] == [0.0, 1.0, 2.0]
    assert history.take_new_rows() == []
    history.add(5.31, {"a": 9.0})
    history.add(5.4, {"a": 4.0})
    assert [row[1] for row in history.take_new_rows()] == [9.0]


def test_where_nothing_was_known_nothing_is_made_up():
    history = History(["a", "b"])
    history.add(5.0, {"a": float("nan")})
    assert history.rows() == [[5.0, None, None]]


@given(st.lists(st.tuples(st.floats(0, 1e6), st.one_of(st.none(), st.floats()))))
def test_whatever_comes_the_times_go_up_and_every_row_is_reported_at_most_once(samples):
    history, reported = History(["a"]), []
    for time, value in samples:
        history.add(time, {"a": value})
        reported += history.take_new_rows()
        times = [row[0] for row in history.rows()]
        assert times == sorted(times)
    assert len({id(row) for row in reported}) == len(reported)


def sample(time=100.0, count=10, **joint):
    wheel = {"position": 1.0, "velocity": 2.0, "effort": None, "command": 3.0} | joint
    return state(time=time, cycle={"count": count, "work_s": 0.0005}, joints={"wheel": wheel}, load={"can": 0.02})


def test_the_commanded_interface_is_that_of_the_active_controller():
    reported = [
        {"name": "idle", "state": "inactive", "claimed_interfaces": ["wheel/effort"]},
        {"name": "base", "state": "active", "claimed_interfaces": ["wheel/velocity", "gripper/position"]},
        {"name": "outputs", "state": "active", "claimed_interfaces": ["io/digital_outputs"]},
    ]
    assert commanded_interfaces(controllers_of(reported), state()) == {"wheel": "velocity", "gripper": "position"}


def test_of_a_drive_that_takes_targets_the_mode_reports_what_is_commanded():
    reported = controllers_of([TARGET])
    assert commanded_interfaces(reported, drive_state()) == {"left": "velocity"}
    assert commanded_interfaces(reported, drive_state({"mode": "CSP"})) == {"left": "position"}
    assert commanded_interfaces(reported, drive_state({"mode": "HM"})) == {}


def test_command_actual_error_work_and_load_of_a_sample():
    values = Sampler().take(sample(), {"wheel": "velocity"})
    assert values["wheel command"] == 3.0
    assert values["wheel actual"] == 2.0
    assert values["wheel error"] == 1.0
    assert (values["work"], values["load can"], values["cycle"]) == (0.5, 2.0, None)
    assert Sampler().take(sample(), {"wheel": "position"})["wheel error"] == 2.0


def test_without_a_command_the_hardware_holds():
    values = Sampler().take(sample(command=None), {"wheel": "velocity"})
    assert (values["wheel command"], values["wheel error"]) == (0.0, -2.0)
    values = Sampler().take(sample(command=None), {"wheel": "position"})
    assert (values["wheel command"], values["wheel error"]) == (1.0, 0.0)
    assert Sampler().take(sample(velocity=None), {})["wheel actual"] is None


def test_the_cycle_time_is_what_passed_between_samples_per_cycle():
    sampler = Sampler()
    sampler.take(sample(100.0, 10), {})
    assert sampler.take(sample(100.1, 15), {})["cycle"] == pytest.approx(20.0)
    assert sampler.take(sample(100.2, 15), {})["cycle"] is None
    assert sampler.take(sample(100.3, 2), {})["cycle"] is None  # another run of the robot


def test_no_chart_has_a_line_that_is_not_sampled_and_many_joints_are_cut():
    joints = [f"j{number}" for number in range(30)]
    rows = set(names(joints, ["can"]))
    assert {line.row for chart in charts(joints, ["can"]) for line in chart.lines} <= rows
    assert len(charts(joints, [])) == 12 + 3


def test_a_robot_stands_when_nothing_has_moved_and_nothing_new_was_reported_for_a_second():
    stillness = Stillness()
    assert not stillness.take(sample(100.0, position=1.0))
    assert not stillness.take(sample(100.9, position=1.0005))
    assert stillness.take(sample(101.0, position=1.0005))
    assert not stillness.take(sample(101.1, position=1.1)), "it has moved"
    assert stillness.take(sample(102.2, position=1.1))
    assert not stillness.take(sample(102.3, position=1.1, command=4.0)), "it is told to"
    assert not stillness.take(sample(50.0, position=1.1, command=4.0)), "another clock"
    assert stillness.take(sample(51.0, position=1.1, command=4.0))


def test_what_creeps_does_not_stand():
    stillness = Stillness()
    assert not any(stillness.take(sample(100 + n / 10, position=2e-4 * n)) for n in range(60))
