import pytest

from canopen_control.view.plots import Plots, Sampler, commanded_interfaces


def state(time=100.0, count=10, **joint):
    wheel = {"position": 1.0, "velocity": 2.0, "effort": None, "command": 3.0} | joint
    return {
        "time": time,
        "cycle": {"count": count, "work_s": 0.0005},
        "joints": {"wheel": wheel},
        "load": {"can": 0.02},
    }


def test_the_commanded_interface_is_that_of_the_active_controller():
    base = {"state": "active", "claimed_interfaces": ["wheel/velocity", "gripper/position"]}
    idle = {"state": "inactive", "claimed_interfaces": ["wheel/effort"]}
    outputs = {"state": "active", "claimed_interfaces": ["io/digital_outputs"]}
    assert commanded_interfaces([idle, base, outputs]) == {"wheel": "velocity", "gripper": "position"}


def test_command_actual_error_work_and_load_of_a_sample():
    values = Sampler().take(state(), {"wheel": "velocity"})
    assert values["wheel command"] == 3.0
    assert values["wheel actual"] == 2.0
    assert values["wheel error"] == 1.0
    assert (values["work"], values["load can"], values["cycle"]) == (0.5, 2.0, None)
    assert Sampler().take(state(), {"wheel": "position"})["wheel error"] == 2.0


def test_where_nobody_commands_the_hardware_holds():
    values = Sampler().take(state(command=None), {"wheel": "velocity"})
    assert (values["wheel command"], values["wheel error"]) == (0.0, -2.0)
    values = Sampler().take(state(command=None), {"wheel": "position"})
    assert (values["wheel command"], values["wheel error"]) == (1.0, 0.0)
    assert Sampler().take(state(velocity=None), {})["wheel actual"] is None


def test_the_cycle_time_is_what_passed_between_samples_per_cycle():
    sampler = Sampler()
    sampler.take(state(100.0, 10), {})
    assert sampler.take(state(100.1, 15), {})["cycle"] == pytest.approx(20.0)
    assert sampler.take(state(100.2, 15), {})["cycle"] is None
    assert sampler.take(state(100.3, 2), {})["cycle"] is None  # another run of the robot


@pytest.fixture
def plots(server):
    return Plots(server, server.gui.add_panel(), ["wheel", "slide"], ["can"], frozenset({"slide"}))


def test_titles_say_what_is_plotted_and_in_which_unit(plots):
    plots.name({"wheel": "velocity", "slide": "position"})
    titles = [chart.handle.title for chart in plots._charts]
    assert titles == [
        "wheel velocity, rad/s",
        "slide position, m",
        "Following error, m and rad/s",
        "Cycle time, ms",
        "Work in a cycle, ms",
        "Bus load, %",
    ]


def test_what_is_sampled_is_drawn(plots):
    plots.history.add(100.0, {"wheel command": 1.0, "wheel actual": 0.5})
    plots.history.add(100.1, {"wheel command": 1.0, "wheel actual": 0.9})
    plots.update()
    ages, command, actual = plots._charts[0].handle.data
    assert ages.tolist() == pytest.approx([-0.1, 0.0])
    assert (command.tolist(), actual.tolist()) == ([1.0, 1.0], [0.5, 0.9])


def test_a_joint_that_is_commanded_otherwise_begins_anew(plots):
    plots.name({"wheel": "velocity"})
    plots.history.add(100.0, {"work": 1.0})
    plots.name({"wheel": "velocity"})
    assert plots.history.columns(["work"])[1].tolist() == [1.0]
    plots.name({"wheel": "position"})
    assert plots.history.columns(["work"])[1].tolist() == [0.0]


def test_the_numbers_at_the_ends_of_a_scale_are_not_cut(plots):
    """uPlot draws them on the edge of the picture, half of them outside, where the scale ends with the number."""
    for chart in plots._charts:
        scale = chart.handle.scales["y"]["range"]
        assert scale["max"]["soft"] > 1.0
        assert scale["min"]["soft"] == 0.0 or scale["min"]["soft"] < -1.0


def test_a_small_chart_has_more_than_one_number(plots):
    """uPlot puts numbers 30 pixels apart: between -1 and 1.5 that left the 0 alone."""
    for chart in plots._charts:
        assert chart.handle.axes[1]["space"] <= chart.handle.height / 6
