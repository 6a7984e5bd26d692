"""One request to a hub process, answered or refused in a sentence."""

from __future__ import annotations

import pytest

from canopen_control.bus.hubclient import ask_hub
from canopen_control.bus.local import open_local
from canopen_control.errors import BusError, ConfigError


def test_a_hub_answers(runtime):
    port = open_local("asked", "me")
    assert ask_hub("asked", "status")["members"][0]["label"] == "me"
    assert ask_hub("asked", "cut", label="me") == {}
    assert ask_hub("asked", "status")["cut"] == ["me"]
    with pytest.raises(ConfigError, match="nobody called 'you' on local:asked; there are: me"):
        ask_hub("asked", "cut", label="you")
    port.close()


def test_a_bus_that_nobody_has_open_is_said_to_be_so(runtime):
    with pytest.raises(BusError, match="bus local:none: nobody has it open"):
        ask_hub("none", "status")
