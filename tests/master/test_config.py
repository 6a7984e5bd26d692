import re
import shutil
import tempfile
import textwrap
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.busfile import MERGED, NESTED, mistakes, warnings_of, with_node, write
from support.properties import examples

from canopen_control.data_files import data_path
from canopen_control.errors import BusConfigError, EdsError
from canopen_control.master.config import NotFound, Sources, inspect_bus, read_bus
from canopen_control.od.dcf import encode_concise, write_dcf
from canopen_control.od.eds import read_eds


def test_pdos_that_wait_for_a_sync_that_is_not_sent_are_named(tmp_path):
    pdo = "{enabled: true, cob_id: auto, transmission: %d, mapping: [{index: 0x6041}]}"
    text = MERGED.replace("rpdo: {1:", f"tpdo: {{1: {pdo % 1}, 2: {pdo % 255}}}\n      rpdo: {{1:")
    (warning,) = [note for note in warnings_of(write(tmp_path, text)) if "SYNC" in note]
    assert "bus.yml:1:" in warning
    assert "have no effect: TPDO 1 of left; set sync_period" in warning
    reported = warnings_of(write(tmp_path, text.replace("node_id: 1", "node_id: 1, sync_period: 20000")))
    assert not [note for note in reported if "no SYNC" in note]
    with pytest.raises(BusConfigError) as error:  # the key that is wrong explains it
        read_bus(write(tmp_path, text.replace("node_id: 1", "node_id: 1, sync_perod: 20000")))
    assert "no SYNC" not in str(error.value)


EDS = data_path("eds", "TMCM-1270.eds")


def test_a_file_is_sought_in_the_nodes_path_the_files_path_next_to_bus_yml_and_among_the_bundled(tmp_path, monkeypatch):
    sources = Sources(tmp_path, "@BUS_CONFIG_PATH@/general")
    assert sources.find("TMCM-1270.eds") == EDS
    places = [tmp_path, tmp_path / "general", tmp_path / "own"]
    monkeypatch.setenv("OWN_FILES", str(places[2]))
    for place in places:
        place.mkdir(exist_ok=True)
        shutil.copy(EDS, place)
        assert sources.find("TMCM-1270.eds", "$OWN_FILES") == place / "TMCM-1270.eds"


def test_a_path_of_another_computer_is_the_file_of_that_name_next_to_bus_yml_and_a_note_reports_this(tmp_path):
    text = NESTED.replace("dcf: TMCM-1270.eds", "dcf: /home/robot/config/TMCM-1270.eds")
    path = write(tmp_path, text)
    (tmp_path / EDS.name).unlink()
    assert read_bus(path).eds_paths["left_drive"] == EDS
    shutil.copy(EDS, tmp_path)
    bus = read_bus(path)
    assert bus.eds_paths["left_drive"] == tmp_path / EDS.name
    (note,) = [note for note in bus.notes if "/home/robot" in note]
    assert note.endswith(f"/home/robot/config/{EDS.name} does not exist; {tmp_path / EDS.name} is used instead")


def test_a_bundled_file_that_replaces_a_missing_one_is_reported_once_with_the_folders_that_lack_it(tmp_path):
    path = write(tmp_path, NESTED)
    assert read_bus(path).substitutes == ()
    (tmp_path / EDS.name).unlink()
    bus = read_bus(path)
    assert bus.eds_paths["left_drive"] == bus.eds_paths["right_drive"] == EDS
    (sentence,) = bus.substitutes
    assert sentence == (
        f"{path}: {EDS.name} is not in {tmp_path}, so the bundled file {EDS} is used; "
        "if your device has another file, copy it to that folder"
    )
    assert not [note for note in bus.notes if "the bundled file" in note]
    assert read_bus(data_path("config", "robby") / "bus.yml").substitutes == ()


@pytest.mark.parametrize("place", ["tmcm-1270.EDS", "eds/TMCM-1270.eds"])
def test_a_file_of_that_name_with_another_content_that_is_not_used_is_a_warning(tmp_path, place):
    path = write(tmp_path, NESTED)
    other = tmp_path / place
    other.parent.mkdir(exist_ok=True)
    (tmp_path / EDS.name).rename(other)
    bus = read_bus(path)
    assert len(bus.substitutes) == 1
    assert not [note for note in bus.notes if place in note]  # the same content
    other.write_text(other.read_text() + "; of another revision\n")
    (note,) = [note for note in read_bus(path).notes if place in note]
    assert f"the bundled file {EDS} is used, and {other}, whose content differs, is not; write `dcf: {place}`" in note
    path.write_text(path.read_text().replace("dcf: TMCM-1270.eds", f"dcf: {place}"))
    assert read_bus(path).eds_paths["left_drive"] == other
    assert read_bus(path).substitutes == ()


