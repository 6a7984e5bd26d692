"""A node of a bus.yml: defaults, misspelt and misplaced keys, and combinations of keys."""

import re

import pytest
from support.busfile import MERGED, NESTED, mistakes, mistakes_of_a_node, warnings_of, with_node, write

from canopen_control.master.config import read_bus


def test_peer_merge_lets_whole_defaults_win_and_either_way_the_difference_is_reported(tmp_path):
    path = write(tmp_path, MERGED)
    ours, theirs = read_bus(path), read_bus(path, peer_merge=True)
    assert ours.nodes["left"].supervision.heartbeat_producer == 50
    assert sorted(ours.nodes["left"].boot.rpdo) == [1, 2]
    assert theirs.nodes["left"].supervision.heartbeat_producer == 100
    assert sorted(theirs.nodes["left"].boot.rpdo) == [1]
    reported = [note for note in ours.notes if "bus.yml:9:" in note]
    assert (
        "the node's own heartbeat_producer is used; ros2_canopen would use 100 from `defaults` (--peer-merge)"
        in reported[0]
    )
    reported = [note for note in theirs.notes if "bus.yml:9:" in note]
    assert "heartbeat_producer: 50, but --peer-merge uses 100 from `defaults`" in reported[0]
    assert [note for note in ours.notes if "bus.yml:10:" in note]


def test_without_a_difference_nothing_is_reported_merging(tmp_path):
    text = MERGED.replace("heartbeat_producer: 50", "heartbeat_producer: 100").replace("{2: {map", "{1: {map")
    text = text.replace("0x60FF", "0x6040")
    assert not [note for note in read_bus(write(tmp_path, text)).notes if "merge" in note]


@pytest.mark.parametrize(
    ("keys", "required"),
    [
        ("", True),
        ("mandatory: false", False),
        ("mandatory: true", True),
        ("required: false", False),
        ("boot: false", False),
        ("required: true, mandatory: true", True),
    ],
)
def test_awaited_members(tmp_path, keys, required):
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, " + keys + "}")
    assert read_bus(write(tmp_path, text)).nodes["right_drive"].required is required


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("required: true, mandatory: false", "mean the same and differ"),
        ("boot: false, required: true", "the robot cannot wait for it"),
        ("effort_mode: 4, torque_mode: 10", "`torque_mode` and `effort_mode` mean the same"),
        ("gear_ratio: 2.0", "gear_ratio needs counts_per_revolution"),
        ("counts_per_revolution: 1600, gear_ratio: [1]", "motor turns, joint turns"),
        ("scale_vel_to_dev: 0.0", "scale_vel_to_dev: 0.0 cannot be used: expected a number between 1e-15 and 1e15"),
        ("scale_vel_to_dev: 0.0, scale_pos_to_dev: .inf", "scale_pos_to_dev: inf cannot be used"),
        ("scale_vel_to_dev: 0.0, scale_pos_to_dev: .inf", "scale_vel_to_dev: 0.0 cannot be used"),
        ("scale_pos_to_dev: -1000.0", "only scale_pos_to_dev is negative, but position and velocity must have"),
        ("channels: [{}, {scale_vel_from_dev: -0.001}]", "only scale_vel_from_dev is negative"),
        ("channels: [{scale_pos_to_dev: 0.0}, {}]", "channels[0].scale_pos_to_dev: 0.0 cannot be used"),
        ("transition_timeouts_ms: {17: 100}", "transition 17 does not exist"),
    ],
)
def test_keys_that_contradict_each_other_are_reported_at_their_line(tmp_path, keys, words):
    assert words in mistakes_of_a_node(tmp_path, keys)


SCALES = ("scale_pos_to_dev", "scale_pos_from_dev", "scale_vel_to_dev", "scale_vel_from_dev")


