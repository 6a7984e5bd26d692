import os
import sys

import pytest
from support.host import eventually
from support.jogbench import NODE_ID, jog_bench
from support.onbus import GENERIC, TMCM
from support.processes import seconds_until

from canopen_control.cli.main import main
from canopen_control.cli.support.jog_robot import DEAD_MAN_S, choose_jog, dead_man_words, own_robot
from canopen_control.cli.support.target import find_eds
from canopen_control.client import RobotClient
from canopen_control.commissioning.driven_axis import choose_mode
from canopen_control.errors import RobotConfigError
from canopen_control.od.eds import read_eds
from canopen_control.rpc.messages.robot import AxisRequest, CommandController
from canopen_control.runtime.observer import RobotObserver
from canopen_control.scaffold.bus_text import bus_text
from canopen_control.scaffold.drive_choice import Supervision
from canopen_control.scaffold.new_robot import Device


def device(eds=GENERIC, without=()):
    od = read_eds(find_eds(eds), NODE_ID).od
    for address in [entry for entry in od.entries if entry[0] in without]:
        del od.entries[address]
    return Device(NODE_ID, find_eds(eds), od)


@pytest.mark.parametrize(
    ("interface", "mode", "target"),
    [
        ("velocity", "velocity_mode: 3", "0x60FF"),
        ("position", "position_mode: 8", "0x607A"),
        ("effort", "effort_mode: 4", "0x6071"),
    ],
)
def test_the_robot_of_one_drive_is_what_init_would_make(private_folders, interface, mode, target):
    text = bus_text(choose_jog(device(), interface, allow_unsupervised=False))
    assert mode in text
    assert f"index: {target}" in text
    assert "heartbeat_producer: 50" in text


def test_a_drive_that_nothing_would_stop_is_refused_unless_that_is_accepted(private_folders):
    lonely = device(without=(0x1016, 0x100C, 0x100D))
    with pytest.raises(RobotConfigError, match=r"nothing stops node 5 when this computer fails.*--allow-unsupervised"):
        choose_jog(lonely, "velocity", allow_unsupervised=False)
    assert choose_jog(lonely, "velocity", allow_unsupervised=True).allow_unsupervised


def test_what_a_drive_cannot_do_is_reported_by_its_modes(private_folders):
    with pytest.raises(RobotConfigError, match=r"its modes are PP, PV, HM, CSP \(0x6502\).*target of effort"):
        choose_jog(device(TMCM), "effort", allow_unsupervised=False)


def test_the_user_is_notified_what_stops_the_drive():
    assert DEAD_MAN_S < 0.5
    reported = [
        dead_man_words(Supervision(*item)) for item in ((True, True, False), (False, False, True), (True, False, False))
    ]
    assert ["heartbeat (0x1016)" in reported[0], "guarded (0x100C, 0x100D)" in reported[1], "NONE" in reported[2]] == [
        True
    ] * 3
    assert dead_man_words(Supervision(True, True, False, reacts=False)).startswith("UNKNOWN: the drive monitors")


def test_a_running_robot_of_one_drive_is_jogged_through_it(private_folders, monkeypatch, capsys):
    with open(os.devnull) as nothing, jog_bench(channel="memory:through") as bench:
        monkeypatch.setattr(sys, "stdin", nothing)
        robot = choose_jog(device(), "velocity", allow_unsupervised=False)
        with own_robot(robot, robot.joints[0].axis, bench.bus.channel, 2.0, RobotObserver()):
            for where in (["--name", "jog_5"], ["--can", bench.bus.channel, "--eds", GENERIC]):
                assert main(["jog", "5", *where, "--velocity", "1rad/s", "--for", "0.5"]) == 0
        assert bench.get(0x6064) > 5000
    assert "node 5 is joint_1_drive of the running robot jog_5, which moves it" in capsys.readouterr().out


def test_a_command_that_is_not_renewed_ends_soon(private_folders):
    with jog_bench(channel="memory:hanging") as bench:
        robot = choose_jog(device(), "velocity", allow_unsupervised=False)
        own = own_robot(robot, robot.joints[0].axis, bench.bus.channel, 2.0, RobotObserver())
        with own as drive, RobotClient.connect(drive.robot) as client:
            choose_mode(client, AxisRequest(action="mode", node=drive.node, mode=drive.mode))
            client.ask(AxisRequest(action="enable", node=drive.node), 10.0)
            client.ask(CommandController(controller=drive.controller, values=[1.0]))
            assert eventually(lambda: bench.speed > 0)
            assert seconds_until(lambda: bench.speed == 0, 5.0) < 1.0