@pytest.mark.parametrize("section", ["options", "defaults", "master"])
def test_a_node_that_is_indented_too_far_is_named(tmp_path, section):
    text = """\
        options: {}
        master: {node_id: 1}
        defaults: {dcf: TMCM-1270.eds}
        """
    inside = text.replace(f"{section}: {{", f"{section}: {{joint_1: {{node_id: 3}}, ")
    message = mistakes(tmp_path, inside)
    assert "unknown key 'joint_1'" in message
    assert "indented too far" in message
    if section != "master":
        assert "no nodes" not in message
    inside = text.replace("{dcf:", "{nodes: {joint_1: {node_id: 3}}, dcf:")
    assert "defaults.nodes: unknown key 'nodes'; write `nodes:` at the margin" in mistakes(tmp_path, inside)


@pytest.mark.parametrize("node_id", ["0", "x", "200"])
def test_a_wrong_node_id_of_the_master_is_one_error(tmp_path, node_id):
    text = f"master: {{node_id: {node_id}}}\nnodes:\n  left: {{node_id: 1, dcf: TMCM-1270.eds}}\n"
    result = mistakes(tmp_path, text)
    assert "already used by the master" not in result
    assert result.count("bus.yml:") == 1, result


def test_the_length_of_a_mapped_object_may_be_given_and_is_compared(tmp_path):
    text = MERGED.replace("{index: 0x6040}", "{index: 0x6040, bits: 16}")
    assert not [note for note in warnings_of(write(tmp_path, text)) if "bits" in note]
    (warning,) = [note for note in warnings_of(write(tmp_path, text.replace("16}", "32}"))) if "bits" in note]
    assert "0x6040:00 has 16 bits in TMCM-1270.eds, which replace the 32 here; correct or remove `bits`" in warning


def test_a_missing_file_names_the_places_and_a_variable_that_is_not_set(tmp_path, monkeypatch):
    monkeypatch.delenv("NOT_SET", raising=False)
    with pytest.raises(NotFound, match=f"file 'x.eds' not found in .*{tmp_path}"):
        Sources(tmp_path).find("x.eds")
    with pytest.raises(NotFound, match="environment variable is not set"):
        Sources(tmp_path, "$NOT_SET/eds").find("x.eds")


def test_one_file_serves_many_nodes_with_their_own_ids(tmp_path):
    sources = Sources(tmp_path)
    assert sources.dictionary(EDS, 3)[0x1800, 1].default == 0x40000183
    assert sources.dictionary(EDS, 5)[0x1800, 1].default == 0x40000185
    assert sources.dictionary(EDS, 3) is sources.dictionary(EDS, 3)
    assert list(sources.issues) == [EDS]
    with pytest.raises(EdsError):
        sources.dictionary(data_path("config", "robby") / "bus.yml", 3)


def test_a_concise_dcf_and_the_parameter_values_of_a_dcf_are_downloads(tmp_path):
    sources = Sources(tmp_path)
    (tmp_path / "left.bin").write_bytes(encode_concise([(0x6083, 0, b"\x01\0\0\0"), (0x2000, 0, b"\x03")]))
    assert sources.downloads("left.bin", "", 3) == ((0x6083, 0, b"\x01\0\0\0"), (0x2000, 0, b"\x03"))
    write_dcf(tmp_path / "left.dcf", read_eds(EDS).od, 3, 1_000_000, {(0x6083, 0): 7, (0x2000, 0): 2})
    assert sources.downloads("left.dcf", "", 3) == ((0x2000, 0, b"\x02"), (0x6083, 0, b"\x07\0\0\0"))


def test_a_concise_dcf_that_is_cut_short_is_refused(tmp_path):
    (tmp_path / "left.bin").write_bytes(encode_concise([(0x6083, 0, b"\x01\0\0\0")])[:-1])
    with pytest.raises(ValueError, match="only 3 of 4 bytes"):
        Sources(tmp_path).downloads("left.bin", "", 3)


