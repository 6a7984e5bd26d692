"""Each of the 17 transitions of CiA 402, in every mode, of a drive under this master: seen from the drive's side."""

import pytest
from support.faultbench import FaultBench
from support.generic import MODES, write_generic

from canopen_control.cia402.state import TRANSITIONS, State
from canopen_control.hardware.joint import Action
from canopen_control.virtual.events import DriveStateChanged

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

    def made(self, *numbers, ms=3000):
        """Wait until these transitions were made, in this order, and forget them."""
        self.until(lambda: set(numbers) <= set(self.seen), ms)
        order = [each for each in self.seen if each in numbers]
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
    config = write_generic(tmp_path, joints=("one",))
    bench = Watched(f"transit{request.param}", config=config, drives=(NODE,), controllers=["velocity"])
    bench.watch()
    bench.start()
    bench.mode = request.param
    yield bench
    bench.close()


def test_every_transition_is_made_and_followed(servo):
    assert servo.drive.state is State.OPERATION_ENABLED
    assert servo.seen == [1, 2, 3, 4], "0 is the power-on itself"
    servo.seen.clear()
    servo.robot.switch([], ["velocity"], strict=True)
    servo.made(5, 6, 7)
    assert servo.axis(Action.MODE, "all", mode=servo.mode) is None
    assert servo.drives[NODE].get(0x6061) == MODES[servo.mode]
    machine = servo.joint(NODE).machine

    assert servo.axis(Action.ENABLE) is None
    servo.made(2, 3, 4)
    assert servo.axis(Action.QUICK_STOP) is None  # 0x605A = 2: it leaves by itself
    servo.made(11, 12)

    servo.drives[NODE].store.set(0x605A, 0, 6)  # it stays
    assert servo.axis(Action.ENABLE) is None
    servo.made(2, 3, 4)
    assert servo.axis(Action.QUICK_STOP) is None
    servo.made(11)
    assert servo.axis(Action.ENABLE) is None
    servo.made(16)
    assert servo.axis(Action.QUICK_STOP) is None
    assert servo.axis(Action.DISABLE) is None
    servo.made(11, 12)

    assert servo.axis(Action.ENABLE) is None
    servo.made(2, 3, 4)
    machine.disable_voltage()
    servo.joint(NODE).switch_off()
    machine.disable_voltage()
    servo.made(9)
    servo.run(100)

    assert servo.axis(Action.ENABLE) is None
    servo.made(2, 3, 4)
    servo.robot.buses["can"].network.image.refresh = 100  # our own 0x0F, said again, would undo it unseen
    servo.run(50)
    servo.write_controlword(0x06)  # somebody else shuts it down
    servo.made(8)
    servo.until(lambda: servo.found("enable_lost"))
    servo.until(lambda: machine.state is State.SWITCH_ON_DISABLED)
    servo.seen.clear()

    machine.hold(True)
    servo.joint(NODE).enable()
    servo.joint(NODE).group.busy = False  # nobody lets it through
    servo.until(lambda: machine.state is State.SWITCHED_ON)
    machine.disable_voltage()
    servo.joint(NODE).switch_off()
    machine.disable_voltage()
    servo.made(2, 3, 10)
    servo.run(100)

    assert servo.axis(Action.ENABLE) is None
    servo.seen.clear()
    servo.switch("drive_fault")
    servo.made(13, 14)
    servo.until(lambda: machine.state is State.FAULT)
    servo.switch("drive_fault", on=False)
    assert servo.axis(Action.FAULT_RESET) is None
    servo.made(15)
    servo.run(500)
    assert servo.seen == [], "no enable after a reset"
    assert machine.state is State.SWITCH_ON_DISABLED
