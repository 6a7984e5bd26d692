import pytest

from canopen_control.rpc.messages.health import Health, diagnose, diagnose_axis, diagnose_node, stale
from canopen_control.rpc.messages.state import AxisReading, NodeReading

ON, OFF = "OPERATION_ENABLED", "SWITCH_ON_DISABLED"
THERE = {"ready": True, "nmt": "OPERATIONAL", "error": None}


@pytest.mark.parametrize(
    ("states", "changes", "verdict"),
    [
        ([ON], {}, (Health.OK, "operational")),
        ([], {}, (Health.OK, "operational")),
        ([ON, OFF], {}, (Health.WARN, "not enabled: switch on disabled")),
        ([None], {}, (Health.WARN, "not enabled: no statusword")),
        ([ON], {"error": "EMCY 0x8130"}, (Health.WARN, "EMCY 0x8130")),
        ([OFF], {"error": "EMCY 0x8130"}, (Health.ERROR, "EMCY 0x8130")),
        (["FAULT"], {}, (Health.ERROR, "the drive is in fault")),
        ([ON, "FAULT_REACTION_ACTIVE"], {"error": "too hot"}, (Health.ERROR, "too hot")),
        ([OFF], {"ready": False, "nmt": "PRE_OPERATIONAL"}, (Health.WARN, "not ready, NMT state pre operational")),
        ([ON], {"ready": False, "nmt": None}, (Health.ERROR, "not ready, NMT state unknown")),
        ([ON], {"ready": False, "error": "no heartbeat"}, (Health.ERROR, "no heartbeat")),
    ],
)
def test_a_drive_is_judged_by_what_is_worst(states, changes, verdict):
    assert diagnose(states, **{**THERE, **changes}) == verdict


def test_no_news_is_stale():
    assert stale(0.1, 0.5, is_known=True) is None
    assert stale(None, 0.5, is_known=True) is None
    assert stale(0.75, 0.5, is_known=True) == (Health.STALE, "no news for 0.75 s")
    assert stale(None, 0.5, is_known=False) == (Health.STALE, "no message was received from it")


def test_a_node_is_judged_with_all_its_axes_and_an_axis_alone():
    fault, on = AxisReading("a", state="FAULT", error="a is hot"), AxisReading("b", 1, ON)
    node = NodeReading(name="n", node_id=3, nmt_state="OPERATIONAL", ready=True, age=0.1, axes=(fault, on))
    assert diagnose_node(node) == diagnose_axis(node, fault) == (Health.ERROR, "a is hot")
    assert diagnose_axis(node, on) == (Health.OK, "operational")
    unseen = NodeReading(name="n", node_id=3, nmt_state="PRE_OPERATIONAL")
    assert diagnose_node(unseen) == diagnose_axis(unseen, None) == (Health.ERROR, "not ready, NMT state unknown")