ROBBY = data_path("config", "robby") / "bus.yml"


def test_robby_has_its_two_drives_with_opposite_signs():
    bus = read_bus(ROBBY)
    left, right = bus.nodes["left_drive"], bus.nodes["right_drive"]
    assert (left.node_id, right.node_id, bus.master.sync_period) == (3, 2, 20000)
    assert left.units.scale_vel_to_dev == -right.units.scale_vel_to_dev
    assert left.supervision.heartbeat_timeout_ns == 500_000_000
    assert bus.eds_paths["left_drive"].name == "TMCM-1270.eds"


def test_the_flat_shape_is_read_too(tmp_path):
    bus = read_bus(
        write(
            tmp_path,
            """\
            options: {dcf_path: "@BUS_CONFIG_PATH@"}
            master: {node_id: 1}
            .anchor: &drive {dcf: TMCM-1270.eds}
            wheel:
              <<: *drive
              node_id: 0x05
            """,
        )
    )
    assert list(bus.nodes) == ["wheel"]
    assert bus.nodes["wheel"].node_id == 5


def test_all_errors_are_reported_at_once_with_line_and_nearest_key(tmp_path):
    text = """\
        master: {node_id: 1, sync_period: fast}
        nodes:
          left:
            dcf: TMCM-1270.eds
            node_id: 200
          right:
            dcf: TMCM-1270.eds
            node_id: 3
            hartbeat_producer: 100
          third:
            dcf: missing.eds
            node_id: 4
        """
    message = mistakes(tmp_path, text)
    for line, words in ((1, "sync_period"), (5, "200"), (9, "heartbeat_producer"), (11, "missing.eds")):
        assert f"bus.yml:{line}:" in message, message
        assert words in message
    assert "4 errors" in message


def test_two_nodes_with_one_node_id_name_each_other_and_the_line(tmp_path):
    text = mistakes(tmp_path, NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 3}"))
    assert "node-ID 3 is already used by left_drive" in text
    assert "bus.yml:13:" in text


def test_a_node_may_not_have_the_masters_id(tmp_path):
    assert "already used by the master" in mistakes(tmp_path, NESTED.replace("node_id: 3", "node_id: 1"))


def test_objects_that_the_eds_lacks_are_errors_of_the_file(tmp_path):
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, sdo: [{index: 0x5999, value: 1}]}")
    message = mistakes(tmp_path, text)
    assert "0x5999:00 is not in TMCM-1270.eds" in message
    assert "bus.yml:13:" in message


def test_keys_of_the_other_stack_are_named_once(tmp_path):
    text = NESTED.replace("dcf: TMCM-1270.eds", "dcf: TMCM-1270.eds\n      polling: true")
    bus = read_bus(write(tmp_path, text))
    assert [note for note in bus.notes if "polling" in note] == [
        f"{bus.path}: polling: has no meaning here: drives are read every SYNC"
    ]


def test_a_drive_that_nothing_would_stop_is_refused(tmp_path):
    text = NESTED.replace("node_id: 3\n", "node_id: 3\n        heartbeat_consumer: false\n")
    assert "nothing would stop this drive" in mistakes(tmp_path, text)
    accepted = text.replace("heartbeat_consumer: false", "heartbeat_consumer: false\n        allow_unsupervised: true")
    assert read_bus(write(tmp_path, accepted)).nodes["left_drive"].supervision.allow_unsupervised


def test_a_missing_file_and_text_that_is_not_a_yaml_are_one_sentence_each(tmp_path):
    with pytest.raises(BusConfigError, match="no-such"):
        read_bus(tmp_path / "no-such.yml")
    broken = tmp_path / "broken.yml"
    broken.write_text("master: [1, 2\nnodes: }")
    with pytest.raises(BusConfigError, match=r"broken.yml:2:"):
        read_bus(broken)


TEN_MISTAKES = """\
    options: {dcf_path: "@BUS_CONFIG_PATH@", heartbeat_multiplyer: 3}
    master:
      node_id: 1
      sync_period: 20ms
      baudrate: 999
      node_id: 2
    defaults:
      dcf: TMCM-1270.eds
    nodes:
      left:
        node_id: 200
      right:
        node_id: 3
        tpdo: {1: {mapping: [{index: 0x1008}]}}
        sdo: [{index: 0x6083, value: 1.5}]
      third:
        dcf: missing.eds
        node_id: 4
      fourth:
        node_id: 3
      fifth:
        node_id: 5
        counts_per_revolution: 1600
        scale_pos_to_dev: 1.0
    """


