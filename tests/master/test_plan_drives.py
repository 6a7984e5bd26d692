"""Plans of drives with special requirements: two motors in subindices, 0x1006 in IP."""

import re

import pytest
from support.makers import folder

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.runtime.robot_files import find_robot
from canopen_control.scaffold.new_robot import Device, plan_robot
from canopen_control.scaffold.robot_folder import write_robot


def two_motors(text):
    """Return the EDS with 0x60FF, 0x6064 and 0x606C in subindices 1 and 2, as the ZLAC8015D has them."""
    for index, access, kind in ((0x60FF, "rww", 1), (0x6064, "ro", 1), (0x606C, "ro", 1)):
        head = rf"\[{index:X}\].*?(?=\n\[)"
        record = f"[{index:X}]\nParameterName=Object\nObjectType=0x9\nSubNumber=3\n\n[{index:X}sub0]\n"
        record += "ParameterName=Number of entries\nObjectType=0x7\nDataType=0x0005\nAccessType=ro\nDefaultValue=2\n"
        record += "PDOMapping=0\n"
        for motor in (1, 2):
            record += f"\n[{index:X}sub{motor}]\nParameterName=Motor {motor}\nObjectType=0x7\nDataType=0x0004\n"
            record += f"AccessType={access}\nDefaultValue=0\nPDOMapping={kind}\n"
        text = re.sub(head, lambda _match, record=record: record, text, count=1, flags=re.DOTALL)
    return text


def findings(path):
    return [str(finding) for finding in check_robot(find_robot(str(path)), CheckOptions()).findings]


def test_two_motors_of_one_drive_are_named_with_what_can_be_done(tmp_path):
    eds = tmp_path / "zlac.eds"
    eds.write_text(two_motors(data_path("eds", "generic_cia402.eds").read_text()))
    written = write_robot(plan_robot("zl", [Device(1, eds, read_eds(eds, 1).od)]), tmp_path)
    assert not written.warnings
    bus = tmp_path / "zl" / "bus.yml"
    text = bus.read_text()
    assert "motor_subindices: [1, 2]" in text
    assert [f"{{index: 0x60FF, sub_index: {motor}}}" in text for motor in (0, 1, 2)] == [False, True, True]
    assert [finding for finding in findings(tmp_path / "zl") if "motor_subindices" in finding] == []
    bus.write_text(re.sub("  motor_subindices: .*\n", "", text))
    result = findings(tmp_path / "zl")
    assert any("give `motor_subindices: [1, 2]` to move both" in item for item in result)
    assert any("`velocity_target: 0x60FF:01`" in item for item in result)
    assert [item for item in result if "map one of them" in item or "map 0x60" in item] == []


def test_one_of_two_motors_can_be_moved(tmp_path):
    bus = folder(tmp_path, "csv", edit=two_motors, keys="velocity_target: 0x60FF:01") / "bus.yml"
    text = bus.read_text().replace("{index: 0x60FF}", "{index: 0x60FF, sub_index: 1}")
    bus.write_text(
        text.replace(
            "2: {enabled: true, cob_id: auto, transmission: 1, mapping: [{index: 0x6064}, {index: 0x606C}]}",
            "2: {enabled: false}",
        )
    )
    assert not any("motor_subindices" in finding for finding in findings(tmp_path))
    assert not any("error" in finding and "0x60FF" in finding for finding in findings(tmp_path))


@pytest.mark.parametrize(
    ("mode", "extra", "words"),
    [
        ("ip", "", "remains 0; drives that report a SYNC alarm in IP"),
        ("csp", "", ""),
        ("ip", "    - {index: 0x1006, sub_index: 0, value: 10000}\n", ""),
        ("ip", "    - {index: 0x1006, sub_index: 0, value: 5000}\n", "0x1006 is 5000 us, but the SYNC period 10000 us"),
    ],
)
def test_the_period_of_sync_that_a_drive_in_ip_counts_on_is_named(tmp_path, mode, extra, words):
    bus = folder(tmp_path, mode) / "bus.yml"
    bus.write_text(bus.read_text().replace("  tpdo:\n", extra + "  tpdo:\n", 1))
    result = [finding for finding in findings(tmp_path) if "0x1006" in finding]
    assert bool(result) is bool(words)
    assert all(words in item for item in result)
