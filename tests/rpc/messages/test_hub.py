import pytest

from canopen_control.rpc.messages.declare import Effect
from canopen_control.rpc.messages.hub import HUB, Cut, DelayFrames, DropFrames, HubStatus, SendErrorFrame, SetBitrate
from canopen_control.rpc.wire import convert


@pytest.mark.parametrize("method", HUB.methods.values(), ids=lambda each: each.name)
def test_every_method_reports_what_it_does_and_moves_nothing(method):
    assert method.text.endswith(".")
    assert method.effect in (Effect.READS, Effect.CHANGES)


@pytest.mark.parametrize(
    ("kind", "params"),
    [
        (Cut, {"label": None}),
        (DropFrames, {"can_id": 1 << 32}),
        (DropFrames, {"every": 0}),
        (DelayFrames, {"ms": 60_001}),
        (SendErrorFrame, {"kind": "sparks"}),
        (SetBitrate, {"bitrate": 1_000_001}),
    ],
)
def test_what_is_out_of_range_is_not_a_request(kind, params):
    with pytest.raises(ValueError, match=r"at `\$\."):
        convert(params, kind)


def test_a_newer_hub_may_report_more():
    status = dict.fromkeys(("pid", "uptime_s", "frames", "dropped", "temperature"), 0)
    status |= {"bus": "robby", "bitrate": None, "load": None, "delays_ms": {}}
    status |= {name: [] for name in ("members", "cut", "bus_off", "drops")}
    assert convert(status, HubStatus).bus == "robby"
