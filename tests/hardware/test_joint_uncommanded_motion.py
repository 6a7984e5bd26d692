"""An axis whose position is outside its limits, or unknown: nothing moves by enabling it."""

import pytest
from support.faultbench import FaultBench
from support.generic import write_generic
from support.servos import command, start_servos

from canopen_control.errors import DriveError
from canopen_control.hardware.axis_statechart import Action, AxisPhase

LOW, HIGH = 30_000, 90_000
_LIMITS = f"- {{index: 0x607D, sub_index: 1, value: {LOW}}}\n    - {{index: 0x607D, sub_index: 2, value: {HIGH}}}"
_OFFSET = "\n    - {index: 0x607C, sub_index: 0, value: %d}\n    - {index: 0x6098, sub_index: 0, value: 35}"
_POSITIONS = "2: {enabled: true, cob_id: auto, transmission: 1, mapping: [{index: 0x6064}, {index: 0x606C}]}"


@pytest.fixture
def outside(tmp_path):
    """Return a function that starts two servos at 0 below their limits: its controller, keys, and more SDO writes."""
    benches = []

    def start(controller="position", modes="", sdo=""):
        benches.append(start_servos(tmp_path, f"outside{len(benches)}", controller, modes, sdo=_LIMITS + sdo))
        benches[-1].run(500)
        return benches[-1]

    yield start
    for bench in benches:
        bench.close()


def _positions(robby):
    return [robby.drives[node].get(0x6064) for node in (2, 3)]


def _axis(robby, action, name="all", ms=3000, **how):
    """Start an action and return how it ended, as the text of a refusal or None."""
    ended = []
    robby.robot.axis(action, name, ended.append, **how)
    robby.until(lambda: ended, ms)
    return ended[0]


@pytest.mark.parametrize("modes", ["", "position_mode: 7", "position_mode: 1"])
def test_an_axis_outside_its_limits_is_not_enabled_in_a_position_mode(outside, modes):
    robby = outside(modes=modes)
    assert _positions(robby) == [0, 0]
    assert {joint.statechart.state for joint in robby.robot.joints.values()} == {AxisPhase.DISABLED}
    assert robby.robot.state.value == "disabled"
    text = robby.texts("not_enabled")[0]
    assert "its position 0 is outside its software position limits (0x607D: 30000 to 90000)" in text
    assert "home it (canopen-control axis home drive_one)" in text
    assert "canopen-control jog 2 --can CHANNEL --eds FILE" in text
    with pytest.raises(DriveError, match=r"drive_one.*outside its software position limits"):
        robby.robot.axis(Action.ENABLE, "all", lambda _error: None)
    robby.run(500)
    assert _positions(robby) == [0, 0]


def test_an_axis_that_rests_at_its_limit_is_enabled(outside):
    """Noise at the limit does not prevent an enable."""
    robby = outside(sdo=_OFFSET % (LOW - 15))
    assert _axis(robby, Action.HOME) is None
    assert _axis(robby, Action.ENABLE) is None
    assert all(joint.enabled for joint in robby.robot.joints.values())


def test_homing_leads_back_into_the_limits(outside):
    robby = outside(sdo=_OFFSET % 50_000)
    assert _axis(robby, Action.HOME) is None
    assert _positions(robby) == [50_000, 50_000]
    assert _axis(robby, Action.ENABLE) is None
    robby.run(500)
    assert _positions(robby) == [50_000, 50_000]


def test_homing_of_an_enabled_axis_that_ends_outside_stops_it(outside):
    robby = outside(sdo=_OFFSET % 50_000)
    _axis(robby, Action.HOME)
    _axis(robby, Action.ENABLE)
    drive = robby.drives[2]
    robby.joint(2).node.write(0x607C, 0, (10_000).to_bytes(4, "little"))
    robby.run(100)
    _axis(robby, Action.HOME, "drive_one")
    robby.run(2000)
    assert drive.get(0x6064) == 10_000
    assert not robby.joint(2).enable_requested
    assert any("outside its software position limits" in text for text in robby.texts("not_enabled"))
    assert robby.joint(2).targets.mode == 8
    assert drive.get(0x6061) == 8


def test_a_velocity_moves_it_back_and_then_a_position_mode_is_accepted(outside):
    robby = outside("velocity")
    with pytest.raises(DriveError, match="outside its software position limits"):
        robby.robot.switch(["position"], ["velocity"], strict=True)
    with pytest.raises(DriveError, match="outside its software position limits"):
        robby.joint(2).targets.set_mode(8)
    command(robby, "velocity", 4.0, 1000)
    robby.robot.stop(lambda _error: None)
    robby.run(1000)
    before = _positions(robby)
    assert min(before) > LOW
    robby.robot.switch(["position"], ["velocity"], strict=True)
    robby.run(1000)
    assert all(joint.enabled for joint in robby.robot.joints.values())
    assert _positions(robby) == before


@pytest.fixture
def changed(tmp_path):
    """Return a function that starts two servos whose second TPDO is replaced."""
    benches = []

    def start(controller, tpdo):
        config = write_generic(tmp_path)
        path = config / "bus.yml"
        text = path.read_text()
        assert _POSITIONS in text
        path.write_text(text.replace(_POSITIONS, tpdo))
        benches.append(FaultBench("changed", config=config, drives=(2, 3), controllers=[controller]))
        benches[-1].start()
        return benches[-1]

    yield start
    for bench in benches:
        bench.close()


def test_a_position_that_no_tpdo_carries_is_not_taken_for_zero(changed):
    robby = changed("velocity", _POSITIONS.replace("{index: 0x6064}, ", ""))
    command(robby, "velocity", 3.0, 1000)
    robby.robot.stop(lambda _error: None)
    robby.run(1000)
    before = _positions(robby)
    assert min(before) > 20_000
    robby.robot.switch(["position"], ["velocity"], strict=True)
    robby.run(1000)
    assert _positions(robby) == before
    assert "map 0x6064 in a TPDO of drive_one in bus.yml" in robby.texts("not_enabled")[0]


def test_an_axis_waits_for_its_position(changed):
    """A synchronous TPDO of type 60 arrives 0.6 s after the boot at the latest, one of type 240 later."""
    robby = changed("position", _POSITIONS.replace("transmission: 1,", "transmission: 60,"))
    assert robby.robot.state.value == "running"
    assert robby.joint(2).axis.position.fresh


def test_an_axis_whose_position_never_arrives_is_not_enabled(changed):
    robby = changed("position", _POSITIONS.replace("transmission: 1,", "transmission: 240,"))
    robby.run(500)
    assert "its position (0x6064) has not arrived since the boot" in robby.texts("not_enabled")[0]
    assert not robby.joint(2).enable_requested
