import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.simulated import S, setup_of

from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot, SetGrip
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.random_schedule import draw_schedule, known_faults
from canopen_control.simulation.scenario_steps import read_scenario_steps, scenario_text
from canopen_control.virtual.scenario import ScenarioError, ScenarioEvent


def read(folder, text, *, name="scenario.yml", physics=False):
    path = folder / name
    path.write_text(text)
    return read_scenario_steps(path, dataclasses.replace(setup_of(), physics=physics))


def test_a_scenario_reports_what_happens_and_when(tmp_path):
    scenario = read(
        tmp_path,
        """
for: 20s
seed: 7
steps:
  - {at: 2s, node: 3, fault: heartbeat_lost, for: 1s}
  - {at: 1s, do: command, target: robby_forward_controller, values: [5, 5], for: 500ms}
  - {at: 3, do: axis, name: enable}
  - {at: 4s, do: stall, target: master, for: 300ms}
  - {at: 5s, node: 3, plant: {position: 4}}
  - {at: 6s, node: 3, fault: silent, state: off}
  - {at: 7s, node: 3, quirk: brake_delay=0.5, for: 1s}
  - {at: 9s, node: 2, quirk: remote_never, state: off}
""",
    )
    assert (scenario.duration_ns, scenario.seed) == (20 * S, 7)
    assert scenario.acts == (
        ScenarioEvent(S, "command", "robby_forward_controller", values=(5.0, 5.0), for_ns=S // 2),
        ScenarioEvent(2 * S, "fault", "3", "heartbeat_lost", for_ns=S),
        ScenarioEvent(3 * S, "axis", name="enable"),
        ScenarioEvent(4 * S, "stall", "master", for_ns=300_000_000),
        ScenarioEvent(5 * S, "plant", "3", plant=(("position", 4.0),)),
        ScenarioEvent(6 * S, "fault_off", "3", "silent"),
        ScenarioEvent(7 * S, "quirk", "3", "brake_delay=0.5", for_ns=S),
        ScenarioEvent(9 * S, "quirk_off", "2", "remote_never"),
    )


@pytest.mark.parametrize(
    ("step", "text"),
    [
        ("{at: 1s, do: dance}", "do: 'dance' is not a kind of event"),
        ("{at: soon, do: stop}", "'soon' is not a time"),
        (
            "{at: 1s, do: command, target: robby_foward_controller, values: [1]}",
            "did you mean 'robby_forward_controller'?",
        ),
        ("{at: 1s, node: 9, fault: silent}", "needs a node of this robot, not 9; available: 3, 2"),
        ("{at: 1s, node: 3, fault: silnt}", "no fault 'silnt' (did you mean 'silent'?)"),
        ("{at: 1s, node: 3, quirk: brake_delay=0.5@7}", "node 3 has no axis 7; it has: 0"),
        ("{at: 1s, node: 3, axis: 1, plant: {load_torque: 0.1}}", "node 3 has no axis 1; it has: 0"),
        ("{at: 1s, node: 3, quirk: brake_dely}", "no quirk 'brake_dely' (did you mean 'brake_delay'?)"),
        ("{at: 1s, node: 3, quirk: brake_delay=99}", "the strength must be a number, 0.001 to 60 s"),
        ("{at: 1s, do: axis, name: fly}", "name: fly is not an action"),
        ("{at: 1s, do: stop, for: 2s}", "for: is not possible with stop"),
        ("{at: 1s, do: stop, values: [2]}", "values: is not possible with stop"),
        ("{at: 1s, do: stop, name: it}", "name: is not possible with stop"),
        ("{at: 1s, do: stop, target: 3}", "target: is not possible with stop"),
        ("{at: 1s, do: cut}", "target: none is not a member of a bus"),
        ("{at: 1s, do: frame, values: [0x900]}", "values: a frame needs an identifier"),
        ("{at: 1s, do: frame, values: [1.5]}", "values: a frame needs an identifier"),
        ("{at: 1s, do: frame, values: [.nan]}", "values: a frame needs an identifier"),
        ("{at: 1s, do: lose, target: 2, values: [0]}", "values: lose needs one integer n of 1 or more"),
        ("{at: 1s, do: disturb, target: 2, values: [1.5]}", "values: disturb needs one integer"),
        ("{at: 1s, do: double, target: 2, values: [1, 2]}", "values: double needs one integer"),
    ],
)
def test_an_error_is_reported_with_its_line(tmp_path, step, text):
    with pytest.raises(ScenarioError, match=r"scenario\.yml:2:") as caught:
        read(tmp_path, f"steps:\n  - {step}\n")
    assert text in str(caught.value)


def test_all_errors_are_reported_at_once(tmp_path):
    with pytest.raises(ScenarioError) as caught:
        read(tmp_path, "steps:\n  - {at: 1s, do: dance}\n  - {at: 2s, do: sing}\nseed: x\n")
    assert len([line for line in str(caught.value).splitlines() if "scenario.yml:" in line]) >= 1
    with pytest.raises(ScenarioError, match="for: a simulation of 0 s does nothing"):
        read(tmp_path, "for: 0s\nsteps: []\n")


def test_a_step_behind_the_end_is_reported_with_its_line(tmp_path):
    with pytest.raises(ScenarioError, match=r"3:5: steps\[0\]: at: 5 s is after the end of the scenario at 2 s"):
        read(tmp_path, "for: 2s\nsteps:\n  - {at: 5s, do: stop}\n  - {at: 2s, do: stop}\n")


@pytest.mark.parametrize("seed", ["abc", "-4", "1.5"])
def test_a_seed_that_is_not_a_whole_number_from_0_on_is_reported_with_its_line(tmp_path, seed):
    with pytest.raises(ScenarioError, match=r"scenario\.yml:1:7: seed: "):
        read(tmp_path, f"seed: {seed}\nsteps: []\n")


def test_a_trajectory_of_several_points_is_written_and_read(tmp_path):
    act = ScenarioEvent(S, "trajectory", "robby_base_controller", values=(0.25, 0.5, 1.0, 2.0), times=(0.5, 1.0))
    path = tmp_path / "points.yml"
    path.write_text(scenario_text([act], seed=1, duration_ns=2 * S))
    assert read_scenario_steps(path, setup_of()).acts == (act,)


@pytest.mark.parametrize("times", ["[1, 0.5]", "[0, 1]", "[1, 2, 3]", "[1, 1]"])
def test_times_of_points_grow_and_have_values(tmp_path, times):
    path = tmp_path / "points.yml"
    step = f"{{at: 1s, do: trajectory, target: robby_base_controller, values: [1, 2, 3, 4], times: {times}}}"
    path.write_text(f"steps:\n  - {step}\n")
    with pytest.raises(ScenarioError, match="times: write increasing times above 0 in s"):
        read_scenario_steps(path, setup_of())


@pytest.mark.rest
@given(st.integers(0, 500))
def test_what_is_written_reads_as_the_same(tmp_path_factory, seed):
    acts = draw_schedule(seed, 30 * S, motions_of(setup_of()), (2, 3), known_faults())
    text = scenario_text(acts, seed=seed, duration_ns=30 * S, note="of a test")
    scenario = read(tmp_path_factory.mktemp("scenario"), text)
    assert (scenario.acts, scenario.seed, scenario.duration_ns) == (acts, seed, 30 * S)


def test_a_step_waits_for_a_state_that_there_is(tmp_path):
    read_steps = read(tmp_path, "steps:\n  - {at: 1s, do: stall, target: 3, when: axis power RAMPING_DOWN}\n")
    assert [act.when for act in read_steps.acts] == ["axis power RAMPING_DOWN"]
    text = scenario_text(read_steps.acts, seed=0, duration_ns=S)
    assert "when: axis power RAMPING_DOWN" in text
    assert read(tmp_path, text).acts == read_steps.acts
    with pytest.raises(ScenarioError, match=r"when: 'NMT STOPED' is not a state \(did you mean 'NMT STOPPED'"):
        read(tmp_path, "steps:\n  - {at: 1s, do: kill, when: NMT STOPED}\n")


@pytest.mark.parametrize(
    ("step", "former", "kind", "when"),
    [
        ("{at: 1s, do: heal, target: 3, name: silent}", "do: heal is now called fault_off", "fault_off", ""),
        (
            "{at: 1s, do: kill, when: axis power SETTLING}",
            "when: axis power SETTLING is now called axis power AWAITING_STANDSTILL",
            "kill",
            "axis power AWAITING_STANDSTILL",
        ),
    ],
)
def test_former_names_are_accepted_with_a_warning(tmp_path, step, former, kind, when):
    scenario = read(tmp_path, f"steps:\n  - {step}\n")
    assert [(act.kind, act.when) for act in scenario.acts] == [(kind, when)]
    (warning,) = scenario.warnings
    assert f"{former}; the former name is still accepted" in warning


def on_a_floor(folder, steps):
    return read(folder, f"steps:\n{steps}", name="floor.yml", physics=True).acts


def test_what_happens_in_the_world_is_written_and_read(tmp_path):
    acts = on_a_floor(
        tmp_path,
        """
  - {at: 1s, payload: {mass: 8.5, on: base_link, position: [0, 0.5, 1]}}
  - {at: 2s, push: {force: [0, 60, 0], seconds: 0.3}}
  - {at: 3s, block: left_wheel_joint, for: 2s, when: axis power RAMPING_DOWN}
  - {at: 4s, do: world, friction: 0.3}
""",
    )
    assert acts == (
        ScenarioEvent(S, "world", world=AddPayload(mass=8.5, on="base_link", position=(0.0, 0.5, 1.0))),
        ScenarioEvent(2 * S, "world", world=PushRobot(force=(0.0, 60.0, 0.0), seconds=0.3)),
        ScenarioEvent(
            3 * S, "world", for_ns=2 * S, when="axis power RAMPING_DOWN", world=BlockJoint(joint="left_wheel_joint")
        ),
        ScenarioEvent(4 * S, "world", world=SetGrip(friction=0.3)),
    )
    text = scenario_text(acts, seed=0, duration_ns=5 * S)
    assert on_a_floor(tmp_path, text.partition("steps:\n")[2]) == acts


@pytest.mark.parametrize(
    ("step", "text"),
    [
        ("{at: 1s, payload: {mass: 8, on: base_lnk}}", "on: the robot has no link 'base_lnk' (did you mean"),
        ("{at: 1s, block: left_wheel}", "block: no drive moves a joint 'left_wheel' (did you mean 'left_wheel_joint'"),
        ("{at: 1s, push: {force: [0, 9, 0]}, for: 1s}", "for: is not possible with payload, push and friction"),
        ("{at: 1s, friction: 1, block: left_wheel_joint}", "a step can have one of payload, push, block and friction"),
        ("{at: 1s, friction: 1, node: 3}", "a step can have one of payload, push, block and friction"),
        ("{at: 1s, friction: 1, do: stop}", "a step can have one of payload, push, block and friction"),
        ("{at: 1s, friction: 1, when: now}", "when: 'now' is not a state"),
        ("{at: 1s, do: world}", "a step needs one of do, fault, quirk and plant"),
    ],
)
def test_an_error_of_what_happens_in_the_world_is_reported_once(tmp_path, step, text):
    with pytest.raises(ScenarioError, match=r"floor\.yml:2:5") as caught:
        on_a_floor(tmp_path, f"  - {step}\n")
    assert text in str(caught.value)
    assert str(caught.value).count("floor.yml:") == 1


def test_without_a_floor_nothing_happens_in_a_world(tmp_path):
    with pytest.raises(
        ScenarioError, match="payload, push, block and friction need a physics simulation: add --physics"
    ):
        read(tmp_path, "steps:\n  - {at: 1s, friction: 0.5}\n")


def test_a_step_without_anything_that_happens_is_reported_once(tmp_path):
    with pytest.raises(ScenarioError, match="a step needs one of") as caught:
        read(tmp_path, "steps:\n  - {at: 1s}\n")
    assert str(caught.value).count("scenario.yml:") == 1