def test_a_wrong_scale_of_the_node_is_one_error_for_all_its_axes(tmp_path):
    result = mistakes_of_a_node(tmp_path, "scale_pos_to_dev: 0.0, channels: [{}, {scale_vel_to_dev: -1000.0}]")
    assert result.count("bus.yml:") == 1, result


def test_axes_in_opposite_directions_are_no_mistake(tmp_path):
    mirrored = ", ".join(f"{key}: {-1000.0 if key.endswith('to_dev') else -0.001}" for key in SCALES)
    channels = f"right_drive: {{node_id: 2, channels: [{{}}, {{{mirrored}}}]}}"
    text = NESTED.replace("right_drive: {node_id: 2}", channels)
    config = read_bus(write(tmp_path, text))
    assert not [note for note in config.notes if "scale" in note]
    assert config.nodes["right_drive"].units.of_axis(1)["vel_to_dev"] == -1000.0


def test_units_by_name_and_torque_mode_are_what_they_stand_for(tmp_path):
    keys = "counts_per_revolution: 1600, gear_ratio: 2, reversed: true, torque_mode: 4"
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, " + keys + "}")
    node = read_bus(write(tmp_path, text)).nodes["right_drive"]
    assert node.units.scale_pos_to_dev == pytest.approx(-3200 / 6.283185307179586)
    assert node.units.scale_pos_from_dev * node.units.scale_pos_to_dev == pytest.approx(1.0)
    assert node.motion.effort_mode == 4


def test_an_object_of_the_sdo_list_without_a_value_is_written_as_0_with_a_warning(tmp_path):
    keys = "sdo: [{index: 0x6083}, {index: 0x6084, value: }, {index: 0x6085, value: 0}]"
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, " + keys + "}")
    notes = [note for note in read_bus(write(tmp_path, text)).notes if "so 0 is written" in note]
    assert [re.search(r"sdo\[\d\][.\w]*", note)[0] for note in notes] == ["sdo[0]", "sdo[1].value"]
    assert "write `value: 0`, or the value that is meant" in notes[0]


def test_scales_that_do_not_cancel_are_doubted(tmp_path):
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, scale_pos_to_dev: 254.6}")
    notes = read_bus(write(tmp_path, text)).notes
    assert any("scale_pos_to_dev times scale_pos_from_dev is 0.2546, not 1" in note for note in notes)


def test_a_misspelt_key_is_one_error_and_its_value_is_read(tmp_path):
    text = NESTED.replace("dcf: TMCM-1270.eds", "eds: TMCM-1271.eds")
    message = mistakes(tmp_path, text)
    assert "unknown key 'eds'; write `dcf`" in message
    assert "missing key" not in message
    assert "file 'TMCM-1271.eds' not found" in message


def test_pdos_written_as_keys_of_their_own_are_one_error_each_and_are_read(tmp_path):
    full = "{enabled: true, mapping: [{index: 0x6064}, {index: 0x606C}, {index: 0x6041}]}"
    text = (
        "master: {node_id: 1}\nnodes:\n  left: {node_id: 2, dcf: TMCM-1270.eds, tpdo1: %s, rpdo1: {enabled: false}}\n"
    )
    result = mistakes(tmp_path, text % full)
    assert "unknown key 'tpdo1'; write `1:` under `tpdo:`" in result
    assert "unknown key 'rpdo1'; write `1:` under `rpdo:`" in result
    assert "the mapping has 80 bits, a PDO at most 64" in result
    assert "expected" not in result


def test_pdo_keys_next_to_pdo_numbers_are_one_error(tmp_path):
    """As in an example of ros2_canopen's manual: the keys of PDO 1 and 2 are at the height of `1:` and `2:`."""
    text = """
    master: {node_id: 1}
    nodes:
      left:
        node_id: 2
        dcf: TMCM-1270.eds
        tpdo:
          1:
          enabled: true
          mapping: [{index: 0x6041}]
          2:
          enabled: true
          mapping: [{index: 0x6064}, {index: 0x606C}]
    """
    result = mistakes(tmp_path, text)
    assert "'enabled' belongs to a PDO: indent the keys of each PDO below its number, `1:`" in result
    assert result.count("bus.yml:") == 1, result


