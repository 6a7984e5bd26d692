import shutil
import textwrap

import pytest

from canopen_control.data_files import data_path
from canopen_control.errors import BusConfigError
from canopen_control.master.config import read_bus

ROBBY = data_path("config", "robby") / "bus.yml"


def write(folder, text):
    shutil.copy(data_path("eds", "TMCM-1270.eds"), folder)
    path = folder / "bus.yml"
    path.write_text(textwrap.dedent(text))
    return path


def mistakes(folder, text):
    with pytest.raises(BusConfigError) as caught:
        read_bus(write(folder, text))
    return str(caught.value)


NESTED = """\
    master:
      node_id: 1
      sync_period: 20000
    defaults:
      dcf: TMCM-1270.eds
      heartbeat_producer: 100
      tpdo:
        1: {enabled: true, transmission: 1}
    nodes:
      left_drive:
        node_id: 3
        heartbeat_producer: 50
      right_drive: {node_id: 2}
    """


def test_robby_has_its_two_drives_with_opposite_signs():
    bus = read_bus(ROBBY)
    left, right = bus.nodes["left_drive"], bus.nodes["right_drive"]
    assert (left.node_id, right.node_id, bus.master.sync_period) == (3, 2, 20000)
    assert left.scale_vel_to_dev == -right.scale_vel_to_dev
    assert left.heartbeat_timeout_ns == 500_000_000
    assert bus.eds_paths["left_drive"].name == "TMCM-1270.eds"


def test_a_nodes_own_keys_win_over_the_defaults_at_every_depth(tmp_path):
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, tpdo: {1: {event_timer: 7}}}")
    bus = read_bus(write(tmp_path, text))
    assert bus.nodes["left_drive"].heartbeat_producer == 50
    assert bus.nodes["right_drive"].heartbeat_producer == 100
    tpdo = bus.nodes["right_drive"].tpdo[1]
    assert (tpdo.transmission, tpdo.event_timer) == (1, 7)


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


def test_all_mistakes_are_told_at_once_with_line_and_nearest_key(tmp_path):
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
    said = mistakes(tmp_path, text)
    for line, words in ((1, "sync_period"), (5, "200"), (9, "heartbeat_producer"), (11, "missing.eds")):
        assert f"bus.yml:{line}:" in said, said
        assert words in said
    assert "4 errors" in said


def test_two_nodes_with_one_node_id_name_each_other_and_the_line(tmp_path):
    said = mistakes(tmp_path, NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 3}"))
    assert "node id 3 is already that of left_drive" in said
    assert "bus.yml:13:" in said


def test_a_node_may_not_have_the_masters_id(tmp_path):
    assert "already that of the master" in mistakes(tmp_path, NESTED.replace("node_id: 3", "node_id: 1"))


def test_objects_that_the_eds_lacks_are_errors_of_the_file(tmp_path):
    text = NESTED.replace("right_drive: {node_id: 2}", "right_drive: {node_id: 2, sdo: [{index: 0x5999, value: 1}]}")
    said = mistakes(tmp_path, text)
    assert "0x5999:00 is not in TMCM-1270.eds" in said
    assert "bus.yml:13:" in said


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
    assert read_bus(write(tmp_path, accepted)).nodes["left_drive"].allow_unsupervised


def test_a_missing_file_and_text_that_is_no_yaml_are_one_sentence_each(tmp_path):
    with pytest.raises(BusConfigError, match="no-such"):
        read_bus(tmp_path / "no-such.yml")
    broken = tmp_path / "broken.yml"
    broken.write_text("master: [1, 2\nnodes: }")
    with pytest.raises(BusConfigError, match=r"broken.yml:2:"):
        read_bus(broken)
