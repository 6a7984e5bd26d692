"""python-can on a local bus, through its own door, and the `canopen` package behind it."""

from __future__ import annotations

import asyncio
import select
import subprocess
import sys
import textwrap
import threading
import time
import tomllib
from pathlib import Path

import can
import pytest
from support.host import waits
from support.localbus import TIMEOUT_S, kill_hub, receive

from canopen_control.bus.local import open_local
from canopen_control.bus.plugin import LocalBus
from canopen_control.bus.port_abilities import STAMP_STEP_NS, Arrivals
from canopen_control.frame import EXTENDED_FLAG, REMOTE_FLAG, CanFrame, pack_records

pytestmark = pytest.mark.process

ROOT = Path(__file__).parents[2]


@pytest.fixture
def port(runtime):
    port = open_local("plug", "robot")
    yield port
    port.close()


@pytest.fixture
def bus(port):
    bus = LocalBus("plug")
    yield bus
    bus.shutdown()


FRAMES = [
    (CanFrame(0x181, b"\x01\x02"), {"arbitration_id": 0x181, "data": b"\x01\x02", "is_extended_id": False}),
    (
        CanFrame(0x12345 | EXTENDED_FLAG, b"12345678"),
        {"arbitration_id": 0x12345, "data": b"12345678", "is_extended_id": True},
    ),
    (
        CanFrame(0x703 | REMOTE_FLAG, b"\0"),
        {"arbitration_id": 0x703, "is_remote_frame": True, "dlc": 1, "is_extended_id": False},
    ),
    (CanFrame(0x80), {"arbitration_id": 0x80, "data": b"", "is_extended_id": False}),
]


@pytest.mark.parametrize(("frame", "fields"), FRAMES, ids=[str(frame) for frame, _ in FRAMES])
def test_frames_of_each_kind_go_both_ways(port, bus, frame, fields):
    bus.send(can.Message(**fields))
    assert receive(port, 1) == [frame]
    port.send(pack_records([frame]))
    message = bus.recv(TIMEOUT_S)
    assert {name: getattr(message, name) for name in fields} == fields
    assert message.channel == "local:plug"


def test_filters_are_python_cans(port, bus):
    bus.set_filters([{"can_id": 0x182, "can_mask": 0x7FF}])
    port.send(pack_records([CanFrame(0x181), CanFrame(0x182)]))
    assert bus.recv(TIMEOUT_S).arbitration_id == 0x182


def test_own_messages_return_in_their_place_as_copies_that_report_this(port):
    with LocalBus("plug", receive_own_messages=True) as bus:
        port.send(pack_records([CanFrame(1)]))
        assert select.select([bus], [], [], TIMEOUT_S)[0]
        sent = can.Message(arbitration_id=2, is_extended_id=False, data=b"x")
        bus.send(sent)
        assert receive(port, 1) == [CanFrame(2, b"x")]
        port.send(pack_records([CanFrame(3)]))
        got = [bus.recv(TIMEOUT_S) for _ in range(3)]
        assert [(message.arbitration_id, message.is_rx) for message in got] == [(1, True), (2, False), (3, True)]
        assert got[1] is not sent
        assert got[1].channel == "local:plug"
        assert sent.timestamp == 0.0
        assert got[0].timestamp < got[1].timestamp < got[2].timestamp


def test_its_descriptor_is_readable_as_long_as_a_message_waits(port, bus):
    assert not select.select([bus], [], [], 0)[0]
    port.send(pack_records([CanFrame(n) for n in range(3)]))
    for number in range(3):
        assert select.select([bus], [], [], TIMEOUT_S)[0]
        assert bus.recv(0).arbitration_id == number
    assert not select.select([bus], [], [], 0)[0]


def test_a_descriptor_requested_while_messages_wait_is_readable(port, bus):
    port.send(pack_records([CanFrame(n) for n in range(3)]))
    assert bus.recv(TIMEOUT_S).arbitration_id == 0
    assert select.select([bus], [], [], 0)[0]
    assert [bus.recv(0).arbitration_id for _ in range(2)] == [1, 2]
    assert not select.select([bus], [], [], 0)[0]


@pytest.mark.parametrize("own", [False, True])
def test_an_asyncio_notifier_hands_over_a_whole_burst(port, own):
    async def burst():
        bus, got, done = LocalBus("plug", receive_own_messages=own), [], asyncio.Event()

        def take(message):
            got.append(message)
            if len(got) == 5 + own:
                done.set()

        with can.Notifier(bus, [take], loop=asyncio.get_running_loop()):
            bus.send(can.Message(arbitration_id=9, is_extended_id=False))
            port.send(pack_records([CanFrame(0x181, bytes([n])) for n in range(5)]))
            await asyncio.wait_for(done.wait(), TIMEOUT_S)
        bus.shutdown()
        return got

    got = asyncio.run(burst())
    assert [message.data[0] for message in got if message.is_rx] == [0, 1, 2, 3, 4]
    assert [message.arbitration_id for message in got if not message.is_rx] == [9] * own


