import json

from canopen_control.data_files import data_path
from canopen_control.master.config import read_bus
from canopen_control.master.pdo_layout import layout_of
from canopen_control.rpc.wire import plain

ROBBY = data_path("config", "robby") / "bus.yml"


def test_the_layout_is_what_a_boot_makes_of_the_bus():
    layout = plain(layout_of(read_bus(ROBBY), "local:robby"))
    assert json.loads(json.dumps(layout)) == layout
    assert (layout["channel"], layout["bitrate"], layout["sync_period_us"]) == ("local:robby", 1_000_000, 20_000)
    left = next(node for node in layout["nodes"] if node["name"] == "left_drive")
    assert left["eds"].endswith("TMCM-1270.eds")
    assert [(pdo["direction"], pdo["number"], pdo["cob_id"]) for pdo in left["pdos"]] == [
        ("rpdo", 1, 0x203),
        ("rpdo", 2, 0x303),
        ("tpdo", 1, 0x183),
        ("tpdo", 2, 0x283),
    ]
    assert left["pdos"][2]["objects"][0] == {
        "index": 0x6041,
        "subindex": 0,
        "bits": 16,
        "data_type": "UNSIGNED16",
        "name": "Statusword",
    }


def test_without_a_channel_it_is_that_of_the_bus_yml():
    assert layout_of(read_bus(ROBBY)).channel == ""
