"""Each of the 17 transitions of CiA 402, in every mode, of a drive under this master: seen from the drive's side."""

import pytest
from support.faultbench import FaultBench
from support.generic import MODES, write_generic

from canopen_control.cia402.state import TRANSITIONS, State
from canopen_control.hardware.axis_statechart import Action
from canopen_control.virtual.node_outbox import DriveStateChanged

NUMBERS = {(source, each.target): each.number for each in TRANSITIONS for source in each.sources}
NODE = 2


class Watched(FaultBench):
    """One servo drive; `seen` are the numbers of the transitions it made."""

    victim = NODE

    def watch(self):
        self.seen = []
        host = self.hosts[NODE]
        inner = host.on_event

        def on_event(node, event):
            inner(node, event)
            if isinstance(event, DriveStateChanged):
                self.seen.append(self.number(event.previous, event.state))

        host.on_event = on_event
        return self

    @staticmethod
    def number(source, target):
        if target is State.FAULT_REACTION_ACTIVE:
            return 13
        return NUMBERS.get((source, target), (source, target))

    @property
    def drive(self):
        return self.drives[NODE].drives[0]

    def expect_made(self, *numbers, ms=3000):
        """Wait until these transitions were made, in this order, and forget them."""
        self.until(lambda: set(numbers) <= set(self.seen), ms)
        order = [item for item in self.seen if item in numbers]
        assert order == list(numbers), self.seen
        self.seen.clear()

    def write_controlword(self, word):
        """Let somebody else on the bus write it."""
        done = []
        self.robot.nodes["drive_one"].write(0x6040, 0, word.to_bytes(2, "little"), done.append)
        self.until(lambda: done)
        assert done[0].error is None


@pytest.fixture(params=MODES)
def servo(request, tmp_path):
    """Return a drive in the mode, disabled; its way there were the transitions 1 to 7."""
    config = write_generic(tmp_path, joints=("one",))
    bench = Watched(f"transit{request.param}", config=config, drives=(NODE,), controllers=["velocity"])
    bench.watch()
    bench.start()
    assert bench.seen == [1, 2, 3, 4], "0 is the power-on itself"
    bench.seen.clear()
    bench.robot.switch([], ["velocity"], strict=True)
    bench.expect_made(5, 6, 7)
    assert bench.axis(Action.MODE, "all", mode=request.param) is None
    assert bench.drives[NODE].get(0x6061) == MODES[request.param]
    yield bench
    bench.close()


@pytest.fixture
def machine(servo):
    return servo.joint(NODE).machine


def enable(servo):
    assert servo.axis(Action.ENABLE) is None
    servo.expect_made(2, 3, 4)
    servo.run(50)


def test_2_to_7_up_and_down_again(servo, machine):
    enable(servo)
    assert servo.axis(Action.DISABLE) is None
    servo.expect_made(5, 6, 7)
    servo.run(50)
    assert machine.state is State.SWITCH_ON_DISABLED


def test_11_and_12_a_quick_stop_that_ends_by_itself(servo):
    enable(servo)
    assert servo.axis(Action.QUICK_STOP) is None
    servo.expect_made(11, 12)
    enable(servo)


def test_11_12_and_16_a_quick_stop_that_stays(servo):
    servo.drives[NODE].store.set(0x605A, 0, 6)
    enable(servo)
    assert servo.axis(Action.QUICK_STOP) is None
    servo.expect_made(11)
    assert servo.axis(Action.ENABLE) is None
    servo.expect_made(16)
    assert servo.axis(Action.QUICK_STOP) is None
    assert servo.axis(Action.DISABLE) is None
    servo.expect_made(11, 12)


def test_8_it_is_shut_down_by_another_process(servo, machine):
    enable(servo)
    servo.robot.buses["can"].network.image.refresh = 100  # our own 0x0F, said again, would undo it unseen
    servo.write_controlword(0x06)
    servo.expect_made(8)
    servo.until(lambda: servo.found("enable_lost"))
    servo.until(lambda: machine.state is State.SWITCH_ON_DISABLED)


def test_9_its_voltage_is_taken_while_enabled(servo, machine):
    enable(servo)
    servo.joint(NODE).give_up()
    machine.disable_voltage()
    servo.expect_made(9)


def test_10_its_voltage_is_taken_while_switched_on(servo, machine):
    servo.joint(NODE).enable()
    servo.joint(NODE).group.busy = False  # the group does not permit it
    servo.until(lambda: machine.state is State.SWITCHED_ON)
    servo.joint(NODE).give_up()
    machine.disable_voltage()
    servo.expect_made(2, 3, 10)


def test_13_14_and_15_a_fault_and_its_reset(servo, machine):
    enable(servo)
    servo.switch("drive_fault")
    servo.expect_made(13, 14)
    servo.until(lambda: machine.state is State.FAULT)
    servo.switch("drive_fault", on=False)
    assert servo.axis(Action.FAULT_RESET) is None
    servo.expect_made(15)
    servo.run(500)
    assert servo.seen == [], "no enable after a reset"
    assert machine.state is State.SWITCH_ON_DISABLED