def test_a_misspelt_key_of_a_node_and_of_defaults_is_not_a_question_of_which_one_counts(tmp_path):
    text = NESTED.replace("dcf: TMCM-1270.eds", "dcf: TMCM-1270.eds\n      driver_name: proxy")
    text = text.replace("{node_id: 2}", "{node_id: 2, driver_name: drive}")
    result = mistakes(tmp_path, text)
    assert "unknown key 'driver_name'; write `driver`" in result
    assert "counts; ros2_canopen" not in result


def test_a_third_party_driver_is_named_and_its_keys_are_not_errors(tmp_path):
    keys = "driver: ros2_canopen::ThomsonDriver, center_position: 880, reverse: true"
    notes = with_node(tmp_path, keys).notes
    assert sum("ros2_canopen::ThomsonDriver is not part of this package" in note for note in notes) == 1
    for key in ("center_position", "reverse"):
        assert any(f"key '{key}' has no effect here: it belongs to ros2_canopen::Thomson" in note for note in notes)


@pytest.mark.parametrize("driver", ["ros2_canopen::Cia402Driver", "ros2_canopen::LifecycleProxyDriver", ""])
def test_a_driver_of_ros2_canopen_is_not_a_third_party_driver(tmp_path, driver):
    assert not [note for note in with_node(tmp_path, f"driver: '{driver}'").notes if "not part of" in note]


def test_a_key_near_one_that_is_there_too_has_no_effect(tmp_path):
    text = NESTED.replace("{node_id: 2}", "{node_id: 2, position_modes: 1, position_mode: 1}")
    (warning,) = [note for note in warnings_of(write(tmp_path, text)) if "position_modes" in note]
    assert "has no effect, neither here nor in ros2_canopen; remove it" in warning
    text = NESTED.replace("{node_id: 2}", "{node_id: 2, scale_eff_to_dev: 1.0}")
    (note,) = [note for note in read_bus(write(tmp_path, text)).notes if "scale_eff_to_dev" in note]
    assert "has no meaning here: efforts are commanded in the unit of 0x6071" in note


def test_a_retry_factor_of_0_is_for_nodes_without_guarding(tmp_path):
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, retry_factor: 0}")
    assert read_bus(write(tmp_path, text)).nodes["right_drive"].supervision.retry_factor == 0
    message = mistakes(tmp_path, text.replace("factor: 0", "factor: 0, guard_time: 100"))
    assert "0 switches node guarding off, but guard_time is set" in message


def test_a_nodes_own_keys_win_over_the_defaults_at_every_depth(tmp_path):
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, tpdo: {1: {event_timer: 7}}}")
    bus = read_bus(write(tmp_path, text))
    assert bus.nodes["left_drive"].supervision.heartbeat_producer == 50
    assert bus.nodes["right_drive"].supervision.heartbeat_producer == 100
    tpdo = bus.nodes["right_drive"].boot.tpdo[1]
    assert (tpdo.transmission, tpdo.event_timer) == (1, 7)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("recovery: maybe", "expected boot or enable, got the text 'maybe'"),
        ("name: other", "unknown key 'name'"),
        ("tpdo: {1: {cob_id: automatic}}", "cob_id"),
        ("tpdo: {1: {cob_id: 0x601}}", "not allowed for PDOs"),
        ("heartbeat_consumer: true, dcf: generic_cia402.eds, restore_configuration: 99", "0x1011:63 is not in"),
        ("time_cob_id: 0x100", "0x1012:00 is not in TMCM-1270.eds"),
        ("rpdo: {1: {event_deadline: 3}}", "0x1400:05 is not in TMCM-1270.eds"),
        ("rpdo: {9: {transmission: 1}}", "has no RPDO 9 (0x1408); it has 4"),
        ("operation_mode: 9", "unknown key 'operation_mode'; write `velocity_mode: 9` (CSV)"),
        ("default_operation_mode: 1", "write `position_mode: 1` (PP)"),
        ("mode: 4", "write `effort_mode: 4`"),
        ("mode: 6", "write `position_mode`, `velocity_mode` or `effort_mode`"),
        ("TPDO2: {enabled: true}", "write `2:` under `tpdo:`"),
        ("eds: x.eds", "write `dcf`"),
        ("serial_number: 22320XXX", "expected an integer, got the text '22320XXX'; 0 accepts any"),
        ("heartbeat_consumer: 2000", "heartbeat_producer x heartbeat_multiplier"),
        ("configuration_file: none.bin", "file 'none.bin' not found"),
    ],
)
def test_what_cannot_be_is_reported_at_its_key(tmp_path, keys, words):
    assert words in mistakes_of_a_node(tmp_path, keys)


