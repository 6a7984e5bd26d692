import pytest
from support.observers import Watch
from support.simulated import BASE, FORWARD, Played

from canopen_control.runtime.core import RobotState
from canopen_control.runtime.setup import BUS_NAME
from canopen_control.simulation.event_player import _PLAY
from canopen_control.simulation.scenario_events import KINDS


def test_every_kind_can_be_played():
    assert _PLAY.keys() == KINDS.keys()


def test_a_command_is_published_while_it_lasts_and_then_expires(played):
    played.drive(5.0, 5.0, seconds=3.0).run(3.0)
    assert played.speed(2) > 1000
    played.run(3.0)  # the forward controller's command_timeout is 2 s
    assert played.speed(2) == 0.0
    assert played.player.refused == 0


def test_a_newer_publisher_replaces_the_one_before(played):
    played.drive(5.0, 5.0, seconds=9.0).run(1.0).drive(-5.0, -5.0, seconds=9.0).run(1.5)
    assert played.speed(2) < -1000


def test_a_fault_is_switched_on_and_off(played):
    played.do("fault", 3, 0.7, name="heartbeat_lost").run(0.65)
    assert played.robot.drives[3].device.fault_switches.active == ["heartbeat_lost"]
    assert "node_lost" in played.kinds or any("heartbeat" in event.text for event in played.events)
    played.run(0.1)
    assert played.robot.drives[3].device.fault_switches.active == []
    played.do("fault", 3, name="warning").run(0.1).do("fault_off", 3, name="warning").run(0.1)
    assert played.robot.drives[3].device.fault_switches.active == []


def test_a_quirk_is_switched_on_and_off(played):
    played.do("quirk", 3, 0.7, name="brake_delay=0.2").run(0.65)
    assert played.robot.drives[3].device.quirks.active == ["brake_delay=0.2"]
    played.run(0.1)
    assert played.robot.drives[3].device.quirks.active == []
    played.do("quirk", 3, name="sdo_late").run(0.1).do("quirk_off", 3, name="sdo_late").run(0.1)
    assert played.robot.drives[3].device.quirks.active == []


def test_stop_disables_and_a_latched_one_refuses_until_it_is_released(played):
    played.do("latch").run(0.5).do("axis", name="enable").run(0.5)
    assert played.player.refused == 1
    assert played.robot.core.state is RobotState.DISABLED
    played.do("release").run(0.1).do("axis", name="enable").run(0.5)
    assert played.robot.core.state is RobotState.RUNNING
    played.do("stop").run(0.5)
    assert played.robot.core.state is RobotState.DISABLED


def test_controllers_are_switched(played):
    played.do("activate", BASE).run(0.2)
    assert BASE in played.robot.core.manager.active
    assert FORWARD not in played.robot.core.manager.active
    played.do("deactivate", BASE).run(0.2)
    assert BASE not in played.robot.core.manager.active


@pytest.mark.parametrize("kind", ["cut", "bus_off", "stall", "power"])
def test_what_breaks_a_drive_is_repaired_and_the_robot_can_continue(played, kind):
    played.do(kind, 3, 1.0).run(0.9)
    assert played.robot.core.state is RobotState.FAULT
    played.run(4.0).do("axis", name="fault-reset").run(0.5).do("axis", name="enable").run(0.7)
    played.drive(5.0, 5.0).run(1.0)
    assert played.speed(2) > 1000


def test_a_robot_that_is_stalled_stops_its_drives_by_their_own_reaction(played):
    played.drive(5.0, 5.0, seconds=9.0).run(1.0).do("stall", "master", 2.0).run(1.5)
    assert played.speed(2) == 0.0 == played.speed(3)


def test_a_killed_robot_receives_nothing_and_returns(played):
    played.do("kill", seconds=1.0).do("kill", seconds=0.1).run(0.5).drive(5.0, 5.0, seconds=0.3).run(3.0)
    assert played.robot.running
    assert played.player.refused == 0


@pytest.mark.parametrize("kind", ["lose", "double", "disturb"])
def test_frames_are_tampered_with_for_a_while(played, kind):
    frames = played.robot.frames
    played.do(kind, 3, 0.2, values=(2.0,)).run(0.3)
    wire = played.robot.wires[BUS_NAME]
    assert wire.lost == wire.doubled == wire.disturbed == []
    assert played.robot.frames > frames


def test_a_plant_takes_numbers_and_a_strange_frame_passes(played):
    label = []
    played.robot.wires[BUS_NAME].listeners.append(lambda _now, sender, _record: label.append(sender))
    played.do("frame", values=(0x7E5, 1, 2)).run(0.1)
    assert "stranger" in label
    played.do("plant", 3, plant=(("rated_velocity", 5.0),)).run(0.1)
    assert played.robot.drives[3].device.drives[0].mover.plant.rated_velocity == 5.0


@pytest.mark.rest
def test_a_trajectory_goes_by_way_of_its_points():
    played = Played("arm6")
    joints = list(played.robot.core.joints.values())
    played.do("activate", "arm_controller").run(0.1)
    played.do("trajectory", "arm_controller", values=(*[0.3] * 6, *[0.1] * 6), times=(1.0, 2.0)).run(1.0)
    assert [joint.states["position"].value for joint in joints] == pytest.approx([0.3] * 6, abs=0.03)
    played.run(1.5)
    assert [joint.states["position"].value for joint in joints] == pytest.approx([0.1] * 6, abs=1e-3)
    played.close()


@pytest.mark.rest
def test_a_trajectory_arrives():
    played = Played("arm6")
    played.do("activate", "arm_controller").run(0.1)
    played.do("trajectory", "arm_controller", 1.0, values=(0.3,) * 6).run(2.0)
    joints = played.robot.core.joints.values()
    assert [joint.states["position"].value for joint in joints] == pytest.approx([0.3] * 6, abs=1e-3)
    assert played.player.refused == 0
    played.close()


def test_an_act_that_waits_for_a_state_begins_in_it(played):
    played.do("power", 3, 0.2, when="axis power DISABLING").run(0.5)
    assert played.robot.drives[3].device is not None
    played.do("stop")
    begun = []
    played.robot.observers.append(Watch(played=lambda now, act: begun.append((act.kind, now))))
    reported = played.robot.now_ns
    played.run(0.5)
    [(kind, at)] = begun
    assert kind == "power"
    assert 0 < at - reported < 300_000_000
