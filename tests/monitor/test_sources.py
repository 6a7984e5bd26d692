import select
import threading
from dataclasses import replace

import pytest
from support.host import TIMEOUT_S, eventually
from support.localbus import end_hubs
from support.mockrobot import running
from support.robots import LEFT, Bench
from support.samples import event_of

from canopen_control.bus.channel import open_port
from canopen_control.client import RobotClient
from canopen_control.data_files import data_path
from canopen_control.errors import RemoteError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.monitor import sources as module
from canopen_control.monitor.monitor_content import Tone
from canopen_control.monitor.sources import (
    BusSource,
    BusTable,
    LiveRobot,
    RobotLink,
    _Axis,
    content_of,
    log_line,
    without_robot,
)
from canopen_control.rpc.messages.layout import BusLayout, NodeLayout
from canopen_control.rpc.messages.robot import LoadController, Stop
from canopen_control.runtime.node_readings import event_message
from canopen_control.runtime.status import state_sample
from canopen_control.trace.decoder import Decoder
from canopen_control.trace.network_description import NetworkDescription, NodeDescription, network_of_eds


@pytest.fixture
def bench():
    bench = Bench("monitor-rows")
    bench.start()
    yield bench
    bench.close()


def content(bench):
    return content_of("robby", state_sample(bench.robot))


def words(row):
    return [str(cell) for cell in row]


def test_a_running_robot_in_words(bench):
    bench.run(300)
    bench.hold(5.0, 5.0, ms=1000)
    shown = content(bench)
    assert (shown.title, str(shown.state), shown.alarm) == ("robby", "● running", "")
    drive = words(shown.drives["left_drive"])
    assert drive[:4] == ["left_drive (3)", "● OPERATIONAL", "● OPERATION ENABLED", ""]
    assert drive[4].endswith(" ms")
    assert drive[5] == "PV"
    assert drive[6].split()[1] == "37w"
    assert drive[7].startswith("0x")
    assert "OPERATION" not in drive[7]
    assert words(shown.joints["left_wheel_joint"])[:3] == ["left_wheel_joint", "5.000", "4.999"]
    assert any("cycle 20 ms, 0 missed" in fact for fact in shown.facts)
    assert any(fact.startswith("bus can ") for fact in shown.facts)
    assert "active: joint_state_broadcaster, robby_forward_controller" in shown.facts


def test_a_drive_that_is_gone_is_dead_in_words(bench):
    bench.power_off(LEFT)
    bench.run(1500)
    row = content(bench).drives["left_drive"]
    assert row[1].tone is Tone.BAD
    assert row[4].tone is Tone.BAD
    assert "dead" in row[4].text
    assert row[3].tone is Tone.BAD
    assert row[3].text.startswith("no heartbeat for "), "the row names the node, and 80 columns are few"


def test_a_latched_stop_is_an_alarm_with_the_remedy(bench):
    bench.robot.stop(lambda _: None, "somebody")
    bench.run(100)
    assert content(bench).alarm.startswith("STOP is latched by somebody: nothing moves before it is released")


def test_drives_that_are_off_are_a_warning_with_what_to_call(bench):
    bench.robot.stop(lambda _: None)
    bench.run(1000)
    shown = content(bench)
    assert (shown.state.text, shown.state.tone) == ("disabled", Tone.WARN)
    assert shown.alarm == "left_drive, right_drive are not enabled and will not move: canopen-control axis enable all"


def test_events_are_lines_with_their_level(bench):
    lines = [log_line(event_message(event, bench.robot.wall_offset_ns)) for event in bench.events]
    assert "robby runs: joint_state_broadcaster, robby_forward_controller" in [line.text for line in lines]
    assert all(line.time > 0 for line in lines)
    assert log_line(event_of({"time": 1.0, "kind": "x", "level": "error", "text": "t"})).tone is Tone.BAD


def test_without_a_robot_it_reports_that_stop_does_not_reach_it():
    shown = without_robot("robby", "no robot 'robby' is running")
    assert shown.state.tone is Tone.BAD
    assert shown.alarm == "no robot 'robby' is running. STOP cannot reach the robot; reconnecting"


