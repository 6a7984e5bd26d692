"""Readings of nodes: unchanged readings are cached, and the cache always equals a new reading."""

from __future__ import annotations

import contextlib
import dataclasses
import random
from types import SimpleNamespace

import msgspec
import pytest
from support.faultbench import FaultBench
from support.generic import write_generic
from support.robots import RIGHT, Bench

from canopen_control.errors import CanopenError
from canopen_control.hardware.axis_statechart import Action
from canopen_control.master.event_log import Event, EventLog
from canopen_control.runtime.node_readings import EventReadings, NodeReadings, _mode


def read_anew(robot):
    buses = {name: robot.bus_of(node) for name, node in robot.nodes.items()}
    return NodeReadings(robot.nodes, buses, robot.joints.values(), robot.systems).at(robot.reactor.now())


def test_a_drive_that_nothing_stops_reports_why():
    bench = Bench("readings")
    bench.start()
    node = bench.robot.nodes["left_drive"]
    assert read_anew(bench.robot)["left_drive"].unsupervised == ""
    node.plan = dataclasses.replace(node.plan, unsupervised="it has no 0x1016")
    assert read_anew(bench.robot)["left_drive"].unsupervised == "it has no 0x1016"
    bench.close()


def test_a_fault_is_that_of_the_emcy_at_the_node_and_of_statusword_and_code_at_the_axis(tmp_path):
    bench = FaultBench("readings", config=write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    bench.start()
    name = next(iter(bench.robot.nodes))
    assert read_anew(bench.robot)[name].fault is None
    bench.drives[2].drives[0].fault(0x4310, bench.reactor.now())
    bench.run(100)
    reading = bench.robot.node_readings.at(bench.reactor.now())[name]
    axis = reading.axes[0]
    assert (reading.fault.error_code, axis.fault.error_code) == (0x4310, 0x4310)
    assert axis.fault.statusword & 0x4F == 0x08
    assert axis.error == "EMCY 0x4310 (drive temperature too high)"
    bench.robot.nodes[name].error = None  # as of a drive without EMCY
    assert read_anew(bench.robot)[name].axes[0].error == "0x4310 (drive temperature too high)"
    bench.close()


@pytest.mark.parametrize(
    ("display", "enabled", "missed", "mode"),
    [
        (None, True, None, 3),
        (0, False, None, 3),
        (0, False, 8, 3),
        (0, False, 3, 0),
        (0, True, None, 0),
        (8, False, None, 8),
        (3, True, None, 3),
    ],
)
def test_a_mode_is_the_displayed_one_except_no_mode_of_a_drive_that_may_show_its_mode_later(
    display, enabled, missed, mode
):
    request = SimpleNamespace(mode=3, display=display, missed=missed)
    assert _mode(SimpleNamespace(machine=SimpleNamespace(mode_request=request, enabled=enabled))) == mode


def test_of_a_robot_that_stands_only_the_age_is_new():
    bench = Bench("readings")
    bench.start()
    before = bench.robot.node_readings.at(bench.reactor.now())["left_drive"]
    bench.run(100)
    after = bench.robot.node_readings.at(bench.reactor.now())["left_drive"]
    assert after.axes is before.axes
    assert after.sdo is before.sdo
    later = bench.robot.node_readings.at(bench.reactor.now() + 7_000_000)["left_drive"]
    assert later.age - after.age == pytest.approx(0.007)
    assert msgspec.structs.replace(later, age=0.0) == msgspec.structs.replace(before, age=0.0)
    bench.close()


@pytest.mark.rest
def test_whatever_happens_they_are_what_is_read_again():
    draw = random.Random(7)
    bench = Bench("readings_drawn")
    robot, met = bench.robot, set()
    robot.start()
    for _ in range(300):
        bench.run(draw.randrange(1, 60))
        chance = draw.random()
        if chance < 0.2 and bench.drives:
            action = draw.choice((Action.ENABLE, Action.DISABLE, Action.HALT, Action.FAULT_RESET))
            with contextlib.suppress(CanopenError):
                robot.axis(action, "all", lambda _error: None)
        elif chance < 0.25:
            for device in bench.drives.values():
                device.drives[0].fault(0x4310, bench.reactor.now())
        elif chance < 0.3:
            bench.power_off(RIGHT) if RIGHT in bench.drives else bench.power_on(RIGHT)
        reported = robot.node_readings.at(bench.reactor.now())
        assert reported == read_anew(robot)
        met |= {(node.nmt_state, node.axes[0].state, node.axes[0].error) for node in reported.values()}
    assert len(met) > 6, met
    bench.close()


def test_events_are_made_into_messages_once_until_one_is_added():
    log = EventLog()
    recent = EventReadings(log)
    log.add(Event(1_000_000_000, "fault", "left", "it is in fault"))
    first = recent.at(0)
    assert [(event.text, event.time) for event in first] == [("it is in fault", 1.0)]
    assert recent.at(0) is first
    log.add(Event(2_000_000_000, "fault", "left", "it is in fault"))
    assert [(event.count, event.time) for event in recent.at(0)] == [(2, 2.0)]
    assert recent.at(500_000_000)[0].time == 2.5
