"""The verbs that every mode's target has, and the slope of a stop that the master makes."""

import math
from types import SimpleNamespace

import pytest

from canopen_control.hardware.mode_target import ModeTarget, stop_slope

pytestmark = pytest.mark.sources  # compiled classes take no stand-ins


def axis(deceleration=math.inf):
    return SimpleNamespace(limits=SimpleNamespace(deceleration=deceleration, blocked=0))


def target():
    return ModeTarget(axis(), SimpleNamespace(value=0), SimpleNamespace())


@pytest.mark.parametrize(("told", "slope"), [(4000.0, 4000.0), (math.inf, 200.0), (0.0, 200.0), (math.nan, 200.0)])
def test_a_drive_that_tells_no_deceleration_is_stopped_in_half_a_second(told, slope):
    assert stop_slope(axis(told), 100) == slope


def test_a_target_of_no_mode_pushes_nowhere_and_has_no_events():
    assert not target().pushes(1.0)
    assert target().events() == ()


@pytest.mark.parametrize("verb", ["hold", "span"])
def test_what_a_mode_must_say_itself_has_no_default(verb):
    with pytest.raises(NotImplementedError):
        getattr(target(), verb)()