@pytest.fixture
def link(private_folders, monkeypatch):
    monkeypatch.setattr(module, "AGAIN_S", 0.05)
    link = RobotLink()
    link.start()
    yield link
    link.close()


@pytest.mark.rest
def test_it_finds_the_robot_loses_it_and_finds_it_again(link):
    assert eventually(lambda: link.why.startswith("no robot is running"))
    assert link.state is None
    for _ in range(2):
        with running(real_time=True):
            assert eventually(lambda: link.connected and link.state.state == "running")  # at first perhaps "starting"
            assert link.name == "mock"
            assert link.why == ""
        assert eventually(lambda: link.state is None)
        assert "mock" in link.why


def test_a_link_that_is_closed_while_it_connects_leaves_no_connection(private_folders, monkeypatch):
    requested, connections = threading.Event(), []

    class Silent(RobotClient):
        def ask(self, request, timeout=None):
            connections.append(self)
            requested.set()
            next(self.messages(60), None)  # until it is closed

    monkeypatch.setattr(module, "RobotClient", Silent)
    with running(real_time=True):
        link = RobotLink()
        link.start()
        assert requested.wait(60)
        link.close()
        assert not link._thread.is_alive()
    assert [connection.fileno() for connection in connections] == [-1]


def test_each_event_is_reported_once_also_those_from_before(link):
    with running(real_time=True):
        assert eventually(lambda: link.connected)
        texts = [event.text for event in link.events()]
        assert sum("mock runs" in text for text in texts) == 1
        assert not [event for event in link.events() if "mock runs" in event.text]
        link.ask(Stop(latch=True, source="test"), 10.0)
        results = []
        assert eventually(lambda: results.extend(link.events()) or any(item.kind == "stop_latched" for item in results))
        assert sum(item.kind == "stop_latched" for item in results) == 1


def test_a_connection_that_broke_is_made_again_and_what_was_reported_is_not_reported_again(link):
    with running(real_time=True):
        assert eventually(lambda: link.connected)
        first = link._robot
        reported = link.events()
        assert reported
        first.close()
        assert eventually(lambda: link.connected and link._robot is not first)
        assert not [event for event in link.events() if event in reported]


def test_commands_reach_the_robot_or_report_why_not(link):
    assert eventually(lambda: link.why.startswith("no robot is running"))
    with pytest.raises(RemoteError, match="stop cannot reach the robot: no robot is running"):
        link.ask(Stop(), 1.0)
    with running(real_time=True):
        assert eventually(lambda: link.connected)
        with pytest.raises(RemoteError, match="nobody"):
            link.ask(LoadController(controller="nobody"), 1.0)


def test_a_robot_that_hangs_is_not_shown_as_connected(link, monkeypatch):
    with running(real_time=True):
        assert eventually(lambda: link.connected)
        link._last_message -= 1.1  # as if the last sample had come so long ago
        assert not link.connected


MS = 1_000_000
START = 1_700_000_000_000 * MS


class Bus:
    """A table behind its decoder; times in ms."""

    def __init__(self):
        (node,) = network_of_eds("local:x", [f"3={data_path('eds', 'TMCM-1270.eds')}"]).nodes.values()
        node = replace(node, name="left")
        network = NetworkDescription("local:x", nodes={3: node})
        self.decoder, self.table = Decoder(network), BusTable(network)
        self.statusword = next(pdo for pdo in node.pdos if any(item.index == 0x6041 for item in pdo.objects))

    def hear(self, can_id, data, at=0):
        self.table.feed(self.decoder.decode(CanFrame(can_id, bytes(data)), START + at * MS))

    def tpdo(self, statusword, at=0):
        length = sum(item.bits for item in self.statusword.objects) // 8
        assert self.statusword.objects[0].index == 0x6041
        self.hear(self.statusword.cob_id, statusword.to_bytes(2, "little").ljust(length, b"\0"), at)

    def rows(self, at=0):
        content = self.table.content(START + at * MS, "local:x", ())
        return {key: [str(cell) for cell in row] for key, row in content.drives.items()}


