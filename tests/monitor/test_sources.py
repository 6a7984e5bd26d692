import time

import pytest
from support.host import eventually
from support.localbus import end_hubs
from support.mockrobot import running
from support.samples import event_of

from canopen_control.bus.channel import open_port
from canopen_control.errors import RemoteError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.monitor.sources import BusSource, RobotSource
from canopen_control.rpc.messages.layout import BusLayout, NodeLayout
from canopen_control.rpc.messages.robot import Stop
from canopen_control.trace.network_description import NetworkDescription, NodeDescription


@pytest.fixture
def robot_source(private_folders):
    source = RobotSource()
    source.start()
    yield source
    source.close()


def test_a_running_robot_is_shown_and_commanded(robot_source):
    assert robot_source.can_command
    assert robot_source.content().alarm.endswith("STOP does not reach it; trying again")
    with running(real_time=True):
        assert eventually(lambda: robot_source.content().title == "mock" and robot_source.content().joints)
        robot_source.tick()
        assert robot_source.taps == []  # mock hardware has no bus
        robot_source.command(Stop(latch=True, source="monitor"))
        assert eventually(lambda: robot_source.content().alarm.startswith("STOP is latched by monitor"))
        assert eventually(lambda: any("latched" in line.text for line in robot_source.log()))
        assert robot_source.emergencies() == []


def test_emergencies_are_in_both_logs(robot_source, monkeypatch):
    event = event_of({"time": 1.0, "kind": "emcy", "level": "warning", "text": "node 3: EMCY 0x3210", "node": "a"})
    monkeypatch.setattr(robot_source._link, "events", lambda: [event])
    assert [line.text for line in robot_source.log()] == ["node 3: EMCY 0x3210"]
    assert [line.text for line in robot_source.emergencies()] == ["node 3: EMCY 0x3210"]
    assert robot_source.emergencies() == []


@pytest.mark.process
def test_the_buses_of_a_robot_are_listened_to_by_its_own_names(robot_source):
    layout = BusLayout("local:seen", 500_000, 1, nodes=(NodeLayout("left", 3, None),))
    robot_source._link.layouts = {"can": layout}
    others = open_port("local:seen", label="master")
    robot_source.tick()
    assert robot_source.taps == []  # nobody looks at frames
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
        end = time.monotonic() + 5
        while not source.content().drives or not source.frames.rows.get(0x083):
            assert time.monotonic() < end
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
