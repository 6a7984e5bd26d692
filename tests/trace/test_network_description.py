import shutil

import pytest
from support.tracing import robby_network

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, EdsError
from canopen_control.master.config import read_bus
from canopen_control.master.pdo_layout import layout_of
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, Entry, ObjectCode, ObjectDictionary, ObjectInfo
from canopen_control.rpc.messages.layout import BusLayout
from canopen_control.rpc.wire import convert, plain
from canopen_control.trace.network_description import (
    NodeDescription,
    entry_name,
    network_of_eds,
    network_of_layout,
    pdo_name,
    pdos_by_default,
)

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
    with pytest.raises(ConfigError, match="no file in it contains a node-ID"):
        network_of_eds("", [str(tmp_path)])
    text = EDS.read_bytes() + b"\r\n[DeviceComissioning]\r\nNodeID=5\r\nBaudrate=1000\r\n"
    (tmp_path / "lift.dcf").write_bytes(text)
    network = network_of_eds("", [str(tmp_path)])
    assert {node_id: node.name for node_id, node in network.nodes.items()} == {5: "lift"}
    assert set(network_of_eds("", [str(tmp_path / "lift.dcf")]).nodes) == {5}


def test_a_node_id_that_is_none_is_refused_and_so_is_a_file_that_is_not_there():
    with pytest.raises(EdsError):
        network_of_eds("can0", ["5=/nowhere.eds"])
    with pytest.raises(ConfigError, match="node-IDs are 1 to 127"):
        network_of_eds("", [f"200={EDS}"])


def test_a_layout_gives_nodes_their_names_and_pdos():
    network = robby_network()
    left = network.nodes[3]
    assert (network.bitrate, network.master_node_id, network.sync_cob_id) == (1_000_000, 1, 0x80)
    assert [pdo_name(pdo) for pdo in left.pdos] == ["RPDO1", "RPDO2", "TPDO1", "TPDO2"]
    tpdo2 = left.pdos[3]
    assert (tpdo2.cob_id, tpdo2.transmission_type) == (0x283, 1)
    assert [(item.index, item.bits, item.name) for item in tpdo2.objects] == [
        (0x6064, 32, "Position actual value"),
        (0x606C, 32, "Velocity actual value"),
    ]
    assert (network.name_of(1), network.name_of(3), network.name_of(9)) == ("master", "left_drive", "")
    assert left.is_drive
    assert str(left) == "node 3 (left_drive)"


def test_an_eds_that_is_gone_costs_names_and_is_noted():
    layout = plain(layout_of(read_bus(data_path("config", "robby") / "bus.yml")))
    layout["nodes"][0]["eds"] = "/nowhere/at-all.eds"
    network = network_of_layout(convert(layout, BusLayout))
    assert network.nodes[3].od is None
    assert network.nodes[2].od is not None
    assert len(network.nodes[3].pdos) == 4
    assert len(network.notes) == 1
    assert "node 3 has no names" in network.notes[0]
    assert "at-all.eds" in network.notes[0]


def test_an_eds_alone_gives_the_pdos_that_are_live_by_default():
    pdos = pdos_by_default(read_eds(EDS, 5).od)
    assert {pdo_name(pdo): pdo.cob_id for pdo in pdos} == {
        "RPDO1": 0x205,
        "RPDO2": 0x305,
        "RPDO3": 0x405,
        "TPDO1": 0x185,
        "TPDO2": 0x285,
        "TPDO3": 0x385,
    }


def entries(*items):
    od = ObjectDictionary()
    for index, subindex, name, data_type, default in items:
        od.add(Entry(index, subindex, name, data_type, default=default))
    return od


def test_an_emcy_may_lie_elsewhere_and_a_device_may_be_no_drive():
    od = entries(
        (0x1000, 0, "type", DataType.UNSIGNED32, 0x191),
        (0x1014, 0, "emcy", DataType.UNSIGNED32, 0x1FF),
        (0x6040, 0, "something of an I/O module", DataType.UNSIGNED16, None),
    )
    node = NodeDescription("io", 7, od)
    assert not node.is_drive
    assert node.emcy_cob_id == 0x1FF
    assert NodeDescription("", 7).emcy_cob_id == 0x87


def test_an_object_the_eds_lacks_is_still_read_by_its_width():
    od = entries(
        (0x1800, 1, "cob", DataType.UNSIGNED32, 0x185),
        (0x1A00, 0, "count", DataType.UNSIGNED8, 1),
        (0x1A00, 1, "map", DataType.UNSIGNED32, 0x20050018),
    )
    (pdo,) = pdos_by_default(od)
    assert (pdo.objects[0].data_type, pdo.objects[0].name, pdo.transmission_type) == ("UNSIGNED24", "0x2005:00", 255)


def test_a_part_is_named_with_its_object():
    od = entries((0x1018, 1, "Vendor Id", DataType.UNSIGNED32, 1))
    od.objects[0x1018] = ObjectInfo(0x1018, "Identity", ObjectCode.RECORD)
    assert entry_name(od, 0x1018, 1) == "Identity: Vendor Id"
    assert entry_name(od, 0x1018, 9) == "Identity"
    od.objects[0x1018] = ObjectInfo(0x1018, "Vendor", ObjectCode.RECORD)
    assert entry_name(od, 0x1018, 1) == "Vendor Id"
    assert entry_name(od, 0x2000, 0) == entry_name(None, 0x1018, 1) == ""