@pytest.fixture
def bus():
    return Bus()


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


def test_a_boot_up_clears_the_previous_state_of_the_node(bus):
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


def test_stale_and_dead_follow_the_nodes_own_pace(bus):
    for at in range(0, 2001, 1000):
        bus.hear(0x703, [5], at)
    assert bus.rows(3900)["3"][4] == "1.9 s"
    assert bus.rows(4000)["3"][4] == "▲ 2.0 s, stale"
    assert bus.rows(7000)["3"][4] == "✖ 5.0 s, dead"


def test_a_node_that_returns_is_not_given_the_patience_of_its_absence(bus):
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


@pytest.mark.parametrize(("mode", "target"), [(1, "7"), (2, "90"), (3, "500"), (7, "8"), (6, "-"), (None, "-")])
def test_joints_show_the_target_of_the_mode(bus, mode, target):
    axis = bus.table._update_node(3, START).axes[0] = _Axis()
    axis.mode, axis.values = mode, {0x60FF: 500, 0x607A: 7, 0x6042: 90, 0x60C1: 8, 0x606C: 499}
    row = bus.table.content(START, "", ()).joints["3/0"]
    assert [cell.text for cell in row] == ["left (device units)", target, "499", "-", "-"]


@pytest.fixture
def robot_source(private_folders):
    source = LiveRobot()
    source.start()
    yield source
    source.close()


def test_a_running_robot_is_shown_and_commanded(robot_source):
    assert robot_source.can_command
    assert robot_source.content().alarm.endswith("STOP cannot reach the robot; reconnecting")
    with running(real_time=True):
        assert eventually(lambda: robot_source.content().title == "mock" and robot_source.content().joints)
        robot_source.tick()
        assert robot_source.taps == []  # mock hardware has no bus
        robot_source.command(Stop(latch=True, source="monitor"))
        assert eventually(lambda: robot_source.content().alarm.startswith("STOP is latched by monitor"))
        assert eventually(lambda: any("latched" in line.text for line in robot_source.log()))
        assert robot_source.emergencies() == []


@pytest.mark.process
def test_the_buses_of_a_robot_are_listened_to_by_its_own_names(robot_source):
    layout = BusLayout("local:seen", 500_000, 1, nodes=(NodeLayout("left", 3, None),))
    robot_source._link.layouts = {"can": layout}
    others = open_port("local:seen", label="master")
    robot_source.tick()
    assert robot_source.taps == []  # no frames are displayed
    robot_source.listen(True)
    robot_source.tick()
    try:
        (tap,) = robot_source.taps
        assert tap.problem == ""
        assert robot_source.network.name_of(3) == "left"
        robot_source.listen(False)
        assert robot_source.taps == []
        assert robot_source.network.name_of(3) == "left"
    finally:
        others.close()
        robot_source.close()
        end_hubs()


@pytest.mark.process
def test_a_bare_bus_is_listened_to_and_never_spoken_to(private_folders):
    network = NetworkDescription("local:bare", nodes={3: NodeDescription("left", 3)})
    source = BusSource(network)
    others = open_port("local:bare", label="others")
    try:
        source.start()
        source.tick()
        others.send(pack_records([CanFrame(0x703, b"\x05"), CanFrame(0x083, bytes([0x10, 0x32, 4, 0, 0, 0, 0, 0]))]))
        while not source.content().drives or not source.frames.rows.get(0x083):
            assert select.select([source.taps[0]._port.fileno()], [], [], TIMEOUT_S)[0]
            source.taps[0].receive()
        content = source.content()
        assert content.title == "local:bare (listening only)"
        assert content.drives["3"][0].text == "left (3)"
        assert content.facts == ("1000 kbit/s", "bus load -")
        assert len(source.emergencies()) == len(source.log()) == 1
        assert not source.can_command
        with pytest.raises(RemoteError, match="only listens on local:bare"):
            source.command(Stop())
        assert others.receive() == b""
    finally:
        source.close()
        others.close()
        end_hubs()
