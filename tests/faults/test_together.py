"""Joints of one base stop together whatever the cause: shafts and targets of both wheels, by either controller."""

import contextlib

import pytest
from support.faultbench import CYCLE_MS, LEFT, RAMP_MS, RIGHT, SPEED, FaultBench
from support.robots import copy_robby

from canopen_control.errors import ControlError, NotEnabled
from canopen_control.hardware.axis_statechart import Action
from canopen_control.virtual.fault_table import FAULTS
from canopen_control.virtual.plant import LoadedPlant

BASE = "robby_base_controller"


class BaseBench(FaultBench):
    """Robby with its base controller, or with the forward one; `drive` commands it straight ahead."""

    base = True

    def command(self, *values, source="test"):
        if self.base:
            self.robot.command(BASE, [0.035 * sum(values) / len(values), 0.0], source)  # wheels of 35 mm
        else:
            super().command(*values, source=source)

    def drive(self, forward=1.0):
        self.command(10.0 * forward, 10.0 * forward)

    def hold_on(self, ms, forward=1.0):
        for _ in range(round(ms / 100)):
            with contextlib.suppress(NotEnabled):  # a publisher does not mind
                self.drive(forward)
            self.run(100)

    def rolling(self):
        self.start()
        self.hold_on(1500)
        assert abs(self.speed(LEFT)) == pytest.approx(SPEED, rel=0.02)
        self.events.clear()
        self.began = self.reactor.now()
        return self


@pytest.fixture
def rolling(request):
    created = []

    def make(base=True, **how):
        which = {"controllers": ["joint_state_broadcaster", BASE]} if base else {}
        bench = BaseBench(f"together{abs(hash(request.node.nodeid)) % 10**9}x{len(created)}", **which, **how)
        bench.base = base
        created.append(bench)
        return bench.rolling()

    yield make
    for bench in created:
        bench.close()


OF_DRIVES = sorted(
    name
    for name, each in FAULTS.items()
    if each.acts not in ("input", "output", "program") and not name.startswith("clock")
)


def targets(bench, node):
    """The velocity targets that the master sent to a drive."""
    can_id = 0x300 + node
    return [
        int.from_bytes(frame.data[4:8], "little", signed=True)
        for label, frame in bench.bus.history
        if label == "master" and frame.can_id == can_id
    ]


@pytest.mark.parametrize("fault", OF_DRIVES)
def test_no_fault_of_one_wheel_leaves_the_other_turning_alone(rolling, fault):
    bench = rolling(base=len(fault) % 2 == 0)
    bench.switch(fault, node=RIGHT)
    alone, longest = 0, 0
    for _ in range(120):  # 2.4 s: three times what the slowest detection and the ramp take
        with contextlib.suppress(ControlError):  # the base controller ends where a wheel is not known any more
            bench.drive()
        bench.run(20)
        speeds = [abs(bench.speed(node)) for node in (LEFT, RIGHT)]
        parted = min(speeds) < 0.01 * SPEED < 0.5 * SPEED < max(speeds)
        alone = alone + 20 if parted else 0
        longest = max(longest, alone)
    # one that faults stands at once or after its own ramp; the other has a ramp, and what detecting it takes
    detect = 600 if fault in ("silent", "bus_off", "heartbeat_lost") else 260
    assert longest <= detect + RAMP_MS, f"one wheel alone for {longest} ms"
    assert (abs(bench.speed(LEFT)) > 1) == (abs(bench.speed(RIGHT)) > 1), "both turn, or none"


@pytest.mark.parametrize("base", [True, False], ids=["base", "forward"])
def test_at_a_limit_switch_both_targets_go_to_zero_in_one_cycle_and_only_the_way_back_is_followed(rolling, base):
    bench = rolling(base)
    bench.bus.clear_history()
    bench.switch("limit_switch", node=RIGHT)
    event, after = bench.collected("limit")
    assert after <= 3 * CYCLE_MS
    assert "positive side" in event.text
    bench.run(CYCLE_MS)
    assert (targets(bench, LEFT)[-1], targets(bench, RIGHT)[-1]) == (0, 0)
    assert bench.stopped_after() <= after + RAMP_MS + 2 * CYCLE_MS
    assert "canopen-control axis enable all" in bench.texts("stop")[-1]
    bench.disabled_after()
    bench.run(3000)
    assert bench.axis(Action.ENABLE) is None
    bench.bus.clear_history()
    bench.hold_on(500)  # on into the limit: refused, and the other wheel stays where it is
    assert set(targets(bench, LEFT)) <= {0}
    assert "beyond its limit" in bench.texts("limit")[-1]
    assert bench.standing()
    bench.run(3000)
    assert bench.axis(Action.ENABLE) is None
    bench.hold_on(1500, -1.0)
    assert bench.speed(RIGHT) < -0.9 * SPEED
    assert bench.speed(LEFT) > 0.9 * SPEED
    assert bench.found("limit_left")


