from __future__ import annotations

import dataclasses

import pytest

from canopen_control.cia402.state import State
from canopen_control.virtual import events


@pytest.mark.parametrize("name", events.__all__)
def test_events_are_plain_frozen_data(name):
    kind = getattr(events, name)
    assert dataclasses.is_dataclass(kind)
    assert kind.__dataclass_params__.frozen
    assert events.ModeChanged(0, 3) == events.ModeChanged(0, 3)
    assert events.DriveStateChanged(0, State.FAULT, State.SWITCH_ON_DISABLED).state is State.SWITCH_ON_DISABLED
