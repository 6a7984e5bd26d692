"""CAN interfaces: reading the output of ip -json, and the commands that bring an interface up."""

from __future__ import annotations

import json

import pytest

from canopen_control.bus import can_interfaces as module
from canopen_control.bus.can_interfaces import (
    CanInterface,
    CommandResult,
    bring_down,
    bring_up,
    find_can_interface,
    list_can_interfaces,
    parse_can_interfaces,
    run_command,
    up_commands,
)
from canopen_control.errors import ConfigError

ETHERNET = {"ifname": "eth0", "flags": ["UP"], "link_type": "ether", "txqlen": 1000}
VCAN0 = {
    "ifname": "vcan0",
    "flags": ["NOARP", "UP", "LOWER_UP"],
    "txqlen": 1000,
    "link_type": "can",
    "linkinfo": {"info_kind": "vcan"},
    "stats64": {"rx": {"packets": 7, "dropped": 0}, "tx": {"packets": 3}},
}
CAN0 = {
    "ifname": "can0",
    "flags": ["NOARP", "ECHO"],
    "txqlen": 10,
    "link_type": "can",
    "linkinfo": {
        "info_kind": "can",
        "info_data": {
            "state": "ERROR-PASSIVE",
            "berr_counter": {"tx": 128, "rx": 9},
            "restart_ms": 100,
            "bittiming": {"bitrate": 500000, "sample_point": "0.875"},
        },
        "info_xstats": {"bus_error": 4, "bus_off": 1},
    },
}
FRESH = {
    "ifname": "can1",
    "flags": ["NOARP"],
    "txqlen": 10,
    "link_type": "can",
    "linkinfo": {"info_kind": "can", "info_data": {"state": "STOPPED", "restart_ms": 0}},
}


class Shell:
    """Answers `ip ... show` with what is there, and other commands with success unless configured otherwise."""

    def __init__(self, *entries, failures=()):
        self.entries = list(entries)
        self.failures = dict(failures)
        self.ran = []

    def __call__(self, argv):
        if argv[-2:] == ("link", "show"):
            return CommandResult(0, json.dumps(self.entries), "")
        self.ran.append(" ".join(argv))
        answer = self.failures.get(argv[0] if argv[0] != "ip" else argv[2], "")
        if isinstance(answer, OSError):
            raise answer
        return CommandResult(2 if answer else 0, "", answer)


@pytest.fixture(autouse=True)
def root(monkeypatch):
    monkeypatch.setattr(module.os, "geteuid", lambda: 0)


def test_can_interfaces_are_read_and_others_left_out():
    assert parse_can_interfaces(json.dumps([ETHERNET, VCAN0, CAN0, FRESH])) == [
        CanInterface(
            "vcan0", "vcan", is_up=True, queue_length=1000, traffic={"rx_packets": 7, "rx_dropped": 0, "tx_packets": 3}
        ),
        CanInterface(
            "can0",
            "can",
            is_up=False,
            queue_length=10,
            state="ERROR-PASSIVE",
            bitrate=500_000,
            sample_point=0.875,
            restart_ms=100,
            error_counters=(128, 9),
            counters={"bus_error": 4, "bus_off": 1},
        ),
        CanInterface("can1", "can", is_up=False, queue_length=10, state="STOPPED", restart_ms=0),
    ]


@pytest.mark.parametrize(
    ("restart_ms", "expected", "commands"),
    [
        (0, {}, ["ip link set can3 type can restart"]),
        (100, {}, []),
        (0, {"restart_ms": 100}, ["down", "type can restart-ms 100", "up"]),
    ],
    ids=["by hand", "by itself", "from now on by itself"],
)
def test_an_interface_that_is_off_the_bus_is_restarted(restart_ms, expected, commands):
    off = CanInterface("can3", "can", True, 1000, state="BUS-OFF", bitrate=500_000, restart_ms=restart_ms)
    created = [str(command) for command in module.up_commands("can3", off, **expected)]
    assert [item.removeprefix("ip link set can3 ") for item in created] == [
        item.removeprefix("ip link set can3 ") for item in commands
    ]


def test_an_interface_is_found_by_name():
    assert find_can_interface("can0", Shell(VCAN0, CAN0)).name == "can0"
    assert find_can_interface("can7", Shell(VCAN0, CAN0)) is None


@pytest.mark.process
def test_the_machines_own_links_are_readable_json():
    assert all(isinstance(link, CanInterface) for link in list_can_interfaces())


def test_a_missing_ip_suggests_what_to_install():
    def run(argv):
        raise FileNotFoundError(2, "No such file or directory")

    with pytest.raises(ConfigError, match="install iproute2"):
        list_can_interfaces(run)


def test_a_failing_ip_is_quoted():
    with pytest.raises(ConfigError, match="ip link show failed: boom"):
        list_can_interfaces(lambda argv: CommandResult(1, "", "boom"))


