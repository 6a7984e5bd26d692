"""Signals of devices, and the objects that the boot writes and reads for them."""

import pytest

from canopen_control.data_files import data_path
from canopen_control.errors import BusConfigError
from canopen_control.master.config import inspect_bus, read_bus
from canopen_control.profiles import Profile

EDS = data_path("eds", "generic_cia401.eds")


def bus(folder, keys="", eds="generic_cia401.eds"):
    path = folder / "bus.yml"
    path.write_text(
        f"master: {{node_id: 1, sync_period: 20000}}\nnodes:\n  io:\n    dcf: {eds}\n    node_id: 5\n{keys}"
    )
    return path


def plan(folder, keys=""):
    return read_bus(bus(folder, keys)).plans["io"]


def written(found, index):
    return {
        write.subindex: int.from_bytes(write.data, "little", signed=True)
        for write in found.writes
        if write.index == index
    }


def warnings(folder, keys="", eds="generic_cia401.eds"):
    return [str(warning) for warning in inspect_bus(bus(folder, keys, eds))[1].warnings]


def test_a_module_has_its_signals_and_is_made_safe(tmp_path):
    result = plan(tmp_path)
    assert result.profile is Profile.IO
    assert len(result.signals) == 40
    assert written(result, 0x6206) == {1: -1, 2: -1}
    assert written(result, 0x6207) == {1: 0, 2: 0}
    assert written(result, 0x6443) == dict.fromkeys(range(1, 5), 1)
    assert written(result, 0x6444) == dict.fromkeys(range(1, 5), 0)
    assert written(result, 0x1016)[1] == 0x1012C  # the master, 300 ms
    assert all(write.reason for write in result.writes if write.index >= 0x6000)


def test_analogue_inputs_are_made_to_come_unless_they_come_anyway(tmp_path):
    assert written(plan(tmp_path), 0x6423) == {0: 1}
    assert written(plan(tmp_path), 0x6426) == dict.fromkeys(range(1, 5), 64)
    timed = "    tpdo: {1: {enabled: true}, 2: {enabled: true, event_timer: 100}}\n"
    assert written(plan(tmp_path, timed), 0x6423) == {}
    own = "    sdo: [{index: 0x6426, sub_index: 1, value: 5}]\n"
    assert written(plan(tmp_path, own), 0x6426) == {1: 5}


def test_inputs_are_read_once_and_outputs_not(tmp_path):
    assert {(read.index, read.subindex) for read in plan(tmp_path).reads} == {
        *((0x6000, sub) for sub in (1, 2)),
        *((0x6401, sub) for sub in range(1, 5)),
    }


def test_bus_yml_changes_signals_and_adds_others(tmp_path):
    result = plan(
        tmp_path,
        """\
    signals:
      - {name: ai0, factor: 0.001, offset: -1.5, unit: V, invalid: [-32768, 32767]}
      - {name: lamp, object: "0x6200:01.2", safe: true}
      - {name: valve, object: "0x6200:02.0", safe: keep}
      - {name: errors, object: 0x1001, type: i8}
      - {name: ao0, factor: 0.01, safe: 5}
""",
    )
    signals = result.signals
    assert (signals["ai0"].factor, signals["ai0"].offset, signals["ai0"].unit) == (0.001, -1.5, "V")
    assert signals["ai0"].invalid == (-32768.0, 32767.0)
    assert (signals["lamp"].output, signals["lamp"].bit, signals["lamp"].safe) == (True, 2, 1.0)
    assert signals["valve"].safe is None
    assert not signals["errors"].output
    assert written(result, 0x6444)[1] == 500


def test_a_named_line_goes_before_the_one_of_the_profile_in_what_is_safe(tmp_path):
    result = plan(tmp_path, '    signals: [{name: lamp, object: "0x6200:01.2", safe: true}, {name: do0, safe: keep}]\n')
    assert written(result, 0x6206)[1] == -2
    assert written(result, 0x6207)[1] == 4


