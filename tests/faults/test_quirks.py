"""A whole robot with each quirk and each personality of its drives: it works, or stops safely and reports why.

What a robot without further keys in bus.yml does is in `REFUSED`, by quirk: a word of the reason that it gives.
"""

import functools

import pytest
from support import makers

from canopen_control.personality import personality_names, read_personality
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.testing.tested_robot import TestedRobot
from canopen_control.virtual.quirks import QUIRKS

REFUSED = {
    "one_mode": "mode CSP not confirmed",
    "switch_on_delay": "in time",
    "enable_faults": "0x5201",
    "first_enable_faults": "0xFF00",
    "sync_period_judged": "0x8700",
    "remote_when_enabled": "local control",
    "remote_never": "local control",
    "sdo_late": "",  # it boots for minutes
    "optional_missing": "0x6007",
    "velocity_absent": "TPDO 2",
    "mapping_fixed": "RPDO 1",
    "tpdo_by_event": "Transmission type 0x1800:02",
    "boot_delay": "boot error B",
    "start_after_boot": "boot error T",
    "heartbeat_absent": "0x1016:01",
    "consumer_refused": "0x1016:01",
}
KEYS = {  # with which such a drive works, or works without a wait
    "switch_on_delay": "transition_timeouts_ms: {3: 10000}",
    "sync_period_judged": "sdo: [{index: 0x1006, value: 10000}]",
    "remote_when_enabled": "ignore_remote: true",
    "remote_never": "ignore_remote: true",
    "brake_delay": "enable_settle_ms: 600",
    "mode_shown_late": "mode_timeout_ms: 8000",
    "mode_fixed_while_enabled": "switching_state: 2",
    "boot_delay=3": "boot_timeout_ms: 8000",
    "enable_delay": "transition_timeouts_ms: {4: 2000}",
}
NAMES_OF_KEYS = {"sdo": "0x1006"}  # what a message names instead of a key that holds many things
NAMED = {  # no robot follows its positions with these: it stops, and names the key, or the source of the set-points
    "brake_delay": "`enable_settle_ms`",
    "set_points_elsewhere": "the source of its set-points",
}


@functools.cache
def setup_of(folder, mode, keys="", without=""):
    """A robot of two drives whose bus.yml has further keys, and lacks one."""
    sdo = [key.removeprefix("sdo: [").removesuffix("]") for key in keys.splitlines() if key.startswith("sdo:")]
    others = "\n".join(key for key in keys.splitlines() if not key.startswith("sdo:") and "_mode:" not in key)
    makers.folder(folder, mode, keys=others)
    path = folder / "bus.yml"
    text = path.read_text().replace("  sdo:\n", "  sdo:\n" + "".join(f"    - {item}\n" for item in sdo))
    lines = [line for line in text.splitlines() if not (without and line.startswith(f"  {without}: "))]
    path.write_text("\n".join(lines) + "\n")
    return read_robot(find_robot(str(folder)))


class Patient(TestedRobot):
    """One that need not run."""

    def until(self, condition, timeout=10.0):
        """Let time pass, also where the condition is never met."""
        try:
            return super().until(condition, min(timeout, 20.0))
        except AssertionError:
            return timeout


def moves(robot, mode):
    """Whether it goes where it is led."""
    if mode == "csp":
        start = robot.position("pan")
        for step in range(1, 41):
            if robot.state != "running":
                return False
            robot.command("pos", start + 0.0125 * step, start + 0.0125 * step)
            robot.run(0.05)
        robot.run(0.3)
        return abs(robot.position("pan") - start - 0.5) < 0.01
    robot.command("vel", 0.5, 0.5, seconds=1.0)
    robot.run(0.9)
    return abs(robot.velocity("pan") - 0.5) < 0.05


@pytest.mark.rest
@pytest.mark.parametrize("name", QUIRKS)
def test_a_robot_works_or_stands_and_reports_why(name, tmp_path):
    robot = Patient(setup_of(tmp_path, "csp"), quirks={"all": [name]})
    try:
        if name in REFUSED:
            assert robot.state in ("disabled", "fault", "stopped")
            assert not robot.moving
            assert REFUSED[name] in "; ".join(makers.sentences(robot))
        elif name in NAMED:
            assert not moves(robot, "csp")
            assert not robot.moving
            assert NAMED[name] in "; ".join(makers.sentences(robot))
        else:
            assert robot.state == "running"
            assert moves(robot, "csp")
            assert robot.state == "running"
        assert robot.breaches == []
    finally:
        robot.close()


