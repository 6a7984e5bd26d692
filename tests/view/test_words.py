import pytest
from support.pages import AXIS, FAULTS, NODE, drive_state, state
from support.samples import event_of

from canopen_control.rpc.messages.drive import FaultListing
from canopen_control.rpc.messages.health import BAD
from canopen_control.view.words import (
    active_faults,
    axis_rows,
    banner,
    drive_table,
    event_log,
    facts,
    fault_text,
    joint_table,
    lost_banner,
    sentence,
)


def row(**changed):
    return axis_rows(drive_state(**changed))[0]


def event(**changed):
    return event_of({"time": 1.0, "kind": "x", "level": "info", "text": "it happened"} | changed)


@pytest.mark.parametrize(
    ("changed", "words", "tone"),
    [
        ({}, "enabled, follows commands", "good"),
        ({"axis": {"cia402_state": "SWITCH_ON_DISABLED"}}, "disabled", "idle"),
        ({"axis": {"cia402_state": "FAULT"}}, "fault", "bad"),
        ({"axis": {"cia402_state": None}}, "no statusword", "bad"),
        ({"axis": {"cia402_state": "A NEW ONE"}}, "no statusword", "bad"),
        ({"ready": False, "nmt_state": "PRE_OPERATIONAL"}, "not ready, pre-operational", "warn"),
        ({"ready": False, "nmt_state": None, "age_s": None}, "not there", "bad"),
    ],
)
def test_a_state_is_reported_in_words_and_has_a_tone(changed, words, tone):
    assert (row(**changed).state, row(**changed).tone) == (words, tone)


def test_a_node_without_axes_has_no_drive_profile():
    result = axis_rows(state(nodes={"io": NODE | {"axes": []}}))[0]
    assert (result.state, result.tone) == ("no drive profile", "idle")


def test_an_error_is_reported_and_colours_what_does_not_run():
    result = row(ready=False, error="lost: no heartbeat for 0.5 s", nmt_state=None)
    assert (result.error, result.tone) == ("lost: no heartbeat for 0.5 s", "bad")
    assert "no heartbeat" in drive_table([result])
    assert row(error="too hot", axis={"cia402_state": "SWITCH_ON_DISABLED"}).tone == "bad"
    assert row(error="too hot").tone == "warn", "it runs, as /diagnostics says"


@pytest.mark.parametrize(
    ("age", "words"), [(None, "never heard"), (0.1, "live"), (2.34, "2.3 s ago"), (180, "3 min ago")]
)
def test_the_age_is_reported_when_it_matters(age, words):
    assert row(age_s=age).age == words


def test_live_never_stands_alongside_not_there():
    result = row(ready=False, nmt_state=None, age_s=0.01)
    assert (result.state, result.age) == ("not there", "not heard")


def test_what_comes_from_outside_is_escaped():
    evil = "<script>alert(1)</script>"
    axis = AXIS | {"joint": evil, "mode": evil}
    html = drive_table(axis_rows(state(nodes={evil: NODE | {"error": evil, "axes": [axis]}})))
    html += facts(state(load={evil: 0.1}, controllers={evil: "active"}))
    html += joint_table(state(joints={evil: {"command": 1.0}}).joints, frozenset(), {evil: evil})
    html += active_faults({evil: [evil]}) + event_log([event(level="error", text=evil)])
    html += fault_text(FaultListing(name=evil, does=evil, reaction=evil))
    assert "<script" not in html


@pytest.mark.parametrize(
    ("changed", "words", "tone", "action"),
    [
        ({}, "running", "good", ""),
        ({"state": "starting"}, "starting", "warn", ""),
        ({"state": "disabled"}, "needs enable", "warn", "enable"),
        ({"state": "fault"}, "fault", "bad", "fault-reset"),
        ({"state": "stopping"}, "stopping", "warn", ""),
        ({"state": "hovering"}, "hovering", "warn", ""),
        ({"latched": True, "state": "fault"}, "STOP is latched", "bad", "release"),
    ],
)
def test_the_robot_is_reported_in_words_with_what_to_do_next(changed, words, tone, action):
    result = banner(state(**changed))
    assert (result.words, result.tone, result.action) == (words, tone, action)
    assert tone == "good" or result.advice or result.cause or result.words == "hovering"


