"""The boot bench: drives that boot are measured, one that does not is named."""

import pytest
from canopen_control_bench import boot
from canopen_control_bench.fleet import write_fleet
from canopen_control_bench.stage import stage

from canopen_control.errors import CanopenError
from canopen_control.master.config import read_bus

pytestmark = pytest.mark.process


def test_two_drives_boot_as_often_as_wanted(monkeypatch):
    monkeypatch.setattr(boot, "ROUNDS", 2)
    with stage() as played:
        found = boot.boots_of(played, 2)
    assert len(found) == 2
    assert all(0 < each.cpu_s < each.seconds and each.writes > 10 for each in found)


def test_a_drive_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setattr(boot, "_GIVE_UP_NS", 3_000_000_000)
    with stage() as played:
        played.drives("local:boot", "2")
        config = read_bus(write_fleet(played.folder, 2, 20_000) / "bus.yml")
        with pytest.raises(CanopenError, match="drive_2 has not booted"):
            boot.boot(config, "local:boot")
