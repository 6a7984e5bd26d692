import pytest
from support.robots import LEFT, Bench
from support.samples import event_of, sample_of

from canopen_control.monitor.monitor_content import Tone
from canopen_control.monitor.sources import content_of, is_emergency, log_line, without_robot
from canopen_control.rpc.wire import plain
from canopen_control.runtime.status import event_message, state_sample


@pytest.fixture
def bench():
    bench = Bench("monitor-rows")
    bench.start()
    yield bench
    bench.close()


def content(bench):
    return content_of("robby", state_sample(bench.robot))


def words(row):
    return [str(cell) for cell in row]


def test_a_running_robot_in_words(bench):
    bench.run(300)
    bench.hold(5.0, 5.0, ms=1000)
    shown = content(bench)
    assert (shown.title, str(shown.state), shown.alarm) == ("robby", "● running", "")
    drive = words(shown.drives["left_drive"])
    assert drive[:4] == ["left_drive (3)", "● OPERATIONAL", "● OPERATION ENABLED", ""]
    assert drive[4].endswith(" ms")
    assert drive[5] == "PV"
    assert drive[6].split()[1] == "37w"
    assert drive[7].startswith("0x")
    assert "OPERATION" not in drive[7]
    assert words(shown.joints["left_wheel_joint"])[:3] == ["left_wheel_joint", "5.000", "4.999"]
    assert any("cycle 20 ms, 0 missed" in fact for fact in shown.facts)
    assert any(fact.startswith("bus can ") for fact in shown.facts)
    assert "active: joint_state_broadcaster, robby_forward_controller" in shown.facts


def test_a_drive_that_is_gone_is_dead_in_words(bench):
    bench.power_off(LEFT)
    bench.run(1500)
    row = content(bench).drives["left_drive"]
    assert row[1].tone is Tone.BAD
    assert row[4].tone is Tone.BAD
    assert "dead" in row[4].text
    assert row[3].tone is Tone.BAD
    assert "left_drive" in row[3].text


def test_a_robot_without_canopen_drives_says_so(bench):
    state = state_sample(bench.robot)
    assert "no CANopen drives" not in content_of("robby", state).facts
    assert "no CANopen drives" in content_of("robby", sample_of({**plain(state), "nodes": {}})).facts


def test_a_latched_stop_is_an_alarm_with_the_way_out(bench):
    bench.robot.stop(lambda _: None, "somebody")
    bench.run(100)
    assert content(bench).alarm.startswith("STOP is latched by somebody: nothing moves before it is released")


def test_drives_that_are_off_are_a_warning_with_what_to_call(bench):
    bench.robot.stop(lambda _: None)
    bench.run(1000)
    shown = content(bench)
    assert (shown.state.text, shown.state.tone) == ("disabled", Tone.WARN)
    assert shown.alarm == "left_drive, right_drive are not enabled and will not move: canopen-control axis enable all"


def test_events_are_lines_with_their_level(bench):
    lines = [log_line(event_message(bench.robot, event)) for event in bench.events]
    assert "robby runs: joint_state_broadcaster, robby_forward_controller" in [line.text for line in lines]
    assert all(line.time > 0 for line in lines)
    assert log_line(event_of({"time": 1.0, "kind": "x", "level": "error", "text": "t"})).tone is Tone.BAD


def test_emergencies_are_known_by_their_kind():
    assert is_emergency(event_of({"time": 1.0, "kind": "emcy"}))
    assert is_emergency(event_of({"time": 1.0, "kind": "emcy_reset"}))
    assert not is_emergency(event_of({"time": 1.0, "kind": "state"}))


def test_without_a_robot_it_says_that_stop_does_not_reach_it():
    shown = without_robot("robby", "no robot 'robby' is running")
    assert shown.state.tone is Tone.BAD
    assert shown.alarm == "no robot 'robby' is running. STOP does not reach it; trying again"