def test_ten_different_errors_are_ten_messages_with_the_right_lines(tmp_path):
    text = mistakes(tmp_path, TEN_MISTAKES)
    expected = {
        1: "unknown key 'heartbeat_multiplyer' (did you mean 'heartbeat_multiplier'?)",
        4: "expected an integer, got the text '20ms'",
        5: "999 is not one of 10, 20, 50, 125, 250, 500, 800, 1000",
        6: "duplicate key 'node_id' (first at line 3)",
        11: "200 is out of range 1..127",
        14: "0x1008:00 Manufacturer device name cannot be mapped into a TPDO",
        15: "1.5 is not a valid UNSIGNED32: expected a whole number",
        17: "file 'missing.eds' not found",
        20: "node-ID 3 is already used by right",
        23: "counts_per_revolution and scale_pos_to_dev define the same scales",
    }
    source = textwrap.dedent(TEN_MISTAKES).splitlines()
    for line, words in expected.items():
        message = next(part for part in text.split("\n") if f"bus.yml:{line}:" in part)
        assert words in message, text
        at = text.index(message)
        shown, caret = text[at:].split("\n")[1:3]
        assert shown.strip() == source[line - 1].strip()
        column = int(message.split("bus.yml:")[1].split(":")[1])
        assert caret.index("^") == 4 + column - 1
    assert len(expected) == 10
    assert text.endswith("10 errors"), text


def test_an_unknown_section_alongside_nodes_is_not_a_silent_node(tmp_path):
    text = mistakes(tmp_path, NESTED.replace("defaults:", "option: {}\n    defaults:"))
    assert "unknown key 'option' (did you mean 'options'?)" in text


@pytest.mark.parametrize("key", ["inhibit_time: 3", "sync_start: 1", "event_timer: 7"])
def test_a_time_of_tpdos_at_an_rpdo_without_it_is_a_note(tmp_path, key):
    bus = with_node(tmp_path, f"rpdo: {{1: {{{key}}}}}")
    name = key.partition(":")[0]
    assert any(f"rpdo.1.{name}: has no meaning here: the setting is for TPDOs" in note for note in bus.notes)
    assert all(write.address[0] != 0x1400 or write.subindex in (1, 2) for write in bus.plans["right_drive"].writes)


@pytest.mark.parametrize("rate", [10, 20, 50, 125, 250, 500, 800, 1000])
def test_a_bit_rate_in_bits_per_second_is_taken_and_noted(tmp_path, rate):
    bus = read_bus(write(tmp_path, NESTED.replace("node_id: 1\n", f"node_id: 1\n      baudrate: {rate}000\n")))
    assert bus.master.baudrate == rate
    assert (
        f"{bus.path}: master.baudrate: {rate}000 is interpreted as bit/s; write {rate}, the unit is kbit/s" in bus.notes
    )


@pytest.mark.parametrize("kind", ["rpdo", "tpdo"])
def test_a_pdo_that_the_device_does_not_have_is_off_already(tmp_path, kind):
    bus = with_node(tmp_path, f"{kind}: {{5: {{enabled: false}}}}")
    assert not [item for item in bus.plans["right_drive"].writes if item.pdo == (kind, 5)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("can_interface_name: vcan0", "write `channel` under `master:`, or --can"),
        ("master_node_id: 1", "write `node_id` under `master:`"),
        ("slaves: {}", "write `nodes:`"),
    ],
)
def test_a_key_alongside_the_sections_is_reported_with_where_it_belongs(tmp_path, text, expected):
    assert expected in mistakes(tmp_path, NESTED.replace("defaults:", f"{text}\n    defaults:"))


@pytest.mark.parametrize("name", ["slaves", "drives", "node", "devices"])
def test_nodes_under_another_name_are_one_error(tmp_path, name):
    text = mistakes(tmp_path, NESTED.replace("nodes:", f"{name}:"))
    assert f"unknown key '{name}'; write `nodes:`" in text
    assert "errors" not in text


def test_sections_that_are_indented_too_far_are_reported_and_no_missing_master(tmp_path):
    text = mistakes(tmp_path, "options:\n  master: {node_id: 1}\nnodes:\n  a: {node_id: 2, dcf: TMCM-1270.eds}\n")
    assert "write `master:` at the margin" in text
    assert "no `master` section" not in text