def test_running_with_drives_that_are_off_is_not_a_running():
    result = banner(drive_state(axis={"cia402_state": "SWITCH_ON_DISABLED"}))
    assert (result.words, result.action) == ("needs enable", "enable")
    assert result.cause == "All drives are disabled."
    axes = [AXIS, AXIS | {"joint": "lift", "cia402_state": "SWITCH_ON_DISABLED"}]
    assert banner(state(nodes={"both": NODE | {"axes": axes}})).cause == "lift is disabled."


def test_a_fault_names_its_causes_and_a_latch_its_owner():
    result = banner(drive_state(axis={"cia402_state": "FAULT", "error": "too hot"}))
    assert result.words == "needs enable"  # until the runtime says fault
    nodes = {"left": NODE | {"ready": False, "nmt_state": None, "error": "lost: no heartbeat"}}
    assert banner(state(state="fault", nodes=nodes)).cause == "left: lost: no heartbeat"
    text = {"left": NODE | {"ready": False, "nmt_state": None, "age": None, "error": "node 3 (left): no heartbeat"}}
    assert banner(state(state="fault", nodes=text)).cause == "left: no heartbeat"
    assert "view" in banner(state(latched=True, latched_by="view")).cause


def test_what_is_lost_is_reported_to_be_old_and_out_of_reach_of_stop():
    result = lost_banner("it has died")
    assert (result.words, result.action) == ("not connected", "")
    assert "does not reach" in result.cause
    assert "it has died" in result.cause
    assert "out of date" in result.advice


def test_below_the_state_stands_what_counts():
    truth = {"time": 1.0, "x": 1.0, "y": 0.0, "heading": 0.0, "error": [0.003, 0.004, 0.0]}
    assert "odometry is off by 5.0 mm and 0.00 deg" in facts(state(true_pose=truth))
    html = facts(state())
    assert "cycle 20 ms" in html
    assert "none missed" in html
    assert "bus can 2.1 %" in html
    assert "active: forward" in html


def test_a_robot_without_drives_or_joints_reports_this():
    assert "mock hardware" in drive_table([])
    assert "No joints" in joint_table({}, frozenset(), {})


def test_the_log_is_newest_first_and_marks_what_is_bad():
    html = event_log([event(text="old"), event(level="error", text="new")])
    assert html.index("new") < html.index("old")
    assert html.count("cc-bad") == 1
    assert "No events yet" in event_log([])


def test_a_sum_is_reported_once_in_the_words_of_the_runtime():
    assert event_log([event(count=3, text="it repeats (3 times in 2 s)")]).count("3 times") == 1


def test_faults_are_explained():
    silent, hot = FAULTS
    assert "until it is switched off" in fault_text(silent)
    assert "The drive is hot (once)" in fault_text(hot)
    own = FaultListing(name="silent", does="its heartbeats are lost")
    assert ">Its heartbeats are lost (until" in fault_text(own)
    assert "No virtual drive" in fault_text(None)
    assert "No fault is active" in active_faults({"left": []})
    assert "left: silent, hot" in active_faults({"left": ["silent", "hot"]})


def test_many_drives_take_a_line_each():
    few, many = (state(nodes={f"drive_{number}": NODE for number in range(count)}) for count in (3, 4))
    assert "cc-many" not in drive_table(axis_rows(few))
    assert "cc-many" in drive_table(axis_rows(many))


def test_a_joint_reports_its_tracking_error_and_which_set_points_were_odd():
    tracking = {"interface": "velocity", "error_max": 0.25, "error_rms": 0.0312, "skipped": 2}
    html = joint_table(state(joints={"wheel": {"command": 1.0, "tracking": tracking}}).joints, frozenset(), {})
    assert "0.25<small>rad/s, RMS 0.031, 2 skipped</small>" in html
    assert (
        "<tr class='cc-tracking'><td colspan='5'>tracking error 0.25" in html
    )  # a line of its own: no card is wide enough
    assert "cc-tracking" not in joint_table(state(joints={"wheel": {"command": 1.0}}).joints, frozenset(), {})


def test_a_line_of_text_is_escaped_and_an_empty_one_is_nothing():
    assert sentence("<b>", BAD) == "<p class='cc-line cc-bad'>&lt;b&gt;</p>"
    assert sentence("") == ""
