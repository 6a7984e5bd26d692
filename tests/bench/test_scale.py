"""The scale bench: periods by arithmetic; a fleet on a bus that is as slow as its wire loses nothing."""

import pytest
from canopen_control_bench import scale
from canopen_control_bench.cycle import Arena
from canopen_control_bench.stage import stage

from canopen_control.errors import CanopenError
from canopen_control.rpc.messages.hub import DropFrames, SetBitrate

pytestmark = pytest.mark.process


@pytest.mark.parametrize(
    ("count", "bitrate", "least_ms"), [(2, 1_000_000, 0.935), (64, 1_000_000, 28.2), (2, 125_000, 7.4)]
)
def test_the_shortest_period_has_room_for_the_worst_frames_and_little_more(count, bitrate, least_ms):
    with stage() as played:
        period_ms = scale.shortest_period_us(played, count, bitrate) / 1000
    assert least_ms < period_ms < 1.35 * least_ms + 1.0


def test_two_drives_on_a_bus_of_one_megabit_lose_no_tpdo():
    with stage() as played:
        figure = scale._on_the_wire(Arena(played, 2, 10_000, base=False), 1.0)
    assert figure.good, figure


def test_a_dropped_frame_is_seen(monkeypatch):
    asked = scale.ask_hub

    def with_a_fault(bus, request):
        if isinstance(request, SetBitrate) and request.bitrate:
            asked(bus, DropFrames(can_id=0x283, count=1))
        return asked(bus, request)

    monkeypatch.setattr(scale, "ask_hub", with_a_fault)
    with stage() as played, pytest.raises(CanopenError, match="the hub dropped"):
        scale._on_the_wire(Arena(played, 2, 10_000, base=False), 0.5)


def test_a_cycle_takes_the_drives_of_all_buses(monkeypatch):
    monkeypatch.setattr(scale, "_CYCLES", 60)
    turn, absolutes = scale._at_100_hz(4, 2)
    assert turn.cycles == 60
    assert absolutes["TPDOs of those due"] == 1.0
    assert {"drives", "drives of bench1"} <= turn.others_ns.keys()


def test_drives_that_do_not_answer_are_no_figure(monkeypatch):
    monkeypatch.setattr(scale, "_CYCLES", 60)
    monkeypatch.setattr(scale, "_LATE", -60)
    with pytest.raises(CanopenError, match="of the TPDOs came"):
        scale._at_100_hz(2)
