"""The swap from virtual to real: two CAN controllers on one bus, the master on can0, the drives on can1."""

import itertools
import json
import statistics
from pathlib import Path

import pytest
from support.guest import LEFT, RIGHT, SYNC, ip, plant_speed, scaled
from support.host import eventually
from support.processes import seconds_until

from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import GetStatus

pytestmark = [pytest.mark.hardware, pytest.mark.timeout(600)]
NODES = (LEFT, RIGHT)
DRIVER = Path("/sys/bus/pci/drivers/kvaser_pci")
TIMEOUT_S = scaled(20)


@pytest.fixture(autouse=True)
def fresh_cards():
    """Let every test find the cards as they come: down; one that a test has pulled is put back."""
    for name in ("can0", "can1"):
        ip("link", "set", name, "down")
    cards = {path.name for path in DRIVER.glob("0000:*")}
    yield
    for card in cards - {path.name for path in DRIVER.glob("0000:*")}:
        (DRIVER / "bind").write_text(card)


def up(stage, *names):
    for name in names:
        program = stage.call("bus", "up", name, "--bitrate", 1_000_000, seconds=60)
        assert program.wait() == 0, program


def link(name):
    (link,) = json.loads(ip("-json", "-details", "link", "show", name))
    return link["linkinfo"]["info_data"]


class Robot:
    """Drives on can1, the robot on can0, somebody who commands 10 rad/s, and its status."""

    def __init__(self, stage, robby, name, *options):
        self.program = stage.start("run", robby, "--as", name, "--can", "can0", "--real", *options)
        self.program.until(f"{name} runs", TIMEOUT_S)
        self.name, self._stage = name, stage
        self.command()

    def command(self):
        self.commander = self._stage.start("command", "robby_forward_controller", 10, 10, "--name", self.name)

    def status(self):
        with RobotClient.connect(self.name) as client:
            return client.ask(GetStatus())

    def collected(self, text):
        return any(text in event.text for event in self.status().events)

    def ready(self):
        return [node.ready for node in self.status().nodes.values()]

    def enable_again(self):
        for action in ("fault-reset", "enable"):
            assert self._stage.call("axis", action, "all", "--name", self.name, seconds=60).wait() == 0
        self.command()  # what was commanded before is forgotten

    def end(self):
        assert self.program.end(seconds=60) == 0, self.program


@pytest.fixture
def drives(stage):
    """Bring both cards up, by `ip` since a Python is slow to start here, and start the drives on can1."""
    for name in ("can0", "can1"):
        ip("link", "set", name, "type", "can", "bitrate", "1000000")
        ip("link", "set", name, "up")
    for node_id in NODES:
        drive = stage.start("drive", "--node-id", node_id, "--eds", "TMCM-1270.eds", "--can", "can1")
        drive.until("ready on can1", 60)


def test_up_sets_the_bit_rate_and_reports_what_a_card_cannot_do(stage):
    bare = stage.call("bus", "up", "can1", "--bitrate", 3_000_000, seconds=60)
    assert bare.wait() == 2
    assert "the controller does not support this bit rate" in bare.err
    first = stage.call("bus", "up", "can0", "--bitrate", 500_000, seconds=60)
    assert first.wait() == 0, first
    assert (link("can0")["bittiming"]["bitrate"], link("can0")["state"]) == (500_000, "ERROR-ACTIVE")
    other = stage.call("bus", "up", "can0", "--bitrate", 1_000_000, "--restart-ms", 100, seconds=60)
    assert [line.split("   #")[0] for line in other.out.splitlines()] == [
        "ip link set can0 down",
        "ip link set can0 type can bitrate 1000000 restart-ms 100",
        "ip link set can0 up",
    ]
    assert (link("can0")["bittiming"]["bitrate"], link("can0")["restart_ms"]) == (1_000_000, 100)
    again = stage.call("bus", "up", "can0", "--bitrate", 1_000_000, "--restart-ms", 100, seconds=60)
    assert again.out == "can0 is up already\n"
    status = stage.call("bus", "status", "can0", seconds=60)
    assert status.out.splitlines()[0] == (
        "can0: can, up, ERROR-ACTIVE, 1000000 bit/s, transmit errors 0, receive errors 0, 0 frames/s, load 0 %"
    )