MISTAKES = """\
    signals:
      - {name: di99}
      - {name: a, object: 6401x}
      - {name: b, object: "0x6401:09"}
      - {name: c, object: "0x6000:01.8"}
      - {name: d, object: 0x1008}
      - {name: e, object: "0x6401:01", type: u8}
      - {name: f, object: "0x6401:01", factor: 0}
      - {name: g, object: "0x6401:01", offset: .inf}
      - {name: di0, safe: 1}
      - {name: di0}
      - {name: do1, max_rate: 5}
"""


def test_all_errors_are_reported_at_once_with_their_places(tmp_path):
    with pytest.raises(BusConfigError) as caught:
        plan(tmp_path, MISTAKES)
    message = str(caught.value)
    for line, text in (
        (7, "the device profile has no signal 'di99' (did you mean 'di9'?); set `object`"),
        (8, "'6401x' is not an object; write 0x6401:01, or 0x6000:01.3 for bit 3"),
        (9, "0x6401:09 is not in generic_cia401.eds"),
        (10, "0x6000:01 Digital input 8 bits 1 has only bits 0 to 7"),
        (11, "0x1008:00 Manufacturer device name is not a number"),
        (12, "u8 has 8 bits, 0x6401:01 16"),
        (13, "0 cannot be used: expected a finite number other than 0"),
        (14, "inf cannot be used: expected a finite number"),
        (15, "di0 is an input; only an output has a safe value"),
        (16, "signal 'di0' is defined twice; use each name once"),
        (17, "do1 is an output; only an input has a maximum rate"),
    ):
        assert any(f"bus.yml:{line}:" in item and text in item for item in message.splitlines()), text


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("{name: a, object: 0x6401, type: u7}", "is not one of bool"),
        ("{object: 0x6401}", "missing key 'name'"),
        ("{name: a, objekt: 0x6401}", "unknown key 'objekt' (did you mean 'object'?)"),
        ("{name: do0, safe: perhaps}", "keep"),
        ("[1]", "expected a mapping"),
    ],
)
def test_keys_of_a_signal_are_checked_as_all_others(tmp_path, keys, words):
    problems = inspect_bus(bus(tmp_path, f"    signals: [{keys}]\n"))[1]
    assert any(words in str(item) for item in (*problems.errors, *problems.warnings))


def test_what_moves_an_axis_is_not_a_signal(tmp_path):
    path = bus(tmp_path, "    signals: [{name: target, object: 0x60FF}, {name: ok, object: 0x60FD}]\n", "TMCM-1270.eds")
    with pytest.raises(BusConfigError, match=r"0x60FF:00 moves an axis; only a joint can command it"):
        read_bus(path)


def test_outputs_that_keep_what_they_have_are_reported(tmp_path):
    assert warnings(tmp_path) == []
    kept = "    sdo: [{index: 0x6206, sub_index: 1, value: 0}]\n"
    assert "the outputs 0x6200:01 keep their values when the master is lost" in warnings(tmp_path, kept)[0]
    assert "no heartbeat consumer (0x1016)" in warnings(tmp_path, "    heartbeat_consumer: false\n")[0]
    text = EDS.read_text()
    start, end = text.index("[6206]"), text.index("[6207]")
    (tmp_path / "bare.eds").write_text(text[:start] + text[end:].replace("=0x6206", "=0x6207"))
    assert any("the outputs 0x6200:01, 0x6200:02 keep" in warning for warning in warnings(tmp_path, "", "bare.eds"))
    accepted = ", ".join(f"{{name: do{number}, safe: keep}}" for number in range(8))
    (reported,) = warnings(tmp_path, f"    signals: [{accepted}]\n", "bare.eds")
    assert "the outputs 0x6200:02 keep" in reported


def test_the_profile_of_a_device_with_a_wrong_file_is_given(tmp_path):
    assert plan(tmp_path, "    profile: 406\n").profile is Profile.ENCODER
