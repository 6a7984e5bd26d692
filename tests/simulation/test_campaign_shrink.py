from hypothesis import given
from hypothesis import strategies as st

from canopen_control.simulation.campaign import Shrinker
from canopen_control.virtual.scenario import ScenarioEvent

S = 1_000_000_000


def act(at, kind="fault", name="", lasts=None):
    return ScenarioEvent(at * S, kind, "3", name, for_ns=None if lasts is None else lasts * S)


ACTS = tuple(act(second, name=f"f{second}", lasts=4) for second in range(1, 20))


def test_what_does_not_matter_is_left_out_and_the_rest_is_shortened():
    guilty = {"f5", "f12"}
    shrinker = Shrinker(lambda acts: guilty <= {item.name for item in acts})
    result = shrinker.shrink(ACTS)
    assert [item.name for item in result] == ["f5", "f12"]
    assert all(item.for_ns <= 20_000_000 for item in result)
    assert result[-1].at_ns < 2 * S
    assert shrinker.tries <= 150


def test_what_has_to_last_lasts():
    result = Shrinker(lambda acts: any(item.name == "f3" and item.for_ns >= S for item in acts)).shrink(ACTS)
    assert [(item.name, item.for_ns) for item in result] == [("f3", S)]


def test_what_nothing_smaller_breaks_stays_as_it_is():
    assert Shrinker(lambda acts: acts == ACTS).shrink(ACTS) == ACTS


@given(st.sets(st.integers(1, 19), min_size=1, max_size=4))
def test_what_is_found_breaks_within_the_tries(needed):
    names = {f"f{number}" for number in needed}

    def breaks(acts):
        return names <= {item.name for item in acts}

    shrinker = Shrinker(breaks, most=40)
    assert breaks(shrinker.shrink(ACTS))
    assert shrinker.tries <= 40
