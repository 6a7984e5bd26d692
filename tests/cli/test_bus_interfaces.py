"""Output of `bus status` for an interface."""

from __future__ import annotations

import pytest

from canopen_control.bus.can_interfaces import CanInterface, Listener, Traffic
from canopen_control.cli import bus
from canopen_control.cli.bus import render_interface, status_of_interfaces
from canopen_control.rpc.wire import plain

CAN0 = CanInterface("can0", "can", is_up=True, state="ERROR-ACTIVE", bitrate=1_000_000, error_counters=(0, 0))
VCAN0 = CanInterface("vcan0", "vcan", is_up=True, traffic={"tx_packets": 7, "rx_dropped": 0})


@pytest.fixture
def kernel(monkeypatch):
    """Return what sets the listeners and how many sockets hear."""

    def put(result=(), hearing=0, traffic=None):
        monkeypatch.setattr(bus, "measure", lambda links, _seconds: traffic or {})
        monkeypatch.setattr(bus, "find_listeners", lambda _name: list(result))
        monkeypatch.setattr(bus, "count_hearing", lambda _name: hearing)

    return put


def lines(link):
    status = status_of_interfaces([link])[link.name]
    written = plain(status)
    assert (written["name"], len(written["listeners"])) == (link.name, len(status.listeners))
    assert {"frames_per_second", "load", "unnamed_listeners"} < set(written)
    return render_interface(status)


def test_load_and_frames_are_reported_with_where_there_are_any(kernel):
    kernel(traffic={"can0": Traffic(3906.2, 0.412)})
    assert lines(CAN0) == [
        "can0: can, up, ERROR-ACTIVE, 1000000 bit/s, transmit errors 0, receive errors 0, 3906 frames/s, load 41 %"
    ]
    kernel(traffic={"vcan0": Traffic(350.0, None)})
    assert lines(VCAN0) == ["vcan0: vcan, up, 350 frames/s", "  tx_packets 7"]


def test_every_listener_is_one_line_that_reports_what_it_does(kernel):
    kernel(
        [
            Listener(9, "canopen-control run robby --can vcan0", "CAN_RAW", "vcan0", 13),
            Listener(
                9, "canopen-control run robby --can vcan0", "CAN_BCM", "vcan0", 0, ((0x80, 20_000), (0x90, 1_500))
            ),
            Listener(10, "candump vcan0", "CAN_RAW", "vcan0", -1),
            Listener(11, "candump any", "CAN_RAW", "", -1),
            Listener(12, "cangen vcan0", "CAN_RAW", "vcan0", 0),
            Listener(13, "x" * 80, "CAN_RAW", "vcan0", 1),
            Listener(14, "other", "CAN_RAW", None),
            Listener(15, "isotprecv", "CAN_ISOTP", "vcan0"),
            Listener(16, "watcher", "CAN_BCM", "vcan0"),
        ],
        hearing=9,
    )
    assert lines(VCAN0)[2:] == [
        "  canopen-control run robby --can vcan0 (pid 9) receives 13 identifiers",
        "  canopen-control run robby --can vcan0 (pid 9) has the kernel send 0x080 every 20 ms, "
        "has the kernel send 0x090 every 1.5 ms",
        "  candump vcan0 (pid 10) receives everything",
        "  candump any (pid 11) receives everything, of all interfaces",
        "  cangen vcan0 (pid 12) only sends",
        f"  {'x' * 57}... (pid 13) receives one identifier",
        "  other (pid 14) receives some identifiers, on an interface that only root can see",
        "  isotprecv (pid 15) has a socket of CAN_ISOTP",
        "  watcher (pid 16) uses the kernel's broadcast manager",
        "  3 more, of other users: run this with sudo to see their names",
    ]


def test_sockets_that_only_root_can_name_are_counted(kernel):
    kernel([Listener(10, "candump vcan0", "CAN_RAW", "vcan0", -1)], hearing=1)
    assert len(lines(VCAN0)) == 3
    kernel(hearing=2)
    assert lines(VCAN0)[-1] == "  2 more, of other users: run this with sudo to see their names"
