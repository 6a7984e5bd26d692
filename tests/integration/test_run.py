"""`run robby` from boot to end, as observed by another member of the bus."""

import contextlib
import struct
import threading

import pytest
from support.channel import CHANNEL, channel_of, robby_of
from support.guest import scaled
from support.host import eventually
from support.listener import SYNC, Witness, missing
from support.processes import cycles_pass

from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import GetStatus, SdoRead, SwitchControllers

pytestmark = pytest.mark.timed

LEFT, RIGHT = 3, 2
RAD = {LEFT: -0.003926990816987242, RIGHT: 0.003926990816987242}  # per microstep; the left motor is mirrored
STATUSWORD, POSITION, VELOCITY = 0x6041, 0x6064, 0x606C
RAMP_S = 10 / 0.003926990816987242 / 16000  # to 10 rad/s, by 0x6083
TPDOS = {0x180 + LEFT, 0x280 + LEFT, 0x180 + RIGHT, 0x280 + RIGHT}


@pytest.fixture
def witness():
    with contextlib.ExitStack() as stack:

        def open_witness(name):
            witness = Witness(name)
            stack.callback(witness.close)
            return witness

        yield open_witness


def enabled(statusword):
    return statusword & 0x6F == 0x27


def statuswords(frames, node_id):
    return [
        (time, struct.unpack_from("<H", data)[0]) for time, identifier, data in frames if identifier == 0x180 + node_id
    ]


def controlwords(frames, node_id):
    return [
        (time, struct.unpack_from("<H", data)[0]) for time, identifier, data in frames if identifier == 0x200 + node_id
    ]


def test_an_independent_listener_receives_both_wheels_at_ten_rad_per_second_without_a_missing_frame(stage, witness):
    sees = witness("wheels")
    robot = stage.robby("wheels", "--for", scaled(5))
    for node_id in (LEFT, RIGHT):
        sees.join(node_id)
    command = stage.start("command", "robby_forward_controller", 10, 10, "--for", scaled(2.5), "--name", "wheels")
    for node_id in (LEFT, RIGHT):
        assert eventually(lambda node_id=node_id: any(value for _, value in sees.series(node_id, VELOCITY)))
        node = sees.nodes[node_id]
        assert sees.patiently(lambda node=node: node.sdo[0x1018][1].raw) == 0x286
        assert sees.patiently(lambda node=node: node.sdo[0x1008].raw).startswith("TMCM-1270")
    assert command.wait(scaled(20)) == 0, command
    assert robot.wait(scaled(20)) == 0, robot
    assert robot.err == ""

    for node_id in (LEFT, RIGHT):
        speeds = [(time, RAD[node_id] * value) for time, value in sees.series(node_id, VELOCITY)]
        begin = next(time for time, speed in speeds if speed)
        fast, end = begin + RAMP_S + scaled(0.04), begin + scaled(2.4)
        steady = [(time, speed) for time, speed in speeds if fast <= time <= end]
        assert len(steady) > 90
        assert all(abs(speed - 10.0) <= 0.1 for _, speed in steady), steady
        assert all(speed < 9.9 for time, speed in speeds if time < begin + RAMP_S - scaled(0.06)), "it did not ramp"
        positions = [(time, RAD[node_id] * value) for time, value in sees.series(node_id, POSITION)]
        held = [position for position in positions if fast <= position[0] <= end]
        cycles = sum(held[0][0] < time <= held[-1][0] for time, identifier, _ in sees.frames if identifier == SYNC)
        took = held[-1][0] - held[0][0] if CHANNEL else 0.02 * cycles  # a busy guest leaves out a SYNC or two
        assert (held[-1][1] - held[0][1]) / took == pytest.approx(10.0, rel=0.03 if CHANNEL else 0.01)
        assert speeds[-1][1] == 0.0

    ready = [time for time, identifier, data in sees.frames if identifier == 0x000 and data[0] == 1][-1] + scaled(0.1)

    def resets():
        return [
            time for time, identifier, data in sees.frames if identifier == 0x000 and data[0] == 0x82 and time > ready
        ]

    assert eventually(resets)  # the witness may be behind the robot
    stop = resets()[0]
    live = [frame for frame in sees.frames if ready < frame[0] < stop]
    cycles, lost = missing(live, TPDOS)
    assert cycles > 220
    assert lost == []
    assert sees.lost == 0


def test_drives_are_enabled_only_once_the_controller_is_active_and_disabled_before_the_bus_is_left(stage, witness):
    sees = witness("order")
    robot = stage.start(
        *("run", robby_of(stage.place), "--as", "order", "--can", channel_of("order")),
        *("--controller", "joint_state_broadcaster"),
    )
    robot.until("order runs")
    with RobotClient.connect("order") as client:
        cycles_pass(client, 26)
        assert not any(enabled(word) for node in (LEFT, RIGHT) for _, word in statuswords(sees.frames, node))
        assert not any(word & 0x08 for node in (LEFT, RIGHT) for _, word in controlwords(sees.frames, node))
        client.ask(SwitchControllers(activate=("robby_forward_controller",)))
        assert eventually(lambda: all(joint_enabled(client)))
        activated = next(event for event in client.ask(GetStatus()).events if "robby_forward_controller" in event.text)
    assert robot.end() == 0, robot
    for node in (LEFT, RIGHT):
        first = next(time for time, word in controlwords(sees.frames, node) if word & 0x08)
        assert first >= activated.time - 0.005  # the event bears the time at which its cycle began
        assert any(enabled(word) for _, word in statuswords(sees.frames, node))
        assert not enabled(statuswords(sees.frames, node)[-1][1])
    assert sees.lost == 0


def joint_enabled(client):
    nodes = client.ask(GetStatus()).nodes.values()
    return [axis.state == "OPERATION_ENABLED" for node in nodes for axis in node.axes]


def test_sdo_of_another_client_at_the_same_time_disturbs_none_of_ours(stage, witness):
    sees = witness("clash")
    stage.robby("clash")
    node = sees.join(LEFT)
    theirs, over = [], threading.Event()

    def read_on():
        while not over.is_set():
            theirs.append(sees.patiently(lambda: node.sdo[0x2000].raw))

    reader = threading.Thread(target=read_on)
    with RobotClient.connect("clash") as client:
        reader.start()
        ours = [client.ask(SdoRead(node="left_drive", index=0x1018, subindex=1)).data.hex() for _ in range(50)]
        over.set()
        reader.join()
        status = client.ask(GetStatus())
    assert ours == ["86020000"] * 50
    assert set(theirs) == {3}
    assert status.state == "running"
    assert status.buses["can"].lost == 0
