import pytest
from support.control import BROADCASTER, FORWARD, Hardware, S, add, manager

from canopen_control.controllers.base import Controller
from canopen_control.hardware.interfaces import ReturnType


class Counting(Controller):
    """Notes when it was run, and the period it was told."""

    def __init__(self, name="counting", rate=0):
        super().__init__(name)
        self.update_rate, self.runs = rate, []

    def update(self, now, period):
        self.runs.append((now * 1000 // S, round(period * 1000, 6)))
        return ReturnType.OK


class Telling(Counting):
    is_broadcaster = True


def run(control, cycles, cycle_ms):
    for cycle in range(1, cycles + 1):
        now = cycle * cycle_ms * S // 1000
        control.update(now, cycle_ms / 1000)
        control.broadcast(now, cycle_ms / 1000)


def put(control, *controllers):
    control.running.arrange(controllers, controllers)


def test_nobody_runs_more_often_than_the_managers_update_rate():
    control = manager(Hardware(), rate=10, cycle=0.02)
    commands, tells, slow = Counting(), Telling("tells"), Counting("slow", 5)
    put(control, commands, tells, slow)
    run(control, 16, 20)
    assert commands.runs == tells.runs == [(20, 100.0), (120, 100.0), (220, 100.0), (320, 100.0)]
    assert slow.runs == [(20, 200.0), (220, 200.0)]


@pytest.mark.parametrize("rate", [50, 100, 1000])
def test_at_the_cycles_rate_and_above_it_each_runs_in_every_cycle(rate):
    control = manager(Hardware(), rate=rate, cycle=0.02)
    each = Counting()
    put(control, each)
    run(control, 3, 20)
    assert each.runs == [(20, 20.0), (40, 20.0), (60, 20.0)]


def test_limits_are_enforced_when_the_manager_runs_and_for_its_period():
    class Limiter:
        def __init__(self):
            self.periods = []

        def enforce(self, period):
            self.periods.append(period)

    control = manager(Hardware(), rate=10, cycle=0.02)
    control.limiter = Limiter()
    run(control, 11, 20)
    assert control.limiter.periods == [0.1, 0.1, 0.1]


def test_a_command_is_forgotten_in_the_cycle_in_which_its_drive_goes_off_though_nobody_is_due():
    hardware = Hardware("l/velocity")
    control = manager(hardware, rate=10, cycle=0.02)
    add(control, "left", FORWARD, joints=["l"], interface_name="velocity")
    control.switch(["left"], now=0)
    control.command("left", [3.0], 0)
    run(control, 1, 20)
    assert hardware.values() == [3.0]
    hardware.command_interfaces[0].enabled = False
    control.update(40 * S // 1000, 0.02)
    assert hardware.values() == [0.0]


def test_a_joint_state_is_of_its_update_and_not_of_the_cycle():
    hardware = Hardware(states=("a/position",))
    control = manager(hardware, rate=10, cycle=0.02)
    add(control, "states", BROADCASTER)
    control.switch(["states"], now=0)
    seen = []
    for cycle in range(1, 12):
        hardware.set("a/position", float(cycle))
        control.broadcast(cycle * 20 * S // 1000, 0.02)
        sample = control.running.samples(0)["states"]
        seen.append((round(sample.time * 1000), sample.joints["a"]["position"]))
    assert list(dict.fromkeys(seen)) == [(20, 1.0), (120, 6.0), (220, 11.0)]


def test_the_end_of_a_client_ends_what_it_commands_and_no_more():
    hardware = Hardware("l/velocity", "r/velocity")
    control = manager(hardware, rate=50, cycle=0.02)
    for name, joint in (("left", "l"), ("right", "r")):
        add(control, name, FORWARD, joints=[joint], interface_name="velocity")
    control.switch(["left", "right"], now=0)
    first, second = object(), object()
    control.command("left", [1.0], 0, source="first", holder=first)
    control.command("left", [2.0], 0, source="second", holder=second)
    control.command("right", [3.0], 0, source="nobody's end ends it")
    control.running.let_go(first)
    control.update(S // 50, 0.02)
    assert hardware.values() == [2.0, 3.0]
    control.running.let_go(second)
    control.update(2 * S // 50, 0.02)
    assert hardware.values() == [0.0, 3.0]