@pytest.mark.parametrize("key", ["line: 3", "mandatory_slave_heartbeat: 2000", "foo_bar: {a: 1}"])
def test_a_key_that_no_other_one_is_like_is_reported_and_without_effect(tmp_path, key):
    (note,) = [item for item in with_node(tmp_path, key).notes if "unknown key" in item]
    assert "has no effect, neither here nor in ros2_canopen" in note


# a public bus.yml of a crane has `name` in `master:`, and `gearbox_ratio` beside scales that include the gear
@pytest.mark.parametrize(
    ("keys", "is_error"),
    [
        ("gearbox_ratio: 20.0, scale_pos_to_dev: 200000.0, scale_pos_from_dev: 0.000005", False),
        ("gearbox_ratio: 20.0", True),
        ("counts_per_revolution: 4096, gearbox_ratio: 20.0", True),
        ("poling: true", False),
    ],
)
def test_a_similar_key_is_an_error_only_if_it_could_be_added(tmp_path, keys, is_error):
    if is_error:
        assert "unknown key 'gearbox_ratio' (did you mean 'gear_ratio'?)" in mistakes_of_a_node(tmp_path, keys)
    else:
        (note,) = [item for item in with_node(tmp_path, keys).notes if "unknown key" in item]
        assert "has no effect, neither here nor in ros2_canopen" in note


def test_a_name_of_the_master_is_reported_and_without_effect(tmp_path):
    text = NESTED.replace("node_id: 1\n", "node_id: 1\n      name: master\n")
    (note,) = [item for item in read_bus(write(tmp_path, text)).notes if "unknown key" in item]
    assert "master.name: unknown key 'name' has no effect" in note


@pytest.mark.parametrize(
    ("offsets", "rest"),
    [
        ("offset_pos_to_dev: 100000", "100"),
        ("offset_pos_from_dev: -100", "-100"),
        ("offset_pos_to_dev: 100000, offset_pos_from_dev: -90", "10"),
        ("offset_pos_to_dev: 100000, offset_pos_from_dev: -100", ""),
    ],
)
def test_offsets_that_do_not_cancel_are_doubted(tmp_path, offsets, rest):
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, " + offsets + "}")
    text = text.replace("right_drive: {node_id: 2", "right_drive: {node_id: 2, scale_pos_to_dev: 1000, "
                        "scale_pos_from_dev: 0.001")  # fmt: skip
    doubts = [note for note in read_bus(write(tmp_path, text)).notes if "do not cancel" in note]
    assert len(doubts) == bool(rest)
    if rest:
        assert f"would show a position {rest} away from it; set offset_pos_from_dev: " in doubts[0]


