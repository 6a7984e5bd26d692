"""The verb bus on interfaces of a real kernel: up, down, status, list, and messages without permissions."""

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.guest import ip
from support.host import eventually

from canopen_control.bus.can_interfaces import count_hearing
from canopen_control.bus.channel import open_port
from canopen_control.bus.kernel_sync import KernelSync
from canopen_control.frame import CanFrame

pytestmark = pytest.mark.socketcan


@pytest.fixture
def fresh():
    """Return the name of an interface that is not there; what was made of it goes with the test."""
    yield "vcan77"
    subprocess.run(["ip", "link", "del", "vcan77"], capture_output=True)


def lines(program):
    assert program.wait() == 0, program
    return program.out.splitlines()


def facts(name):
    (link,) = json.loads(ip("-json", "link", "show", name))
    return "UP" in link["flags"], link["txqlen"]


def test_up_makes_a_vcan_reports_each_step_and_a_second_time_does_nothing(stage, fresh):
    assert lines(stage.call("bus", "up", fresh)) == [
        "modprobe vcan   # load the vcan module",
        "ip link add dev vcan77 type vcan   # create the interface",
        "ip link set vcan77 txqueuelen 1000   # lengthen the transmit queue",
        "ip link set vcan77 up   # bring it up",
    ]
    assert facts(fresh) == (True, 1000)
    assert lines(stage.call("bus", "up", fresh)) == ["vcan77 is up already"]


def test_down_takes_it_down_and_up_brings_the_same_one_back(stage, vcan):
    number = json.loads(ip("-json", "link", "show", vcan))[0]["ifindex"]
    assert lines(stage.call("bus", "down", vcan)) == [f"ip link set {vcan} down   # bring it down"]
    assert facts(vcan)[0] is False
    assert lines(stage.call("bus", "down", vcan)) == [f"{vcan} is down already"]
    assert lines(stage.call("bus", "up", vcan))[-1] == f"ip link set {vcan} up   # bring it up"
    assert facts(vcan) == (True, 1000)
    assert json.loads(ip("-json", "link", "show", vcan))[0]["ifindex"] == number


def test_status_and_list_show_what_the_kernel_has(stage, vcan):
    ip("link", "set", vcan, "down")
    assert lines(stage.call("bus", "status", vcan))[0] == f"{vcan}: vcan, down"
    ip("link", "set", vcan, "up")
    subprocess.run(["cansend", vcan, "123#1122"], check=True)
    (status,) = json.loads(stage.call("bus", "status", vcan, "--json").out).values()
    assert status["is_up"] is True
    assert (status["traffic"]["tx_packets"], status["traffic"]["tx_bytes"]) == (1, 2)
    result = json.loads(stage.call("bus", "list", "--json").out)
    assert {"vcan0", vcan} <= {link["name"] for link in result["interfaces"]}


def test_status_reports_frames_listeners_and_frames_sent_by_the_kernel(stage, vcan, tool):
    sync = KernelSync(vcan, [CanFrame(0x80)])
    sync.start(10_000)
    with contextlib.closing(sync), contextlib.closing(open_port(vcan)) as port:
        port.set_filter([0x181, 0x182])
        pids = [tool("candump", vcan).pid, tool("candump", "any").pid, tool("cangen", vcan, "-g", "1000").pid]
        assert eventually(lambda: count_hearing(vcan) == 3)
        status = json.loads(stage.call("bus", "status", vcan, "--json").out)[vcan]
        result = {(item["pid"], item["protocol"]): item for item in status["listeners"]}
        me = os.getpid()
        assert [result[pid, "CAN_RAW"]["identifiers"] for pid in (*pids, me)] == [-1, -1, 0, 2]
        assert [result[pid, "CAN_RAW"]["interface"] for pid in (*pids, me)] == [vcan, "", vcan, vcan]
        assert result[me, "CAN_BCM"]["tasks"] == [[0x80, 10_000]]
        assert (status["unnamed_listeners"], status["load"]) == (0, None)
        assert 10 < status["frames_per_second"] < 120, "a hundred, unless the guest is held up"
        message = lines(stage.call("bus", "status", vcan))
        assert f"  candump {vcan} (pid {pids[0]}) receives everything" in message
        assert any(line.endswith("has the kernel send 0x080 every 10 ms") for line in message), message
        done = subprocess.run([sys.executable, "-c", NOBODY_LOOKS, vcan], capture_output=True, text=True)
        assert done.stdout == "0 named, 3 hear\n", (done, "all are root's")


NOBODY_LOOKS = """
import os, sys
from canopen_control.bus.can_interfaces import count_hearing, find_listeners
os.setgid(65534)
os.setuid(65534)
print(len(find_listeners(sys.argv[1])), "named,", count_hearing(sys.argv[1]), "hear")
"""


def test_a_pair_of_vxcan_is_made_up_as_well(stage):
    ip("link", "add", "vxcan7", "type", "vxcan", "peer", "name", "vxcan8")
    try:
        for name in ("vxcan7", "vxcan8"):
            assert lines(stage.call("bus", "up", name))[-1] == f"ip link set {name} up   # bring it up"
        others = count_hearing("vxcan8")
        with subprocess.Popen(["candump", "-L", "-n", "1", "vxcan8"], stdout=subprocess.PIPE, text=True) as dump:
            # the kernel also lists interfaces without a listener
            assert eventually(lambda: count_hearing("vxcan8") > others or dump.poll() is not None)
            subprocess.run(["cansend", "vxcan7", "701#05"], check=True)
            try:
                assert dump.communicate(timeout=20)[0].endswith(" vxcan8 701#05\n")
            finally:
                dump.kill()
    finally:
        ip("link", "del", "vxcan7")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("up", "can0", "--bitrate", "500000"), "no CAN interface 'can0'; check that the adapter is plugged in;"),
        (("up", "vcan0", "--bitrate", "500000"), "vcan0 is a vcan interface and has no bit rate"),
        (("down", "vcan66"), "no CAN interface 'vcan66'"),
    ],
)
def test_what_is_not_there_is_one_sentence(stage, arguments, message):
    program = stage.call("bus", *arguments)
    assert (program.wait(), program.err.count("\n")) == (2, 1), program
    assert message in program.err


def test_without_the_right_to_it_the_kernels_refusal_is_explained(stage, fresh):
    words = [sys.executable, "-m", "canopen_control", "bus", "up", fresh]
    done = subprocess.run(["setpriv", "--bounding-set=-net_admin", *words], capture_output=True, text=True)
    assert done.returncode == 2
    assert "CAP_NET_ADMIN is required" in done.stderr


# Another user could not even read a checkout of root's: so this process becomes one when it has everything it needs.
AS_NOBODY = """
import os, sys
from canopen_control.cli import bus
from canopen_control.cli.main import main
os.environ["PATH"] = "/usr/sbin:/usr/bin:/sbin:/bin"
os.setgid(65534)
os.setuid(65534)
sys.exit(main(["bus", "up", sys.argv[1]]))
"""


def test_without_root_the_commands_to_type_are_reported_and_none_is_run(fresh):
    done = subprocess.run([sys.executable, "-c", AS_NOBODY, fresh], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert done.stderr == (
        f"canopen-control: {fresh}: root permissions are needed; run: sudo modprobe vcan"
        f" && sudo ip link add dev {fresh} type vcan"
        f" && sudo ip link set {fresh} txqueuelen 1000 && sudo ip link set {fresh} up\n"
    )
    assert not Path(f"/sys/class/net/{fresh}").exists()
