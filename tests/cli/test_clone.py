"""The verb clone: output and exit codes, and its duration on a bus of 1 Mbit/s."""

import time

import pytest
from support.onbus import GENERIC, TMCM, OnBus

from canopen_control.bus.local import ask_hub
from canopen_control.cli.main import main
from canopen_control.commissioning.parameter_set import parameters_of
from canopen_control.data_files import data_path
from canopen_control.od.dcf import eds_text
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, Entry
from canopen_control.rpc.messages.hub import SetBitrate


@pytest.fixture
def bus(private_folders):
    with OnBus("memory:clone", {3: TMCM, 4: TMCM, 5: GENERIC}) as devices:
        devices.options = ["--can", "memory:clone", "--eds", TMCM]
        yield devices


def configure(bus):
    store = bus.nodes[3].store
    for index, value in ((0x6081, 1600), (0x6083, 7), (0x607C, 99), (0x2705, 3), (0x2003, 50)):
        store.set(index, 0, value)
    store.set(0x1801, 1, 0xC0000283)
    store.set(0x1802, 1, 0x400001C3)


def test_the_new_drive_is_equal_and_stays_itself(bus, capsys):
    bus.call(lambda: configure(bus))
    assert main(["clone", "3", "4", *bus.options, "--store"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "not written: 0x2705:00 Node-ID to store: is the node-ID or the bit rate",
        "not written: 0x607C:00 Home offset: is calibrated to the encoder of the original drive",
        "node 4: 130 parameters as in node 3, 5 written; stored",
    ]
    new = bus.nodes[4].store
    assert (new.values[0x1801, 1], new.values[0x1802, 1]) == (0xC0000284, 0x400001C3)
    assert (new.values[0x607C, 0], new.values[0x2705, 0], new.values[0x1018, 4]) == (0, 0, 4)
    assert new.power_on[0x6081, 0] == 1600
    assert main(["diff", "3", "4", *bus.options]) == 1  # what was kept is reported as different
    assert capsys.readouterr().out.count("\n") == 3


def test_calibration_goes_along_where_that_is_asked_for(bus, capsys):
    bus.call(lambda: configure(bus))
    assert main(["clone", "3", "4", *bus.options, "--include-protected"]) == 0
    assert bus.nodes[4].store.values[0x607C, 0] == 99
    assert bus.nodes[4].store.values[0x2705, 0] == 0


def test_one_node_and_another_product_are_refused(bus, capsys):
    assert main(["clone", "3", "3", *bus.options]) == 2
    assert "3 and 3 are the same node" in capsys.readouterr().err
    before = bus.call(lambda: dict(bus.nodes[5].store.values))
    assert main(["clone", "3", "5", *bus.options]) == 2
    assert "belongs to a different product than node 5" in capsys.readouterr().err
    assert bus.call(lambda: dict(bus.nodes[5].store.values)) == before


def drive_of_300_parameters(path):
    """Write the EDS of a drive with 350 parameters, of which 50 are mapping entries above their count."""
    od = read_eds(data_path("eds", GENERIC)).od
    for index in range(0x3000, 0x3000 + 350 - len(parameters_of(od))):
        od.add(Entry(index, 0, f"Parameter {index:04X}", DataType.UNSIGNED32, "rw", default=0))
    path.write_text(eds_text(od), encoding="utf-8")
    return str(path)


@pytest.mark.process
@pytest.mark.alone
def test_300_parameters_are_cloned_in_less_than_ten_seconds_at_1_mbit_s(private_folders, tmp_path, capsys):
    eds = drive_of_300_parameters(tmp_path / "large.eds")
    with OnBus("local:paced", {3: eds, 4: eds}) as bus:
        ask_hub("paced", SetBitrate(1_000_000))
        old = bus.nodes[3]
        bus.call(
            lambda: [
                old.store.set(entry.index, 0, entry.index) for entry in old.od if entry.index in range(0x3000, 0x5000)
            ]
        )
        begin = time.monotonic()
        assert main(["clone", "3", "4", "--can", "local:paced", "--eds", eds]) == 0
        assert time.monotonic() - begin < 10.0
        assert main(["diff", "3", "4", "--can", "local:paced", "--eds", eds]) == 0
    assert "300 parameters, equal" in capsys.readouterr().out
