"""Findings on the drives of a robot: state interfaces that no TPDO contains."""

import re

import pytest
from support.makers import folder, unmapped

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.runtime.robot_files import find_robot


def findings(path):
    return [str(finding) for finding in check_robot(find_robot(str(path)), CheckOptions()).findings]


def test_check_refuses_a_broadcaster_that_has_nothing_to_publish(tmp_path):
    result = findings(unmapped(tmp_path, ""))
    assert any("joint_state_broadcaster has nothing to publish" in item for item in result)


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        (
            "mapping: [{index: 0x6064}]",
            "has velocity as state interface, .*0x606C: the velocity is derived from positions, later and coarser",
        ),
        ("mapping: [{index: 0x606C}]", "has position as state interface, .*0x6064: the value is unknown"),
        ("", "has velocity as state interface, .*0x606C: the value is unknown"),
    ],
)
def test_check_names_what_the_description_asks_for_and_no_tpdo_brings(tmp_path, mapping, words):
    result = findings(unmapped(tmp_path, mapping))
    assert any(re.search(f"joint pan {words}; map 0x60", item) for item in result)


@pytest.mark.parametrize(("value", "found"), [("false", True), ("true", False)])
def test_check_names_a_joint_whose_drive_is_never_started(tmp_path, value, found):
    path = folder(tmp_path, "csv")
    bus = path / "bus.yml"
    bus.write_text(bus.read_text().replace("  velocity_mode: 9", f"  velocity_mode: 9\n  boot: {value}"))
    reported = [text for text in findings(path) if "has boot: false" in text]
    assert bool(reported) is found
    if found:
        assert (
            "pan_drive has boot: false, so it is never started, and pan cannot move; remove boot: false" in reported[0]
        )


@pytest.mark.parametrize(("key", "noted"), [("", True), ("  velocity_mode: 9", False)])
def test_check_names_a_drive_whose_eds_lists_no_modes(tmp_path, key, noted):
    path = folder(tmp_path, "csv", edit=lambda text: re.sub(r"(?s)\[6502\].*", "", text))
    (path / "bus.yml").write_text((path / "bus.yml").read_text().replace("  velocity_mode: 9", key))
    assert any("device.eds does not list the drive's modes (0x6502)" in text for text in findings(path)) is noted


def test_check_refuses_a_mode_whose_target_is_in_no_rpdo(tmp_path):
    path = folder(tmp_path, "csv")
    bus = path / "bus.yml"
    bus.write_text(bus.read_text().replace("velocity_mode: 9", "velocity_mode: 2"))
    text = next(finding for finding in findings(path) if "no RPDO carries 0x6042:00, the target of mode VL" in finding)
    assert re.search(r"bus\.yml:\d+:\d+: error: pan_drive: .*; map it, or use a velocity_mode", text)
    urdf = path / "two_axes.urdf"
    urdf.write_text(urdf.read_text().replace('"device_name">pan_drive', '"node_id">2'))
    assert any("pan_drive: no RPDO carries 0x6042:00" in finding for finding in findings(path)), (
        "a joint may name a node-ID"
    )
    assert not any(
        "no RPDO carries" in finding for finding in findings(folder(tmp_path, "v-3", keys="velocity_target: 0x60FF"))
    )


@pytest.mark.parametrize("index", ["6040", "6041", "60FF"])
def test_an_object_that_the_eds_lacks_is_one_error(tmp_path, index):
    path = folder(tmp_path, "csv", edit=lambda text: re.sub(rf"(?ms)^\[{index}\]\n.*?(?=^\[)", "", text))
    errors = [finding for finding in findings(path) if ": error: " in finding]
    assert len(errors) == 1, errors
    assert f"0x{index}:00 is not in device.eds" in errors[0]


def test_a_target_that_the_eds_lacks_and_no_rpdo_maps_is_named_with_the_eds(tmp_path):
    path = folder(tmp_path, "csv", edit=lambda text: re.sub(r"(?ms)^\[6042\]\n.*?(?=^\[)", "", text))
    bus = path / "bus.yml"
    bus.write_text(bus.read_text().replace("velocity_mode: 9", "velocity_mode: 2"))
    text = next(finding for finding in findings(path) if "no RPDO carries 0x6042:00, the target of mode VL" in finding)
    assert "device.eds has no such object, so use a velocity_mode whose target it has" in text


@pytest.mark.parametrize(("target", "moved"), [(", {index: 0x60FF}", True), ("", False)])
def test_a_drive_without_a_target_is_not_moved_without_feedback(tmp_path, target, moved):
    """Faulhaber MCDC: the first RPDO has only the controlword."""
    (tmp_path / "bus.yml").write_text(
        "master: {node_id: 1, sync_period: 10000}\nnodes:\n  wheel:\n    node_id: 2\n    dcf: generic_cia402.eds\n"
        f"    rpdo: {{1: {{enabled: true, mapping: [{{index: 0x6040}}{target}]}}}}\n"
        "    tpdo: {1: {enabled: true, transmission: 1, mapping: [{index: 0x6041}]}}\n"
    )
    result = findings(tmp_path)
    assert any("it is moved without feedback" in text for text in result) is moved
    assert any("no RPDO carries a target" in text for text in result) is not moved