def test_two_live_pdos_with_one_cob_id_are_refused(tmp_path):
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, tpdo: {1: {cob_id: 0x183}}}")
    message = "COB-ID 0x183 of TPDO 1 of right_drive is already used by TPDO 1 of left_drive"
    assert f"{message}; write another cob_id, or `cob_id: auto`" in mistakes(tmp_path, text)


def test_cob_ids_of_one_node_id_in_an_eds_are_refused_with_the_keys_that_give_each_node_its_own(tmp_path):
    eds = data_path("eds", "generic_cia401.eds").read_text(encoding="utf-8")
    eds = re.sub(r"\$NODEID\s*\+\s*0x([2-5]00|[1-4]80)", lambda m: f"0x{int(m[1], 16) + 1:X}", eds)
    (tmp_path / "fixed.eds").write_text(eds, encoding="utf-8")
    keys = "dcf: fixed.eds, revision_number: 0"
    nodes = "".join(f"  {name}: {{node_id: {node_id}, {keys}}}\n" for name, node_id in (("a", 5), ("b", 6)))
    text = f"master: {{node_id: 1, sync_period: 20000}}\nnodes:\n{nodes}"
    advice = set(re.findall(r"COB-IDs that follow the node-ID: `([rt]pdo: .*)` under b", mistakes(tmp_path, text)))
    assert len(advice) == 2
    bus = read_bus(write(tmp_path, text.replace(f"6, {keys}", f"6, {keys}, {', '.join(advice)}")))
    assert {pdo.cob_id & 0x7F for pdo in (*bus.plans["b"].rpdos, *bus.plans["b"].tpdos)} == {6}


def test_the_node_id_may_be_the_dcfs_and_255_leaves_a_node_out(tmp_path):
    from canopen_control.od.dcf import write_dcf
    from canopen_control.od.eds import read_eds

    write_dcf(tmp_path / "drive.dcf", read_eds(data_path("eds", "TMCM-1270.eds")).od, 7, 1_000_000, {(0x2000, 0): 2})
    text = """\
        master: {node_id: 1}
        nodes:
          wheel: {dcf: drive.dcf}
          spare: {dcf: drive.dcf, node_id: 255}
        """
    bus = read_bus(write(tmp_path, text))
    assert {name: node.node_id for name, node in bus.nodes.items()} == {"wheel": 7}
    assert any("spare is skipped" in note for note in bus.notes)
    without = text.replace("dcf: drive.dcf}", "dcf: TMCM-1270.eds}", 1)
    assert "missing key 'node_id'; TMCM-1270.eds has none either" in mistakes(tmp_path, without)


def test_variables_of_the_environment_and_the_channel(tmp_path, monkeypatch):
    monkeypatch.setenv("DRIVES", str(tmp_path))
    monkeypatch.setenv("BUS_OF_ROBOT", "vcan7")
    text = NESTED.replace("node_id: 1\n", "node_id: 1\n      channel: $BUS_OF_ROBOT\n", 1)
    text = text.replace("dcf: TMCM-1270.eds", 'dcf: "$DRIVES/TMCM-1270.eds"')
    bus = read_bus(write(tmp_path, text))
    assert bus.master.channel == "vcan7"
    assert bus.eds_paths["left_drive"] == tmp_path / "TMCM-1270.eds"
    assert "local:" in mistakes(tmp_path, text.replace("$BUS_OF_ROBOT", "no such bus!"))


def test_every_unused_key_is_named_once_with_what_takes_its_place(tmp_path):
    text = NESTED.replace(
        "sync_period: 20000", "sync_period: 20000\n      vendor_id: 5\n      start_nodes: false\n      dcf_path: x"
    ).replace("dcf: TMCM-1270.eds", "dcf: TMCM-1270.eds\n      software_file: a.bin\n      channels: [{}]")
    notes = [note.split(": ", 1)[1] for note in read_bus(write(tmp_path, text)).notes if "has no meaning here" in note]
    assert [note.split(":")[0] for note in notes] == ["dcf_path", "software_file", "start_nodes", "vendor_id"]


