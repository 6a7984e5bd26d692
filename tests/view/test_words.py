import pytest

from canopen_control.view.words import active_faults, alarm, axis_rows, drive_table, event_log, fault_text, head


def node(**changed):
    axis = {"joint": "left_wheel_joint", "cia402_state": "OPERATION_ENABLED", "mode": "PV", "error": None}
    axis |= changed.pop("axis", {})
    whole = {"node_id": 3, "ready": True, "nmt_state": "OPERATIONAL", "age_s": 0.01, "error": None, "axes": [axis]}
    return whole | changed


def row(**changed):
    return axis_rows({"nodes": {"left_drive": node(**changed)}})[0]


def state(**changed):
    whole = {
        "state": "running",
        "latched": False,
        "latched_by": None,
        "controllers": {"forward": "active", "base": "inactive"},
        "cycle": {"period_s": 0.02, "missed": 0},
        "load": {"can": 0.021},
    }
    return whole | changed


@pytest.mark.parametrize(
    ("changed", "words", "tone"),
    [
        ({}, "enabled, follows commands", "good"),
        ({"axis": {"cia402_state": "SWITCH_ON_DISABLED"}}, "disabled", "idle"),
        ({"axis": {"cia402_state": "FAULT"}}, "fault", "bad"),
        ({"axis": {"cia402_state": None}}, "no statusword", "bad"),
        ({"ready": False, "nmt_state": "PRE_OPERATIONAL"}, "not ready, pre-operational", "warn"),
        ({"ready": False, "nmt_state": None, "age_s": None}, "not there", "bad"),
        ({"axes": []}, "no drive profile", "idle"),
    ],
)
def test_a_state_is_said_in_words_and_has_a_tone(changed, words, tone):
    assert (row(**changed).state, row(**changed).tone) == (words, tone)


def test_an_error_is_told_and_colours_what_does_not_run():
    found = row(ready=False, error="lost: no heartbeat for 0.5 s", nmt_state=None)
    assert (found.error, found.tone) == ("lost: no heartbeat for 0.5 s", "bad")
    assert "no heartbeat" in drive_table([found])


@pytest.mark.parametrize(
    ("age", "words"), [(None, "never heard"), (0.1, "live"), (2.34, "2.3 s ago"), (180, "3 min ago")]
)
def test_the_age_is_said_when_it_matters(age, words):
    assert row(age_s=age).age == words


def test_what_comes_from_outside_is_escaped():
    evil = "<script>alert(1)</script>"
    html = drive_table(axis_rows({"nodes": {evil: node(error=evil, axis={"joint": evil, "mode": evil})}}))
    html += head(evil, state(state=evil)) + head(evil, None) + alarm(None, evil)
    html += alarm(state(latched=True, latched_by=evil, load={evil: 0.1}, controllers={evil: "active"}))
    html += active_faults({evil: [evil]})
    html += event_log([{"time": 0.0, "level": "error", "text": evil}])
    html += fault_text({"does": evil, "reaction": evil, "once": False})
    assert "<script" not in html


def test_below_stop_stands_what_counts():
    assert "running" in head("robby", state())
    assert "not connected" in head("robby", None)
    html = alarm(state())
    assert "bus can 2.1 %" in html
    assert "active: forward" in html
    assert "atched by" not in html
    assert "STOP is latched" in head("robby", state(latched=True))
    assert "No safety function" in html
    assert "Latched by view" in alarm(state(latched=True, latched_by="view"))
    assert "STOP does not reach it" in alarm(None, "it has died")


def test_a_robot_without_drives_says_so():
    assert "mock hardware" in drive_table([])


def test_the_log_is_newest_first_and_marks_what_is_bad():
    html = event_log([{"time": 1.0, "level": "info", "text": "old"}, {"time": 2.0, "level": "error", "text": "new"}])
    assert html.index("new") < html.index("old")
    assert html.count("cc-bad") == 1
    assert "Nothing has happened" in event_log([])


def test_faults_are_explained():
    assert "until it is switched off" in fault_text({"does": "is silent", "reaction": "stops", "once": False})
    assert "No virtual drive" in fault_text(None)
    assert "No fault is on" in active_faults({"left": []})
    assert "left: silent, hot" in active_faults({"left": ["silent", "hot"]})


def test_a_fault_of_what_is_the_drives_own_is_a_sentence_too():
    told = {"reaction": "stops", "once": False}
    assert "The drive resets (until" in fault_text({"does": "resets", **told})
    assert ">Its heartbeats do not arrive (until" in fault_text({"does": "its heartbeats do not arrive", **told})


def test_many_drives_take_a_line_each():
    few, many = ({"nodes": {f"drive_{number}": node() for number in range(count)}} for count in (3, 4))
    assert "cc-many" not in drive_table(axis_rows(few))
    assert "cc-many" in drive_table(axis_rows(many))
