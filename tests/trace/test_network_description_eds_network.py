import shutil

import pytest

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, EdsError
from canopen_control.trace.network_description import network_of_eds

EDS = data_path("eds", "TMCM-1270.eds")


def test_one_file_describes_every_node_and_a_named_one_wins():
    network = network_of_eds("can0", [str(EDS), f"7={EDS}"])
    assert len(network.nodes) == 127
    assert (network.nodes[3].name, network.nodes[7].name) == ("", "TMCM-1270")
    assert network.nodes[3].pdos[0].cob_id == 0x203
    assert network.nodes[7].pdos[0].cob_id == 0x207
    assert network.channel == "can0"


def test_a_folder_is_taken_by_the_node_ids_of_its_dcf_files(tmp_path):
    shutil.copy(EDS, tmp_path / "plain.eds")
    with pytest.raises(ConfigError, match="no file there says its node id"):
        network_of_eds("", [str(tmp_path)])
    text = EDS.read_bytes() + b"\r\n[DeviceComissioning]\r\nNodeID=5\r\nBaudrate=1000\r\n"
    (tmp_path / "lift.dcf").write_bytes(text)
    network = network_of_eds("", [str(tmp_path)])
    assert {node_id: node.name for node_id, node in network.nodes.items()} == {5: "lift"}
    assert set(network_of_eds("", [str(tmp_path / "lift.dcf")]).nodes) == {5}


def test_a_node_id_that_is_none_is_refused_and_so_is_a_file_that_is_not_there():
    with pytest.raises(EdsError):
        network_of_eds("can0", ["5=/nowhere.eds"])
    with pytest.raises(ConfigError, match="node ids are 1 to 127"):
        network_of_eds("", [f"200={EDS}"])