def test_the_wheels_turn_on_real_cards_at_one_megabit(stage, robby, drives, listen):
    hears = listen("can1", 0x280 + LEFT, 0x280 + RIGHT)
    robby = Robot(stage, robby, "swap", "--full-speed")
    assert eventually(lambda: hears.is_at(10.0), TIMEOUT_S)
    assert robby.status().state == "running"
    taken = stage.call("drive", "--node-id", LEFT, "--eds", "TMCM-1270.eds", "--can", "can0", seconds=60)
    assert taken.wait() == 1
    assert f"node-ID {LEFT} already answers on can0" in taken.err
    assert stage.call("stop", "--name", "swap", seconds=60).wait() == 0
    assert eventually(lambda: hears.is_at(0.0), TIMEOUT_S)
    robby.end()
    assert link("can0")["bittiming"]["bitrate"] == link("can1")["bittiming"]["bitrate"] == 1_000_000


@pytest.mark.parametrize(("card", "mine"), [("can0", True), ("can1", False)])
def test_an_unplugged_card_is_named_stops_the_robot_and_is_found_again(stage, robby, drives, listen, card, mine):
    hears = listen("can1", 0x280 + LEFT, 0x280 + RIGHT)
    robby = Robot(stage, robby, f"pulled-{card}", "--full-speed")
    assert eventually(lambda: hears.is_at(10.0), TIMEOUT_S)
    device = Path(f"/sys/class/net/{card}/device").resolve().name
    (DRIVER / "unbind").write_text(device)
    if mine:
        assert (
            seconds_until(
                lambda: robby.collected("bus can0: the interface was removed; check that the adapter is plugged in"), 10
            )
            < 1.0
        )
    assert eventually(lambda: not any(robby.ready()), scaled(2))
    for name in ("left_drive", "right_drive"):
        assert eventually(lambda name=name: robby.collected(f"({name}): lost: "), scaled(2)), robby.program.out
    assert robby.status().state == "fault"
    motors = [lambda node_id=node_id: plant_speed("can1", node_id) for node_id in NODES]
    assert eventually(lambda: all(abs(speed()) < 1 for speed in motors), scaled(2)), "by the drives' own reaction"
    (DRIVER / "bind").write_text(device)
    up(stage, card)
    assert eventually(lambda: all(robby.ready()), TIMEOUT_S), robby.status()
    hears = listen("can1", 0x280 + LEFT, 0x280 + RIGHT)
    assert hears.is_at(0.0)
    robby.enable_again()
    assert eventually(lambda: hears.is_at(10.0), TIMEOUT_S)
    assert robby.commander.running
    robby.end()


def test_the_kernels_sync_goes_over_the_wire_returns_and_leads_the_cycle(stage, robby, drives, listen):
    hears = listen("can1", SYNC, 0x280 + LEFT, 0x280 + RIGHT)
    robby = Robot(stage, robby, "led", "--full-speed", "--kernel-sync")
    assert eventually(lambda: hears.is_at(10.0), TIMEOUT_S)
    since = len(hears.of(SYNC))
    assert eventually(lambda: len(hears.of(SYNC)) > since + 20, TIMEOUT_S)
    times = [when for when, _ in hears.of(SYNC)][since:]
    gaps = [after - before for before, after in itertools.pairwise(times)]
    assert statistics.median(gaps) == pytest.approx(scaled(0.02), rel=0.02)
    assert not robby.collected("no SYNC is received from the kernel")
    assert robby.status().state == "running"
    robby.end()
    count = len(hears.of(SYNC))
    assert not eventually(lambda: len(hears.of(SYNC)) > count + 1, scaled(0.1)), "it ends with the run"
