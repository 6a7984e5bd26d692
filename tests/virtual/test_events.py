from __future__ import annotations

import dataclasses

import pytest

from canopen_control.virtual import events


@pytest.mark.parametrize("name", events.__all__)
def test_events_are_plain_frozen_data(name):
    kind = getattr(events, name)
    assert dataclasses.is_dataclass(kind)
    assert kind.__dataclass_params__.frozen
