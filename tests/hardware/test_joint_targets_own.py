"""Modes and targets of manufacturers: `velocity_mode: -3`, `effort_target: 0x60F6:08`."""

import re

import pytest
from support.makers import COUNTS, drive, folder, sentences

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.errors import BusConfigError
from canopen_control.hardware.axis_statechart import Action
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.virtual.drive_modes import MODES, DriveModes
from canopen_control.virtual.virtual_drive import VirtualDrive


@pytest.fixture
def immediate_velocity(monkeypatch):
    """Drives with a mode -3, which is profile velocity."""
    check, make = VirtualDrive._check_mode, DriveModes.__init__

    def checked(self, entry, value):
        return value if value == -3 else check(self, entry, value)

    def made(self, axis):
        make(self, axis)
        self._all[-3] = MODES[3](axis)

    monkeypatch.setattr(VirtualDrive, "_check_mode", checked)
    monkeypatch.setattr(DriveModes, "__init__", made)


def _without_limits(text):
    head, rest = text.split("[6060]\n")
    return head + "[6060]\n" + re.sub(r"(Low|High)Limit=.*\n", "", rest, count=2)


@pytest.mark.sources
@pytest.mark.usefixtures("immediate_velocity")
def test_a_mode_of_the_manufacturer_with_its_target_moves_the_axis(robot):
    created = robot("v-3", keys="velocity_target: 0x60FF", edit=_without_limits)
    assert any("mode -3 (manufacturer) confirmed" in sentence for sentence in sentences(created))
    created.command("vel", 0.5, 0.0, seconds=1)
    created.run(0.9)
    assert drive(created, 2).mover.plant.velocity / COUNTS == pytest.approx(0.5, rel=0.02)
    created.disable()
    created.run(1)
    assert not created.drives[2].moving
    created.enable()
    created.simulated.core.axis(Action.MODE, "pan_drive", lambda _error: None, mode="-3")
    created.run(1)
    assert created.state == "running"


def _with_target_torque(text):
    entry = "[{}]\nParameterName=Target torque\nObjectType=0x{}\n{}"
    record = entry.format("60F6", "9", "SubNumber=2\n\n")
    record += entry.format("60F6sub0", "7", "DataType=0x0005\nAccessType=ro\nDefaultValue=8\nPDOMapping=0\n\n")
    record += entry.format("60F6sub8", "7", "DataType=0x0003\nAccessType=rww\nDefaultValue=0\nPDOMapping=1\n\n")
    count = int(re.search(r"\[OptionalObjects\]\s*SupportedObjects=(\d+)", text)[1])
    head = f"[OptionalObjects]\nSupportedObjects={count + 1}\n"
    text = re.sub(r"\[OptionalObjects\]\s*SupportedObjects=\d+\n", head, text)
    return text.replace(head, f"{head}{count + 1}=0x60F6\n") + "\n" + record


def test_a_target_object_of_the_manufacturer_takes_the_target(robot):
    created = robot("tq", keys="effort_target: 0x60F6:08", edit=_with_target_torque)
    created.command("eff", 15.0, -5.0, seconds=0.3)
    created.run(0.2)
    assert [drive(created, node)._store.number(0x60F6, 8) for node in (2, 3)] == [15, -5]
    created.run(2.5)
    assert drive(created, 2)._store.number(0x60F6, 8) == 0


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("velocity_mode: -3", "set `velocity_target`, such as `velocity_target: 0x60FF`"),
        ("velocity_mode: -3\nvelocity_target: torque", "'torque' is not an object; write 0x60FF, or 0x60F6:08"),
        ("effort_target: 0x6071", "effort_target needs effort_mode"),
        ("velocity_mode: 8\nvelocity_target: 0x60FF", "CSP does not support the velocity interface"),
    ],
)
def test_what_is_wrong_with_them_is_reported_with_its_line(tmp_path, keys, message):
    path = folder(tmp_path, "csp", keys=keys)
    with pytest.raises(BusConfigError, match=rf"bus.yml:\d+.*{message}"):
        read_robot(find_robot(str(path)))


def test_check_names_a_target_that_no_rpdo_carries(tmp_path):
    bus = folder(tmp_path, "v-3", keys="velocity_target: 0x60B1") / "bus.yml"
    bus.write_text(bus.read_text().replace("mapping: [{index: 0x60FF}]", "mapping: [{index: 0x607A}]"))
    result = [str(finding) for finding in check_robot(find_robot(str(tmp_path)), CheckOptions()).findings]
    assert any("error" in item and "no RPDO carries 0x60B1:00" in item for item in result)
