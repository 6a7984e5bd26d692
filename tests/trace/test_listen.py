import pytest
from support.localbus import end_hubs

from canopen_control.bus.channel import open_port
from canopen_control.bus.memory import MemoryBus
from canopen_control.bus.port import BusEvent, BusEventKind
from canopen_control.errors import BusNotOpen, ConfigError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.sockets import list_sockets
from canopen_control.trace.listen import batches, open_listener


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        self.now += 0.1
        return self.now


def test_frames_come_in_batches_and_a_silent_bus_gives_empty_ones():
    bus = MemoryBus.get("listening")
    listener, sender = bus.open("trace"), bus.open("drive")
    sender.send(pack_records([CanFrame(0x80), CanFrame(0x183, b"\x37\x06")]))
    received = batches(listener, 0.55, clock=Clock())
    first = next(received)
    assert [item.frame for item in first] == [CanFrame(0x80), CanFrame(0x183, b"\x37\x06")]
    assert first[0].time_ns > 1_600_000_000 * 10**9  # Unix time
    assert list(received)[-1] == []  # and it ends
    assert listener.stats.tx == 0
    listener.close()
    sender.close()


def test_what_happens_to_the_channel_comes_after_the_frames_before_it():
    bus = MemoryBus.get("listening")
    listener, sender = bus.open("trace"), bus.open("drive")
    sender.send(pack_records([CanFrame(0x80)]))
    down, passive = BusEvent(BusEventKind.DOWN, "gone"), BusEvent(BusEventKind.ERROR_PASSIVE, "in a frame")
    listener.events = lambda: [passive, down]
    order = []
    for batch in batches(listener, 0.15, clock=Clock(), on_event=order.append):
        order += [item.frame for item in batch]
    assert order[:2] == [CanFrame(0x80), down]
    assert passive not in order
    listener.close()
    sender.close()


@pytest.mark.process
def test_a_listener_does_not_create_a_bus(private_folders):
    with pytest.raises(BusNotOpen, match="bus local:typo: no program has it open; no local bus is open now"):
        open_listener("local:typo", "trace")
    assert list_sockets("bus") == []
    port = open_port("local:robby", label="master")
    with pytest.raises(BusNotOpen, match="open now: local:robby"):
        open_listener("local:typo", "trace")
    open_listener("local:robby", "trace").close()
    port.close()
    end_hubs()


def test_frames_that_no_other_member_can_receive_are_reported():
    with pytest.raises(ConfigError, match="inside one process"):
        open_listener("memory:x", "trace")
    with pytest.raises(ConfigError, match="one owner, the running robot robby"):
        open_listener("pcan:PCAN_USBBUS1", "trace", owner="robby")
