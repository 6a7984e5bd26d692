"""The master dies by SIGKILL and both drives stand within their time, whatever was written into them at boot."""

import re
import signal
import struct
from pathlib import Path

import pytest
from support.channel import channel_of
from support.host import eventually
from support.processes import seconds_until

from canopen_control.od.dcf import encode_concise

pytestmark = pytest.mark.timed

DATA = Path(__file__).parents[1] / "data" / "reports" / "dcf_supervision"
NODES = (2, 3)
NOTICED_S = 0.5  # by 0x1016 or guarding
RAMP_S, SLACK_S = 1.0, 1.0  # of the drives' own ramps, and of a busy machine
SUPERVISION_KEYS = r"^  (heartbeat_\w+|sdo):.*\n(    - \{index: 0x6007.*\n)?"
MOTION = (
    ("0x6098", 0, 35),
    ("0x6099", 1, 20000),
    ("0x607C", 0, 100),
    ("0x605A", 0, 2),
    ("0x605E", 0, 1),
    ("0x6085", 0, 400000),
)
NOTHING_WATCHES = ((0x1016, 1, struct.pack("<I", 0)), (0x1017, 0, b"\0\0"), (0x6007, 0, b"\0\0"))


def hostile_files(folder, bus):
    """Take supervision out of bus.yml: a DCF, a concise DCF and the sdo: list are left, which switch it off."""
    text = (folder / "drive.dcf").read_text()
    for section, value in (("1016sub1", 0), ("1017", 0), ("6007", 0)):
        text = re.sub(
            rf"(\[{section}\]\n(?:(?!ParameterValue).+\n)*)(ParameterValue.*\n)?", rf"\1ParameterValue={value}\n", text
        )
    (folder / "drive.dcf").write_text(text)
    (folder / "off.bin").write_bytes(encode_concise(NOTHING_WATCHES))
    bus = re.sub(SUPERVISION_KEYS, "", bus, flags=re.MULTILINE)
    own = "node_id: 3\n    dcf: generic_cia402.eds\n    configuration_file: off.bin\n"
    return bus.replace("node_id: 3 ", own + "    sdo: [{index: 0x1016, sub_index: 1, value: 0}] ")


def guarded_against_the_file(folder, bus):
    """Watch by node guarding where a file switches heartbeats on, which would switch guarding off."""
    assert "ParameterValue=100" in (folder / "drive.dcf").read_text()  # 0x1017
    return re.sub(SUPERVISION_KEYS, "", bus, flags=re.MULTILINE).replace(
        "defaults:  #", "defaults:\n  heartbeat_consumer: false\n  guard_time: 100\n  #"
    )


def plain_bus_yml(folder, bus):
    """Name no supervision at all: what is added stops the drives."""
    return re.sub(SUPERVISION_KEYS, "", bus, flags=re.MULTILINE).replace("drive.dcf", "generic_cia402.eds")


def defaults_against_the_nodes(folder, bus):
    """Let `defaults` switch it off in every node, one of which says the contrary."""
    off = "\n  sdo: [{index: 0x1016, sub_index: 1, value: 0}, {index: 0x1017, value: 0}]\n  #"
    bus = re.sub(SUPERVISION_KEYS, "", bus, flags=re.MULTILINE).replace("defaults:  #", f"defaults:{off}")
    return bus.replace("node_id: 3 ", "node_id: 3\n    heartbeat_consumer: true\n    heartbeat_producer: 100 ")


def homing_and_motion(folder, bus):
    """Write homing, reactions, ramps and what a drive is, by the list and by its keys; a fault ramps down (0x605E)."""
    sdo = "\n".join(f"    - {{index: {index}, sub_index: {sub}, value: {value}}}" for index, sub, value in MOTION)
    keys = "  homing_timeout_seconds: 5\n  recovery: enable\n  following_error_action: warn\n  profile: 402\n"
    return re.sub(SUPERVISION_KEYS, "", bus, flags=re.MULTILINE).replace(
        "  velocity_mode: 3", f"{keys}  restore_configuration: 1\n  sdo:\n{sdo}\n  velocity_mode: 3"
    )


SOURCES = (hostile_files, guarded_against_the_file, plain_bus_yml, defaults_against_the_nodes, homing_and_motion)


@pytest.mark.parametrize("edit", SOURCES)
def test_drives_stand_when_the_master_is_killed_whatever_was_written_into_them(stage, probe, tmp_path, edit):
    folder = tmp_path / "robot"
    folder.mkdir()
    for file in DATA.iterdir():
        (folder / file.name).write_text(file.read_text())
    (folder / "bus.yml").write_text(edit(folder, (folder / "bus.yml").read_text()))
    name = edit.__name__[:7]
    for node_id in NODES:
        stage.drive(name, node_id, "--eds", f"{node_id}={folder / 'drive.dcf'}")
    robot = stage.start("run", folder, "--real", "--full-speed", "--as", name, "--can", channel_of(name))
    robot.until(f"{name} runs")
    stage.start("command", "velocity_controller", 5, 5, "--name", name)
    probes = [probe(name, node_id) for node_id in NODES]
    assert eventually(lambda: all(abs(item.speed) > 40_000 for item in probes)), robot
    robot.end(signal.SIGKILL)
    took = seconds_until(lambda: all(abs(item.speed) < 1 for item in probes), 6)
    assert took <= NOTICED_S + RAMP_S + SLACK_S
    assert all(0x8130 in item.state.errors for item in probes)