@pytest.mark.parametrize("action", [Action.HALT, Action.DISABLE, Action.QUICK_STOP])
def test_a_verb_for_one_wheel_is_for_the_base_while_its_controller_holds_it(rolling, action):
    bench = rolling()
    bench.bus.clear_history()
    answers = []
    reported = bench.robot.axis(action, "left_drive", answers.append)
    assert reported == (
        f"robby_base_controller moves left_drive and right_drive together: {action.value} applies to all of them"
    )
    assert bench.texts("together") == [reported]
    bench.until(lambda: answers, ms=8000)
    assert answers == [None]
    assert bench.standing()
    bench.hold_on(500)
    assert bench.standing()
    assert bench.axis(Action.ENABLE, "right_drive") is None
    bench.hold_on(1500)
    assert bench.speed(RIGHT) == -bench.speed(LEFT) != 0


def test_a_verb_for_one_axis_is_for_it_alone_while_no_base_controller_holds_it(rolling):
    bench = rolling(base=False)
    answers = []
    assert bench.robot.axis(Action.HALT, "left_drive", answers.append) == ""
    bench.until(lambda: answers)
    assert bench.standing(LEFT)
    assert not bench.standing(RIGHT)
    bench.robot.switch([BASE], ["robby_forward_controller"], strict=True)
    bench.run(2500)
    assert bench.joint(LEFT).base.name == BASE
    bench.robot.switch([], [BASE], strict=True)
    assert bench.joint(LEFT).base is None


def test_of_all_that_are_to_be_enabled_none_is_where_one_cannot_be(rolling):
    bench = rolling()
    bench.switch("drive_fault", node=RIGHT)
    bench.hold_on(2000)
    bench.bus.clear_history()
    assert "fault" in bench.axis_refused(Action.ENABLE)
    assert "fault" in bench.axis_refused(Action.ENABLE, "left_drive")
    bench.hold_on(500)
    assert bench.standing()
    assert not bench.powered(LEFT)
    assert set(targets(bench, LEFT)) <= {0}


def test_of_a_switch_one_drive_that_refuses_keeps_the_other_disabled(rolling):
    bench = rolling(base=False)
    bench.axis(Action.DISABLE)
    bench.switch("local_control", node=RIGHT)
    bench.run(200)
    bench.robot.switch([BASE], ["robby_forward_controller"], strict=True)
    bench.base = True
    bench.hold_on(1000)
    assert bench.standing()
    assert not bench.powered(LEFT)
    assert any("stay disabled" in text for text in bench.texts("not_enabled"))


def test_a_base_is_one_group_whatever_the_description_specifies(rolling, tmp_path):
    old = '<param name="device_name">${side}_drive</param>'
    config = copy_robby(tmp_path, description={old: old + '<param name="stop_group">${side}</param>'})
    bench = rolling(config=config)
    assert bench.joint(LEFT).group is bench.joint(RIGHT).group
    bench.switch("drive_fault", node=RIGHT)
    bench.collected("fault")
    bench.hold_on(2000)
    assert bench.standing()
    assert bench.axis(Action.FAULT_RESET) is not None, "its cause lasts"
    bench.robot.switch([], [BASE], strict=True)
    assert bench.joint(LEFT).group is not bench.joint(RIGHT).group


def _block(bench, node):
    """Block the shaft of a drive, which shows no limit."""
    mover = bench.drives[node].drives[0].mover
    mover.plant = LoadedPlant(position=mover.plant.position, stalled=True)


@pytest.mark.parametrize(("action", "stops"), [("stop", True), ("warn", False)])
def test_a_wheel_that_is_blocked_stops_its_base_within_two_seconds(rolling, tmp_path, action, stops):
    config = copy_robby(tmp_path, bus={"  position_mode": f"  following_error_action: {action}\n  position_mode"})
    bench = rolling(config=config)
    _block(bench, RIGHT)
    bench.hold_on(2500)
    (event,) = bench.found("standing")
    assert (event.time - bench.began) / 1e6 < 1800
    assert bench.standing(LEFT) is stops
    assert ("so the base would leave its path" in event.text) is stops
    assert all(bench.powered(node) is not stops for node in (LEFT, RIGHT))
