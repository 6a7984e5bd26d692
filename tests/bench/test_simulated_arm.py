"""The arm in simulated time: a host that is late is late alone, and an adapter hands frames over on its grid."""

from contextlib import closing

import pytest
from canopen_control_bench.arm import ENDS, NODES, arm_at
from canopen_control_bench.simulated_arm import MS, PPM, STEP_NS, SimulatedArm

from canopen_control.errors import CanopenError

OTHER = "\n  sync_producer: other\n  sync_order: first"


@pytest.fixture
def arm(tmp_path):
    with closing(SimulatedArm("simulated", arm_at(tmp_path, 100, OTHER), own_sync=False)) as made:
        yield made


def test_drives_and_their_sync_go_on_while_the_host_is_late(arm):
    at = []
    arm.robot.after_cycle.append(lambda now: at.append((now, arm.robot.pacer.edge)))
    arm.late = lambda: 3 * MS
    arm.measure_anew()
    arm.run(200)
    assert {now - edge for now, edge in at[2:]} == {3 * MS}
    syncs = [frame for _, frame in arm.bus.history if frame.can_id == 0x80]
    assert len(syncs) == pytest.approx(200 / (10 * (1 + PPM / 1e6)), abs=1)
    answers = [frame for _, frame in arm.bus.history if frame.can_id == 0x180 + NODES[0]]
    assert len(answers) == len(syncs)


def test_frames_are_handed_over_on_the_grid_of_the_adapter(arm):
    sent_at = set()
    hand_over = arm._hand_over
    arm._hand_over = lambda begin, end: (sent_at.add(arm.now), hand_over(begin, end))
    arm.batch_ns = MS
    arm.run(20)
    assert len(sent_at) == 20
    assert {each % MS for each in sent_at} == {0}
    arm.batch_ns = STEP_NS
    arm.run(1)
    assert len(sent_at) == 30


def test_what_a_callback_raises_and_what_takes_too_long_is_told(arm):
    with pytest.raises(CanopenError, match="not within 20 ms"):
        arm.until(lambda: False, 20)
    arm.field.call_soon(lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        arm.run(1)


def test_a_goal_that_fails_is_no_motion_to_measure(arm):
    arm.play([0.1 * each for each in ENDS], 0.3)
    assert {arm.quality(node).missed for node in NODES} == {0}
    arm.bus.cut("adapter")
    with pytest.raises(CanopenError, match="the goal was aborted"):
        arm.play([0.0] * 6, 0.3)
