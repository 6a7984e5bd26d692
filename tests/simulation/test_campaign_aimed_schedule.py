import pytest
from support.simulated import MS, S, setup_of

from canopen_control.simulation.campaign import _WAYS, Campaign, cells_to_aim_at, targeted_schedule
from canopen_control.simulation.fault_coverage import STATES, cells_of
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.random_schedule import known_faults
from canopen_control.simulation.scenario_events import KINDS

FAULTS = known_faults()


def test_what_is_aimed_at_is_empty_and_from_all_over_the_table():
    every = cells_to_aim_at((), FAULTS, 100_000)
    assert set(every) <= set(cells_of(FAULTS))
    some = cells_to_aim_at(set(every[:50]), FAULTS, 40)
    assert len(some) == len(set(some)) == 40
    assert not set(some) & set(every[:50])
    assert {machine for machine, _, _ in some} == set(STATES)
    assert cells_to_aim_at(set(every[1:]), FAULTS, 40) == every[:1]


@pytest.mark.parametrize("cell", cells_to_aim_at((), FAULTS, 60))
def test_a_schedule_strikes_once_in_the_state_with_the_kind(cell):
    acts = targeted_schedule(3, cell, motions_of(setup_of()), [2, 3])
    assert acts == targeted_schedule(3, cell, motions_of(setup_of()), [2, 3])
    assert list(acts) == sorted(acts, key=lambda act: act.at_ns)
    [strike] = [act for act in acts if act.when]
    assert strike.when == f"{cell[0]} {cell[1]}"
    assert (strike.name or strike.kind) == cell[2]
    assert KINDS[strike.kind].breaks


def test_the_states_that_are_aimed_at_are_states():
    assert {(machine, state) for machine, state in _WAYS} <= {
        (machine, state) for machine, states in STATES.items() for state in states
    }


@pytest.mark.rest
@pytest.mark.parametrize(
    "cell",
    [
        ("axis power", "ENABLING", "warning"),
        ("axis power", "DISABLING", "lose"),
        ("CiA 402", "FAULT_REACTION_ACTIVE", "cut"),
        ("CiA 402", "SWITCHED_ON", "stall"),
        ("NMT", "PRE_OPERATIONAL", "drive_fault"),
        ("boot", "BOOTING", "power"),
        ("boot", "WAITING", "double"),
    ],
)
def test_a_seed_that_is_aimed_hits(cell):
    campaign = Campaign(setup_of(), S, FAULTS)
    others = set(cells_to_aim_at((), FAULTS, 100_000)) - {cell}
    assert campaign.aim(range(7, 10), others) == [7]
    result = campaign.run_seed(7)
    assert cell in result.cells
    assert result.breaches == ()
    assert result.robot_s >= 7.0


def test_a_seed_that_is_not_aimed_is_drawn():
    campaign = Campaign(setup_of(), S, FAULTS)
    assert campaign.run_seed(7).robot_s == pytest.approx(1.0)
    assert all(not act.when for act in campaign.schedule(7))


@pytest.mark.parametrize("seed", [35, 0])
def test_the_seed_of_a_cable_that_is_cut_as_a_drive_faults_breaks_nothing(seed):
    campaign = Campaign(setup_of(), S, FAULTS)
    campaign._aims[seed] = "CiA 402", "FAULT_REACTION_ACTIVE", "cut"
    [cut] = [act for act in campaign.schedule(seed) if act.kind == "cut"]
    assert cut.for_ns is not None
    assert cut.for_ns >= 50 * MS
    assert campaign.run_seed(seed).breaches == ()