def test_every_message_has_the_time_at_which_the_hub_had_it(port, bus):
    ear = open_local("plug", "ear")
    arrivals, stamps = Arrivals(ear), []
    before = time.monotonic_ns()
    for number in range(3):
        port.send(pack_records([CanFrame(number)] * 4))
        while len(stamps) < 4 * (number + 1):
            assert select.select([ear], [], [], TIMEOUT_S)[0]
            stamps += arrivals.receive()[1]
    received = time.monotonic_ns()
    times = [bus.recv(TIMEOUT_S).timestamp for _ in range(12)]
    ear.close()
    assert times == [(stamp + bus._arrivals.unix_offset_ns) / 1e9 for stamp in stamps], "not the time of reading"
    assert times == sorted(set(times)), "strictly increasing"
    assert before < stamps[0] < stamps[-1] < received + 12 * STAMP_STEP_NS
    assert all(stamps[at + 3] - stamps[at] == 3 * STAMP_STEP_NS for at in (0, 4, 8)), "what came at once"


def test_after_shutdown_the_error_is_python_cans(port, bus):
    bus.shutdown()
    bus.shutdown()
    for use in (
        bus.recv,
        lambda: bus.recv(0),
        lambda: bus.send(can.Message(arbitration_id=1)),
        lambda: next(iter(bus)),
    ):
        with pytest.raises(can.CanOperationError, match="cannot operate on a closed bus"):
            use()
    assert bus.fileno() == -1


def test_shutdown_ends_a_thread_that_receives(port, bus):
    errors = []

    def wait():
        try:
            bus.recv(None)
        except can.CanOperationError as error:
            errors.append(str(error))

    thread = threading.Thread(target=wait)
    thread.start()
    assert waits(thread)
    bus.shutdown()
    thread.join(TIMEOUT_S)
    assert not thread.is_alive()
    assert errors == ["canopen_control local:plug: cannot operate on a closed bus"]


def test_a_dead_hub_is_a_can_error(port, bus):
    kill_hub("plug")
    with pytest.raises(can.CanOperationError, match="the hub process has ended"):
        bus.recv(TIMEOUT_S)
    with pytest.raises(can.CanOperationError, match="the hub process has ended"):
        bus.send(can.Message(arbitration_id=1))


def test_a_wrong_name_is_a_can_error(runtime):
    with pytest.raises(can.CanInitializationError, match="is not a valid name"):
        LocalBus("a/b")


def test_the_buses_that_run_are_detected(bus):
    assert LocalBus._detect_available_configs() == [{"interface": "canopen_control", "channel": "plug"}]


# Through the entry point, in processes of their own


@pytest.fixture
def python(tmp_path):
    """Run a program in which the package is installed as far as entry points are concerned."""
    points = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["can.interface"]
    folder = tmp_path / "canopen_control-0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: canopen-control-under-test\nVersion: 0\n")
    (folder / "entry_points.txt").write_text(
        "[can.interface]\n" + "".join(f"{name} = {value}\n" for name, value in points.items())
    )

    def start(program):
        paths = f"import sys; sys.path[:0] = [{str(ROOT)!r}, {str(tmp_path)!r}]\n"
        return subprocess.Popen(
            [sys.executable, "-c", paths + textwrap.dedent(program)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    return start


SERVER = """
    import canopen
    od = canopen.ObjectDictionary()
    variable = canopen.objectdictionary.ODVariable("speed", 0x2000)
    variable.data_type, variable.default = canopen.objectdictionary.UNSIGNED32, 4711
    od.add_object(variable)
    network = canopen.Network()
    network.connect(interface="canopen_control", channel="robby")
    network.add_node(canopen.LocalNode(3, od))
    print("ready", flush=True)
    sys.stdin.read()
    network.disconnect()
"""
CLIENT = """
    import canopen
    od = canopen.ObjectDictionary()
    variable = canopen.objectdictionary.ODVariable("speed", 0x2000)
    variable.data_type = canopen.objectdictionary.UNSIGNED32
    od.add_object(variable)
    network = canopen.Network()
    network.connect(interface="canopen_control", channel="robby")
    node = network.add_node(3, od)
    node.sdo.RESPONSE_TIMEOUT = 20.0
    print(node.sdo[0x2000].raw)
    node.sdo[0x2000].raw = 815
    print(node.sdo[0x2000].raw)
    network.disconnect()
"""


def test_the_canopen_package_reads_and_writes_a_node_in_another_process(runtime, python):
    server = python(SERVER)
    try:
        assert server.stdout.readline() == "ready\n"
        client = python(CLIENT)
        output, _ = client.communicate(timeout=60)
        assert (output, client.returncode) == ("4711\n815\n", 0)
    finally:
        server.communicate(timeout=60)
    assert server.returncode == 0
