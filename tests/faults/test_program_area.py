"""Faults of program areas in a whole robot; those of `firmware` are in tests/cli/test_firmware.py."""

import contextlib

import pytest
from support.busalone import AloneBench
from support.programs import PROGRAM_EDS

BUS = """
master: {{node_id: 1, sync_period: 10000, heartbeat_producer: 100, baudrate: 1000}}
defaults:
  dcf: {eds}
  driver: "ros2_canopen::Cia402Driver"
  heartbeat_producer: 100
  heartbeat_consumer: true
  tpdo:
    1: {{enabled: true, cob_id: auto, transmission: 1, mapping: [{{index: 0x6041}}, {{index: 0x6061}}]}}
    2: {{enabled: true, cob_id: auto, transmission: 1, mapping: [{{index: 0x6064}}, {{index: 0x606C}}]}}
  rpdo:
    1: {{enabled: true, cob_id: auto, mapping: [{{index: 0x6040}}, {{index: 0x6060}}]}}
    2: {{enabled: true, cob_id: auto, mapping: [{{index: 0x60FF}}]}}
nodes:
  lift: {{node_id: 2}}
  tilt: {{node_id: 3}}
"""


@pytest.fixture
def enabled(tmp_path):
    config = tmp_path / "loaders"
    config.mkdir()
    (config / "bus.yml").write_text(BUS.format(eds=PROGRAM_EDS))
    with contextlib.closing(AloneBench("loaders", config=config, drives=(2, 3))) as bench:
        bench.victim = 2
        bench.start()
        bench.enable()
        yield bench


def state(bench, node):
    return bench.drives[node].drives[0].state.name


def test_a_drive_that_lost_its_program_stops_all_and_is_reported_by_its_boot_loader(enabled):
    assert (state(enabled, 2), state(enabled, 3)) == ("OPERATION_ENABLED", "OPERATION_ENABLED")
    enabled.switch("program_lost")
    enabled.until(
        lambda: any("it may be in its boot-loader without a program" in event.text for event in enabled.events)
    )
    enabled.until(lambda: state(enabled, 3) != "OPERATION_ENABLED")
    assert not enabled.robot.nodes["lift"].ready
    enabled.switch("program_lost", False)
    enabled.until(lambda: enabled.robot.nodes["lift"].ready, ms=10_000)
    enabled.run(500)
    assert "OPERATION_ENABLED" not in (state(enabled, 2), state(enabled, 3))
    enabled.enable()
    assert state(enabled, 2) == "OPERATION_ENABLED"
