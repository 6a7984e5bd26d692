"""Traffic of interfaces, computed from two samples of the kernel's counters."""

from __future__ import annotations

import pytest

from canopen_control.bus.can_interfaces import CanInterface, Traffic, measure

CAN0 = CanInterface("can0", "can", is_up=True, bitrate=500_000)
VCAN0 = CanInterface("vcan0", "vcan", is_up=True)


class Counters:
    def __init__(self, folder):
        self.folder = folder
        self.now, self.steps = 10.0, {}

    def set(self, name, **values):
        (self.folder / name / "statistics").mkdir(parents=True, exist_ok=True)
        for item in ("rx_packets", "rx_bytes", "tx_packets", "tx_bytes"):
            (self.folder / name / "statistics" / item).write_text(f"{values.get(item, 0)}\n")

    def sleep(self, seconds):
        self.now += seconds
        for name, values in self.steps.items():
            self.set(name, **values)

    def measure(self, *links):
        return measure(links, 0.5, sleep=self.sleep, clock=lambda: self.now, network_class=self.folder)


@pytest.fixture
def counters(tmp_path):
    return Counters(tmp_path)


def test_frames_of_both_ways_are_the_load_of_a_controllers_bus(counters):
    counters.set("can0", rx_packets=100, rx_bytes=800, tx_packets=50, tx_bytes=50)
    counters.steps["can0"] = {"rx_packets": 600, "rx_bytes": 4800, "tx_packets": 150, "tx_bytes": 150}
    bits = 47 * 600 + 8 * 4100
    assert counters.measure(CAN0) == {"can0": Traffic(1200.0, pytest.approx(bits / 0.5 / 500_000))}


def test_a_virtual_interface_that_counts_twice_is_counted_once_and_has_no_load(counters):
    counters.set("vcan0")
    counters.steps["vcan0"] = dict.fromkeys(("rx_packets", "rx_bytes", "tx_packets", "tx_bytes"), 100)
    assert counters.measure(VCAN0) == {"vcan0": Traffic(200.0, None)}


def test_interfaces_that_are_down_or_removed_are_omitted_without_waiting(counters):
    down = CanInterface("can1", "can", is_up=False)
    assert counters.measure(down) == {}
    assert counters.now == 10.0
    assert counters.measure(CAN0) == {}