LINES = ROBBY.read_text().splitlines()
SCRAPS = st.sampled_from(
    [
        "",
        "  ",
        "x: 1",
        "- a",
        "nodes: 3",
        "master: []",
        "  left_drive: 7",
        "    sdo: {1: 2}",
        "  tpdo: [1]",
        "    mapping: 1",
        "    1: {mapping: [{index: 0x6041, sub_index: 300}]}",
        "    cob_id: -1",
        "  dcf: 5",
        "    node_id: 255",
        "\t",
        "!!int x",
    ]
)


@pytest.mark.rest
@settings(max_examples=examples(150))
@given(
    st.lists(st.tuples(st.integers(0, len(LINES) - 1), SCRAPS, st.booleans()), min_size=1, max_size=6), st.booleans()
)
def test_whatever_is_in_the_file_is_a_bus_or_a_configuration_error(changes, peer_merge):
    lines = list(LINES)
    for number, scrap, drop in changes:
        lines[number % len(lines)] = scrap
        if drop and len(lines) > 1:
            del lines[number % len(lines)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bus.yml"
        path.write_text("\n".join(lines))
        try:
            bus = read_bus(path, peer_merge=peer_merge)
        except BusConfigError:
            return
        assert set(bus.plans) == set(bus.nodes)


def test_a_key_without_a_value_is_a_warning_with_its_line(tmp_path):
    bus = with_node(tmp_path, "tpdo: {1: {transmission: }}, guard_time: ")
    texts = [note for note in bus.notes if "no value, so the default applies" in note]
    assert [re.search(r"[a-z_0-9.]+: no value", text)[0] for text in texts] == [
        "nodes.right_drive.tpdo.1.transmission: no value",
        "nodes.right_drive.guard_time: no value",
    ]
    assert all(re.match(r".*bus\.yml:\d+:\d+: ", text) for text in texts)


def test_a_key_in_capitals_is_an_error_with_the_key_that_is_meant(tmp_path):
    text = mistakes(tmp_path, NESTED.replace("right_drive: {node_id: 2", "right_drive: {node_id: 2, Mandatory: true"))
    assert "unknown key 'Mandatory' (did you mean 'mandatory'?)" in text


def test_a_misspelt_key_beside_the_correct_one_is_a_warning_with_the_correct_one(tmp_path):
    bus = with_node(tmp_path, "mandatory: true, mandatry: false")
    assert any("remove it, or write 'mandatory'" in note for note in bus.notes)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("  right_drive:", "nodes:\n  right_drive:", "duplicate key 'nodes' (first at line"),
        ("sub_index: 1", "sub: 1", "unknown key 'sub' (did you mean 'sub_index'?)"),
        ("sub_index: 2", "subindx: 2", "unknown key 'subindx' (did you mean 'sub_index'?)"),
        ("{index: 0x6041, sub_index: 0}", "{index: 0x6041, sub: 0}", "unknown key 'sub' (did you mean 'sub_index'?)"),
        ("master:\n", "master:\n  node_id: 1\nmaster:\n", "duplicate key 'master' (first at line"),
    ],
)
def test_a_repeated_or_misspelt_key_has_no_further_errors(tmp_path, old, new, words):
    text = data_path("config", "robby/bus.yml").read_text()
    assert old in text
    with pytest.raises(BusConfigError) as error:
        read_bus(write(tmp_path, text.replace(old, new, 1)))
    (message,) = [line for line in str(error.value).splitlines() if "bus.yml:" in line]
    assert words in message


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"master": 5}, "master.heartbeat_multiplier: is also used for the loss of a node"),
        ({"node": 5}, "heartbeat_multiplier: is also used for the loss of the master"),
        ({"options": 5}, ""),
        ({"options": 5, "node": 5}, ""),
        ({"master": 5, "node": 5}, ""),
    ],
)
def test_a_heartbeat_multiplier_that_ros2_canopen_uses_for_one_side_is_noted(tmp_path, keys, words):
    lines = {part: f"  heartbeat_multiplier: {value}\n" for part, value in keys.items()}
    path = tmp_path / "bus.yml"
    path.write_text(
        f"options:\n  retry_factor: 3\n{lines.get('options', '')}master:\n  node_id: 1\n{lines.get('master', '')}"
        f"defaults:\n  dcf: generic_cia402.eds\n{lines.get('node', '')}nodes: {{a: {{node_id: 3}}}}\n"
    )
    notes = [note for note in read_bus(path).notes if "heartbeat_multiplier" in note]
    assert len(notes) == bool(words), notes
    assert words in "".join(notes)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("{index: 0x6041, sub_index: 0}", "{index: 6041, sub_index: 0}", "; write 0x6041, since 6041 is decimal"),
        ("{index: 0x6083, sub_index: 0", "{index: 6083, sub_index: 0", "; write 0x6083, since 6083 is decimal"),
        ('dcf: "TMCM-1270.eds"', 'dcf: "tmcm-1270.EDS"', "(did you mean 'TMCM-1270.eds'?)"),
        ("defaults:\n", "default:\n", "unknown key 'default' (did you mean 'defaults'?)"),
        ("master:\n", "Master:\n", "unknown key 'Master' (did you mean 'master'?)"),
        ("velocity_mode: 3", "velocity_mode: PV", "got the text 'PV'; a number, such as 3 for PV or 9 for CSV"),
        ("sync_period: 20000", "sync_period: 20ms", "got the text '20ms'; write it in us, such as 20000"),
        ("scale_pos_to_dev: -254.64790894703253", "scale_pos_to_dev: ~", "there is no value, and a default would not"),
    ],
)
def test_a_common_mistake_is_one_error_with_the_way_to_write_it(tmp_path, old, new, words):
    text = data_path("config", "robby/bus.yml").read_text()
    assert old in text
    path = tmp_path / "bus.yml"
    path.write_text(text.replace(old, new, 1))
    _, problems = inspect_bus(path)
    (error,) = problems.errors
    assert words in str(error)
    assert not [str(warning) for warning in problems.warnings]


