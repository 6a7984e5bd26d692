from dataclasses import replace

import pytest

from canopen_control.cia301.pdo import MappedObject
from canopen_control.data_files import data_path
from canopen_control.frame import CanFrame
from canopen_control.monitor.monitor_content import Tone
from canopen_control.monitor.sources import BusTable, _Axis
from canopen_control.trace.decoder import Decoder
from canopen_control.trace.network_description import NetworkDescription, network_of_eds

MS = 1_000_000
START = 1_700_000_000_000 * MS


class Bus:
    """A table behind its decoder; times in ms."""

    def __init__(self):
        (node,) = network_of_eds("local:x", [f"3={data_path('eds', 'TMCM-1270.eds')}"]).nodes.values()
        node = replace(node, name="left")
        network = NetworkDescription("local:x", nodes={3: node})
        self.decoder, self.table = Decoder(network), BusTable(network)
        self.statusword = next(pdo for pdo in node.pdos if any(each.index == 0x6041 for each in pdo.objects))

    def hear(self, can_id, data, at=0):
        self.table.feed(self.decoder.decode(CanFrame(can_id, bytes(data)), START + at * MS))

    def tpdo(self, statusword, at=0):
        length = sum(each.bits for each in self.statusword.objects) // 8
        assert isinstance(self.statusword.objects[0].mapped, MappedObject)
        assert self.statusword.objects[0].index == 0x6041
        self.hear(self.statusword.cob_id, statusword.to_bytes(2, "little").ljust(length, b"\0"), at)

    def rows(self, at=0):
        content = self.table.content(START + at * MS, "local:x", ())
        return {key: [str(cell) for cell in row] for key, row in content.drives.items()}


@pytest.fixture
def bus():
    return Bus()


def test_a_silent_bus_says_so(bus):
    content = bus.table.content(START, "local:x (listening only)", ("1000 kbit/s",))
    assert str(content.state) == "▲ listening, nobody is heard"
    assert content.facts == ("1000 kbit/s",)
    assert not content.drives


def test_heartbeats_make_rows_with_and_without_a_name(bus):
    bus.hear(0x703, [5])
    bus.hear(0x710, [0x7F])
    rows = bus.rows(10)
    assert rows["3"][:2] == ["left (3)", "● OPERATIONAL"]
    assert rows["16"][:2] == ["node 16", "○ PRE OPERATIONAL"]
    assert rows["3"][4] == "10 ms"


def test_a_tpdo_shows_the_state_and_the_flags(bus):
    bus.tpdo(0x0637)
    row = bus.rows()["3"]
    assert row[2] == "● OPERATION ENABLED"
    assert row[7].startswith("0x0637")
    bus.tpdo(0x0218)
    assert bus.rows()["3"][2] == "✖ FAULT"


def test_an_emergency_is_the_error_until_it_is_reset_and_a_line_of_its_own(bus):
    bus.hear(0x083, [0x10, 0x32, 0x04, 0, 0, 0, 0, 0])
    assert bus.rows()["3"][3].startswith("✖ 0x3210 ")
    (line,) = bus.table.emergencies()
    assert line.tone is Tone.BAD
    assert line.text.startswith("node 3 (left): EMCY: 0x3210")
    assert bus.table.emergencies() == []
    bus.hear(0x083, [0, 0, 0, 0, 0, 0, 0, 0])
    assert bus.rows()["3"][3] == ""
    assert len(bus.table.log()) == 2


def test_a_boot_up_forgets_what_the_node_was(bus):
    bus.tpdo(0x0637)
    bus.hear(0x083, [0x10, 0x32, 0x04, 0, 0, 0, 0, 0])
    bus.hear(0x703, [0])
    row = bus.rows()["3"]
    assert row[1:3] == ["○ PRE OPERATIONAL", "-"]
    assert row[3] == ""


def test_sdo_traffic_is_counted_by_the_requests(bus):
    bus.hear(0x703, [5])
    bus.hear(0x603, [0x40, 0x41, 0x60, 0, 0, 0, 0, 0])
    bus.hear(0x583, [0x4B, 0x41, 0x60, 0, 0x37, 0x06, 0, 0])
    bus.hear(0x603, [0x2B, 0x40, 0x60, 0, 0x0F, 0, 0, 0])
    bus.hear(0x583, [0x80, 0x40, 0x60, 0, 0, 0, 0x02, 0x06])
    assert bus.rows()["3"][6] == "▲ 1r 1w, 1 failed"


def test_who_is_only_spoken_to_has_no_row(bus):
    bus.hear(0x605, [0x40, 0x00, 0x10, 0, 0, 0, 0, 0])
    bus.hear(0x203, [0x0F, 0x00])
    assert bus.rows() == {}


def test_stale_and_dead_follow_the_nodes_own_pace(bus):
    for at in range(0, 2001, 1000):
        bus.hear(0x703, [5], at)
    assert bus.rows(3900)["3"][4] == "1.9 s"
    assert bus.rows(4000)["3"][4] == "▲ 2.0 s, stale"
    assert bus.rows(7000)["3"][4] == "✖ 5.0 s, dead"


def test_a_node_that_comes_back_is_not_given_the_patience_of_its_absence(bus):
    for at in (0, 1000, 60_000, 61_000):
        bus.hear(0x703, [5], at)
    assert bus.rows(66_000)["3"][4] == "✖ 5.0 s, dead"


def test_what_matters_is_logged_and_cyclic_traffic_is_not(bus):
    bus.hear(0x000, [1, 0])
    for at in range(5):
        bus.hear(0x703, [5], at)
        bus.tpdo(0x0637, at)
    lines = bus.table.log()
    assert len(lines) == 1
    assert "NMT" in lines[0].text
    assert lines[0].time == START / 1e9


def test_joints_show_the_target_of_the_mode(bus):
    axis = bus.table._heard(3, START).axes[0] = _Axis()
    axis.mode, axis.values = 3, {0x60FF: 500, 0x607A: 7, 0x606C: 499}
    row = bus.table.content(START, "", ()).joints["3/0"]
    assert [cell.text for cell in row] == ["left (device units)", "500", "499", "-", "-"]
