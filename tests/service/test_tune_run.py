import pytest

from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.robot import MappedValue, ProcessData
from canopen_control.rpc.messages.state import AxisReading, CycleTimes, JointReading, NodeReading, StateSample
from canopen_control.service.driven_axis import JogDrive
from canopen_control.service.jog_motion import JogEnd, JogKind, JogLimits
from canopen_control.service.tune_run import Step, TuneMotion, TuneRecord, TuneRun

DRIVE = JogDrive("jog_5", "drive", "joint", "controller", "CSV")
LIMITS = JogLimits(6.0, 10.0, 500.0)


def tune(effort_unit=1000.0):
    return TuneRun(DRIVE, JogKind.VELOCITY, Step(3.0, 2.0), LIMITS, deceleration=20.0, effort_unit=effort_unit)


def sample(cycle, effort=None, state="OPERATION_ENABLED"):
    return StateSample(
        nodes={"drive": NodeReading(node_id=5, axes=(AxisReading("joint", state=state),))},
        joints={"joint": JointReading("joint", 0.1, 0.2, effort, 3.0)},
        cycle=CycleTimes(0.01, cycle - 1, 1),
    )


def motion():
    return TuneMotion(JogKind.VELOCITY, Step(3.0, 2.0), LIMITS, now=0)


def test_a_sample_is_kept_with_its_cycle_and_its_torque_in_per_mille():
    record, run = TuneRecord(0.01), tune()
    run._take(sample(7, 0.25), motion(), record)
    run._take(sample(9, 0.25), motion(), record)
    assert [(each.cycle, each.effort, each.command) for each in record.samples] == [(7, 250.0, 3.0), (9, 250.0, 3.0)]
    assert record.lost == 1


def test_a_torque_of_unknown_unit_is_no_torque():
    record = TuneRecord(0.01)
    tune(None)._take(sample(7, 0.25), motion(), record)
    assert record.samples[0].effort is None


@pytest.mark.parametrize(
    ("effort", "state", "why"), [(0.6, "OPERATION_ENABLED", JogEnd.CURRENT), (0.1, "FAULT", JogEnd.STATE)]
)
def test_current_and_state_of_a_sample_end_it(effort, state, why):
    moved = motion()
    for cycle in (7, 8):
        tune()._take(sample(cycle, effort, state), moved, TuneRecord(0.01))
        moved.tick(cycle * 10**8)
    tune()._take(sample(9, effort, state), moved, TuneRecord(0.01))
    assert moved.ended is why


def test_a_refused_command_ends_it():
    class Refusing:
        def ask(self, request, timeout=None):
            raise RemoteError("NotEnabled", "off")

    class Taking:
        def __init__(self):
            self.asked = []

        def ask(self, request, timeout=None):
            self.asked.append(request)
            return Done()

    run, moved = tune(), motion()
    run._told = True
    moved.tick(10**9)
    run._command(taking := Taking(), moved)
    assert (taking.asked[0].values, taking.asked[0].dead_man, taking.asked[0].source) == ([3.0], True, "tune")
    moved.tick(int(1.5e9))
    run._sender._sent = 0.0
    run._command(Refusing(), moved)
    assert moved.ended is JogEnd.STATE


def test_a_torque_that_a_tpdo_carries_is_that_of_the_sample_before_it():
    def data(value):
        return ProcessData(0.0, {"drive": [MappedValue(0x6077, 0, value.to_bytes(2, "little", signed=True))]})

    record, run, moved = TuneRecord(0.01), tune(None), motion()
    run._take(sample(7), moved, record)
    run._take_torque(data(-120))
    run._take(sample(8), moved, record)
    run._take_torque(ProcessData(0.0, {"other": []}))
    run._take(sample(9), moved, record)
    run._take_torque(data(300))
    run._keep_torque(record)
    assert [each.effort for each in record.samples] == [-120.0, -120.0, 300.0]