def test_a_frequency_converter_that_ignores_a_quick_stop_ramps_to_its_target_0(tmp_path):
    """Its ramp stays unlocked (0x6040, bit 5), else it would keep its speed."""
    robot = Patient(setup_of(tmp_path, "vl"), quirks={"all": ["quick_stop_off"]})
    try:
        robot.command("vel", 0.5, 0.5, seconds=1.0)
        robot.run(0.9)
        assert robot.moving
        robot.do("axis", name="quick-stop")
        assert robot.stopped_within(0.5)
        assert robot.breaches == []
    finally:
        robot.close()


def test_a_drive_that_shows_a_set_point_when_it_is_enabled_moves_in_pp(tmp_path):
    robot = Patient(setup_of(tmp_path, "pp"), quirks={"all": ["acknowledged_at_enable"]})
    try:
        start = robot.position("pan")
        robot.command("pos", start + 0.2, start + 0.2)
        robot.run(3.0)
        assert abs(robot.position("pan") - start - 0.2) < 0.01
        assert robot.state == "running", makers.sentences(robot)[-6:]
        assert robot.breaches == []
    finally:
        robot.close()


@pytest.mark.rest
@pytest.mark.parametrize("name", KEYS)
def test_a_robot_with_the_key_for_a_quirk_works(name, tmp_path):
    robot = Patient(setup_of(tmp_path, "csp", KEYS[name]), quirks={"all": [name]})
    try:
        robot.until(lambda: robot.state == "running", 20)
        assert robot.state == "running", makers.sentences(robot)[-6:]
        assert moves(robot, "csp")
        assert robot.breaches == []
    finally:
        robot.close()


@pytest.mark.rest
@pytest.mark.parametrize("name", personality_names())
def test_a_robot_with_the_drives_of_a_manufacturer_boots_drives_faults_recovers_and_stops(name, tmp_path):
    personality = read_personality(name)
    mode = "vl" if name == "vfd" else "csp"
    setup = setup_of(tmp_path, mode, "\n".join(key.text for key in personality.bus_keys))
    robot = Patient(setup, quirks={"all": [line.quirk for line in personality.quirks]})
    try:
        robot.until(lambda: robot.state == "running", 20)
        assert robot.state == "running", makers.sentences(robot)[-6:]
        assert moves(robot, mode)
        robot.run(1.0)
        robot.drives[2].fault("drive_fault", seconds=0.5)
        robot.run(1.5)
        assert robot.state == "fault"
        assert robot.stopped_within(1.0)
        robot.reset_faults()
        robot.run(6.0)
        robot.enable()
        robot.until(lambda: robot.state == "running", 15)
        assert robot.state == "running", makers.sentences(robot)[-6:]
        robot.run(1.0)
        assert moves(robot, mode)
        robot.stop()
        assert robot.stopped_within(2.0)
        assert robot.breaches == []
    finally:
        robot.close()


def unconfigured():
    """Yield each personality with each of its keys that is left away; the first in the default run."""
    for name in personality_names():
        for key in read_personality(name).bus_keys:
            yield pytest.param(name, key, id=f"{name}-{key.key}", marks=[] if name == "elmo" else pytest.mark.rest)


@pytest.mark.parametrize(("name", "key"), list(unconfigured()))
def test_without_one_of_the_keys_of_its_drives_a_robot_works_or_stops_and_names_the_key(name, key, tmp_path):
    personality = read_personality(name)
    others = "\n".join(item.text for item in personality.bus_keys if item is not key)
    robot = Patient(
        setup_of(tmp_path, "csp", others, key.key if key.key.endswith("_mode") else ""),
        quirks={"all": [line.quirk for line in personality.quirks]},
    )
    try:
        works = robot.state == "running" and moves(robot, "csp")
        message = "; ".join(makers.sentences(robot))
        assert works or (robot.stopped_within(1.0) and (NAMES_OF_KEYS.get(key.key) or key.key) in message), message[
            -1500:
        ]
        assert robot.breaches == []
    finally:
        robot.close()