def test_the_nodes_of_a_repeated_section_are_all_read_so_that_no_joint_lacks_its_node(tmp_path):
    text = data_path("config", "robby/bus.yml").read_text().replace("\n  right_drive:", "\nnodes:\n  right_drive:")
    config, problems = inspect_bus(write(tmp_path, text))
    assert sorted(config.nodes) == ["left_drive", "right_drive"]
    assert len(problems.errors) == 1


@pytest.mark.parametrize("nodes", ["- left: {node_id: 3}", "left"])
def test_nodes_in_a_list_are_refused_at_their_place(tmp_path, nodes):
    text = mistakes(
        tmp_path,
        f"""
        master:
          node_id: 1
        nodes:
          {nodes}
    """,
    )
    assert "bus.yml:5:" in text
    assert "nodes: expected a mapping; write each node as `NAME:`, without a dash" in text
    assert text.count("bus.yml:") == 1


@pytest.mark.parametrize("key", ["Node_ID: 3, dcf", "nodeId: 3, dcf", "node_id: 3, DCF", "node_id: 3, dcf_"])
def test_a_misspelt_key_that_a_node_needs_is_one_error(tmp_path, key):
    text = mistakes(
        tmp_path,
        f"""
        master:
          node_id: 1
        nodes:
          left: {{{key}: generic_cia402.eds}}
    """,
    )
    assert "(did you mean '" in text
    assert text.count("bus.yml:") == 1


def without_objects(text, *indices):
    """Return the text of an EDS without some objects."""
    for index in indices:
        text = re.sub(rf"(?ms)^\[{index:04X}(sub[0-9A-F]+)?\]\n.*?(?=^\[)", "", text, flags=re.IGNORECASE)
        text = re.sub(rf"(?m)^\d+=0x{index:04X}\n", "", text)
    return text


@pytest.mark.parametrize(
    ("removed", "key", "warned"),
    [
        ((0x6007, 0x1029), "", True),
        ((0x6007, 0x1029), "allow_unsupervised: true", False),
        ((0x6007,), "", False),
        ((0x1029,), "", False),
    ],
)
def test_a_drive_whose_reaction_to_a_lost_master_no_object_defines_is_warned_of(tmp_path, removed, key, warned):
    (tmp_path / "own.eds").write_text(without_objects(data_path("eds", "generic_cia402.eds").read_text(), *removed))
    text = f"master: {{node_id: 1}}\nnodes:\n  arm:\n    dcf: own.eds\n    node_id: 3\n    {key}\n"
    bus = read_bus(write(tmp_path, text))
    notes = [note for note in bus.notes if "unknown whether it stops when the master is lost" in str(note)]
    assert bool(notes) is warned
    assert all("neither 0x6007 nor 0x1029:01" in str(note) for note in notes)
