"""Devices that fail during a run, and devices that cannot be tested: the report, or one sentence."""

from dataclasses import replace

import pytest

from canopen_control.conformance.check import CheckTouch
from canopen_control.conformance.run import choose, run_checks
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.od.eds import read_eds
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeHost
from canopen_control.virtual.quirks import switches_of

EDS = data_path("eds", "generic_cia402.eds")
READING = choose("301", [CheckTouch.READ])


def run_with(node, act, at=3):
    """Run the checks that read; `act` is called before one of them."""
    return run_checks(node, READING, lambda done, _total: act() if done == at else None)


def reasons(report):
    return {result.observed for result in report.results if result.observed.startswith("not run: ")}


def test_a_device_that_answers_late_is_named_with_its_time(bench):
    node = bench()
    report = run_with(node, lambda: switches_of(node.device).set("sdo_late=0.8", True, node.reactor.now()))
    assert reasons(report) == {"not run: the device answers after 0.8 s, later than 0.5 s; give --timeout 1.6"}
    assert report.failed


def test_a_device_that_changes_its_node_id_is_found_there(bench):
    node = bench()

    def other_id():
        node.host.close()
        device = make_device(EDS, 9)
        device.store.preset(0x1018, 4, node.device.store.number(0x1018, 4))
        node.host = NodeHost(node.reactor, node.bus.open("other"), [device])

    report = run_with(node, other_id)
    assert reasons(report) == {"not run: the device changed its node-ID: node 9 has its identity now"}
    node.host.close()


def test_a_device_that_floods_the_bus_ends_in_a_report_that_states_this(bench):
    node = bench()
    flood = pack_records([CanFrame(0x85, bytes(8))] * 5)
    port = node.bus.open("flood")

    def send():
        port.send(flood)
        node.reactor.call_later(1_000_000, send)

    report = run_checks(node, READING[:12], lambda done, _total: send() if done == 3 else node.listen(0.3))
    assert "0x085 was received 5" in report.results[-2].observed
    assert report.results[-2].verdict == "failed"
    assert len(report.results) == 14


def test_a_device_that_dies_while_it_floods_is_both(bench):
    node = bench()
    port = node.bus.open("flood")

    def die():
        node.host.close()
        port.send(pack_records([CanFrame(0x85, bytes(8))] * 3000))

    assert reasons(run_with(node, die)) == {
        "not run: the device stopped answering; 0x085 was received 3000 times in a second"
    }


def test_two_nodes_with_one_id_are_refused(bench):
    node = bench()
    twin = NodeHost(node.reactor, node.bus.open("twin"), [make_device(EDS, 5)])
    node.reactor.run_for(100_000_000)
    with pytest.raises(ConfigError, match=r"two nodes on memory:.* answer as node 5; disconnect one of them"):
        run_checks(node, READING)
    twin.close()


def test_the_eds_of_another_device_is_refused(bench):
    node = bench("TMCM-1270.eds")
    vendor = int.from_bytes(node.read(0x1018, 1), "little")
    assert vendor
    node.eds = read_eds(EDS, 5)
    node.eds.od.entries[0x1018, 1] = replace(node.eds.od[0x1018, 1], default=0x1234)
    with pytest.raises(ConfigError, match="describes another device: its vendor is 0x00001234, node 5 has 0x"):
        run_checks(node, READING)