@pytest.mark.parametrize(
    ("entry", "options", "commands"),
    [
        (
            None,
            {},
            [
                "modprobe vcan",
                "ip link add dev vcan0 type vcan",
                "ip link set vcan0 txqueuelen 1000",
                "ip link set vcan0 up",
            ],
        ),
        (VCAN0, {}, []),
        (VCAN0 | {"flags": []}, {}, ["ip link set vcan0 up"]),
        (
            FRESH,
            {"bitrate": 1_000_000, "restart_ms": 100},
            [
                "ip link set can1 type can bitrate 1000000 restart-ms 100",
                "ip link set can1 txqueuelen 1000",
                "ip link set can1 up",
            ],
        ),
        (CAN0 | {"txqlen": 1000}, {}, ["ip link set can0 up"]),
        (CAN0 | {"txqlen": 1000, "flags": ["UP"]}, {"bitrate": 500_000, "restart_ms": 100}, []),
        (
            CAN0 | {"txqlen": 1000, "flags": ["UP"]},
            {"sample_point": 0.8},
            [
                "ip link set can0 down",
                "ip link set can0 type can bitrate 500000 sample-point 0.8",
                "ip link set can0 up",
            ],
        ),
    ],
    ids=["new vcan", "vcan up", "vcan down", "fresh can", "set can", "same can", "other sample point"],
)
def test_only_what_is_missing_is_done(entry, options, commands):
    link = None if entry is None else parse_can_interfaces(json.dumps([entry]))[0]
    assert [str(command) for command in up_commands(link.name if link else "vcan0", link, **options)] == commands


@pytest.mark.parametrize(
    ("name", "entry", "options", "message"),
    [
        ("can7", None, {"bitrate": 1}, "no CAN interface 'can7'; check that the adapter is plugged in"),
        ("can1", FRESH, {}, "can1 has no bit rate yet; add --bitrate"),
        ("vcan0", VCAN0, {"bitrate": 1}, "vcan0 is a vcan interface and has no bit rate"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(name, entry, options, message):
    link = None if entry is None else parse_can_interfaces(json.dumps([entry]))[0]
    with pytest.raises(ConfigError, match=message):
        up_commands(name, link, **options)


def test_each_step_is_reported_and_run():
    shell, text = Shell(), []
    bring_up("vcan0", text.append, run=shell)
    assert text[-1] == "ip link set vcan0 up   # bring it up"
    assert [line.split("   #")[0] for line in text] == shell.ran


def test_nothing_to_do_is_reported_too():
    shell, text = Shell(VCAN0, CAN0), []
    bring_up("vcan0", text.append, run=shell)
    bring_down("can0", text.append, run=shell)
    assert text == ["vcan0 is up already", "can0 is down already"]
    assert shell.ran == []


def test_a_module_that_cannot_be_loaded_may_be_built_in():
    for problem in ("FATAL: Module vcan not found", FileNotFoundError(2, "No such file")):
        shell = Shell(failures={"modprobe": problem})
        bring_up("vcan0", lambda _line: None, run=shell)
        assert shell.ran[-1] == "ip link set vcan0 up"


@pytest.mark.parametrize(
    ("error", "advice"),
    [
        ("Error: Unknown device type.", "to use a bus without kernel CAN, write local:NAME"),
        ("RTNETLINK answers: Operation not permitted", "CAP_NET_ADMIN"),
    ],
)
def test_a_refusal_of_the_kernel_ends_it_with_advice(error, advice):
    shell = Shell(failures={"add": error})
    with pytest.raises(ConfigError, match=advice):
        bring_up("vcan0", lambda _line: None, run=shell)
    assert len(shell.ran) == 2


def test_taking_an_interface_down():
    shell = Shell(VCAN0)
    bring_down("vcan0", lambda _line: None, run=shell)
    assert shell.ran == ["ip link set vcan0 down"]
    with pytest.raises(ConfigError, match="no CAN interface 'can5'"):
        bring_down("can5", lambda _line: None, run=shell)


def test_without_root_and_sudo_the_commands_to_type_are_reported(monkeypatch):
    monkeypatch.setattr(module.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(module.shutil, "which", lambda _name: None)
    shell = Shell(VCAN0 | {"flags": []})
    with pytest.raises(ConfigError, match="vcan0: root permissions are needed; run: sudo ip link set vcan0 up"):
        bring_up("vcan0", lambda _line: None, run=shell)
    assert shell.ran == []


def test_with_sudo_the_commands_go_through_it(monkeypatch):
    monkeypatch.setattr(module.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(module.shutil, "which", lambda _name: "/usr/bin/sudo")
    shell = Shell(VCAN0)
    bring_down("vcan0", lambda _line: None, run=shell)
    assert shell.ran == ["sudo -n true", "sudo -n ip link set vcan0 down"]


@pytest.mark.process
def test_a_command_is_run_and_its_output_kept_apart():
    assert run_command(("sh", "-c", "echo out; echo err >&2; exit 3")) == (3, "out\n", "err")