@pytest.mark.parametrize(
    ("keys", "form"),
    [
        ("sdo: [{0x6081: 1000}]", "write each object as `- {index: 0x6081, sub_index: 0, value: 1000}`"),
        ("sdo: [{0x6083: 1, 0x6084: 2}]", "write each object as `- {index: 0x6083, sub_index: 0, value: 1}`"),
        ("sdo: [{'0x60C2:01': 20}]", "write each object as `- {index: 0x60C2, sub_index: 1, value: 20}`"),
        ("sdo: {0x6081: 1000}", "write each object as `- {index: 0x6081, sub_index: 0, value: 1000}`"),
        ("sdo: {index: 0x6081, value: 5}", "begin each object with a dash: `- {index: ...}`"),
        ("rpdo: {1: {mapping: [0x6040]}}", "write each object as `- {index: 0x6040, sub_index: 0}`"),
        ("tpdo: [{mapping: [{index: 0x6041}]}]", "write `1:`, `2:` ... instead of the dashes"),
        ("tpdo: [{1: {mapping: [{index: 0x6041}]}}]", "write `1:`, `2:` ... instead of the dashes"),
        ("tpdo: [1, 2]", "write `1:`, `2:` ... instead of the dashes"),
        ("rpdo: {1: {mapping: [{0x6040: 16}]}}", "write each object as `- {index: 0x6040, sub_index: 0}`"),
        ("sdo: [{0x6081: {value: 1000}}]", "write each object as `- {index: 0x6081, sub_index: 0, value: ...}`"),
        ("sdo: {comment: x, 0x6081: 5}", "write each object as `- {index: 0x6081, sub_index: 0, value: 5}`"),
        ("sdo: {a: 5}", "begin each object with a dash: `- {index: ...}`"),
        ("sdo: {}", "begin each object with a dash: `- {index: ...}`"),
    ],
)
def test_an_object_or_pdo_in_another_form_is_one_error_with_the_right_form(tmp_path, keys, form):
    text = mistakes_of_a_node(tmp_path, keys)
    assert form in text
    assert text.count("bus.yml:") == 1


@pytest.mark.parametrize(
    "keys",
    [
        "sdo: [{index: 0x6081, value: 1000, comment: mm/s}]",
        "rpdo: {1: {mapping: [{index: 0x6040, default_value: 6}]}}",
        "rpdo: {1: {mapping: [{index: 0x6040}], comment: commands}}",
    ],
)
def test_a_key_without_meaning_in_a_list_has_no_effect(tmp_path, keys):
    """dcfgen reads only the keys that it knows."""
    (note,) = [item for item in with_node(tmp_path, keys).notes if "unknown key" in item]
    assert "has no effect, neither here nor in ros2_canopen" in note


@pytest.mark.parametrize(
    "keys",
    [
        "sdo: [{index: 0x6081, data: 1000}]",
        "sdo: [{index: 0x6081, unit: 1000}]",
        "rpdo: {1: {mapping: [{index: 0x6040, sub: 1}]}}",
        "rpdo: {1: {type: 1}}",
        "rpdo: {1: {transmission_type: 1}}",
        "sdo: [{index: 0x6081, value: 1000, SubIndex: 0}]",
        "sdo: [{index: 0x6081, value: 1000, si: 0}]",
        "rpdo: {1: {mode: sync}}",
        "rpdo: {1: {period: 10}}",
        "rpdo: {1: {valid: false}}",
        "rpdo: {1: {disable: true}}",
        "rpdo: {1: {entries: [0x6040]}}",
    ],
)
def test_a_key_in_a_list_that_may_stand_for_another_is_an_error(tmp_path, keys):
    assert "unknown key" in mistakes_of_a_node(tmp_path, keys)


@pytest.mark.parametrize("text", ["Auto", '"$NODEID+0x180"', "default"])
def test_a_cob_id_that_is_no_number_names_auto(tmp_path, text):
    result = mistakes_of_a_node(tmp_path, f"tpdo: {{1: {{cob_id: {text}}}}}")
    assert "write auto for the default COB-ID of the node, or the COB-ID as a number, such as 0x182" in result
