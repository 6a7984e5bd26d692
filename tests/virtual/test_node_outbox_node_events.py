from __future__ import annotations

import dataclasses

import pytest

from canopen_control.cia301.nmt import NmtState, NmtStateChanged
from canopen_control.cia402.state import State
from canopen_control.virtual import node_outbox
from canopen_control.virtual.node_outbox import (
    DriveFaulted,
    DriveStateChanged,
    EmergencyRaised,
    FaultSwitched,
    HeartbeatMissed,
    ModeChanged,
    in_words,
)


@pytest.mark.parametrize("name", [name for name, kind in vars(node_outbox).items() if dataclasses.is_dataclass(kind)])
def test_events_are_plain_frozen_data(name):
    kind = getattr(node_outbox, name)
    assert dataclasses.is_dataclass(kind)
    assert kind.__dataclass_params__.frozen


@pytest.mark.parametrize(
    ("event", "words"),
    [
        (NmtStateChanged(NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL), "NMT OPERATIONAL"),
        (DriveStateChanged(0, State.SWITCHED_ON, State.OPERATION_ENABLED), "SWITCHED_ON -> OPERATION_ENABLED"),
        (DriveFaulted(1, 0x4310), "axis 1: fault 0x4310 (drive temperature too high)"),
        (ModeChanged(0, 3), "mode PV"),
        (EmergencyRaised(0), "error reset"),
        (EmergencyRaised(0x8130, b"\0\xff"), "EMCY 0x8130 (life guard or heartbeat error), data 00 ff"),
        (HeartbeatMissed(1, missed=True), "heartbeat of node 1 lost"),
        (HeartbeatMissed(0, missed=False), "guarding is back"),
        (FaultSwitched("silent", on=True), "fault silent on"),
        (object(), None),
    ],
)
def test_each_event_has_its_words(event, words):
    assert in_words(event) == words
