"""Samples into spans and series."""

import pytest

from canopen_control.rpc.messages.state import AxisReading, CycleTimes, JointReading, NodeReading, Status, TimedSnapshot
from canopen_control.trace.report_build import Spans, cycle_of, joints_of, node_spans, stopped_after
from canopen_control.trace.report_facts import Span


def sample(time, *, mode="PV", state="OPERATION_ENABLED", nmt="OPERATIONAL", late_counts=(), **values):
    axis = AxisReading("wheel", state=state, mode=mode)
    return TimedSnapshot(
        time=time,
        joints={"wheel": JointReading("wheel", **values)},
        nodes={"drive": NodeReading(name="drive", bus="can", node_id=3, nmt_state=nmt, axes=(axis,))},
        cycle=CycleTimes(period_s=0.02, count=50 * time, late_max_s=0.001, work_max_s=0.002, late_counts=late_counts),
    )


def test_a_state_lasts_until_another_is_seen():
    spans = Spans()
    for time, state in ((0.0, "A"), (1.0, "A"), (2.0, "B"), (3.0, None)):
        spans.see(time, state)
    assert spans.end(5.0) == [
        Span(0.0, 2.0, "A"),
        Span(2.0, 3.0, "B"),
        Span(3.0, 5.0, None),
    ]
    assert Spans().end(1.0) == []


def test_spans_of_nodes_begin_at_the_recording():
    nodes = node_spans([sample(100), sample(101, state="FAULT"), sample(103, state="FAULT", nmt=None)], 100)
    assert nodes["drive"].nmt == [Span(0, 3, "OPERATIONAL"), Span(3, 3, None)]
    assert [span.state for span in nodes["drive"].axes["wheel"]] == ["OPERATION_ENABLED", "FAULT"]
    assert node_spans([], 0) == {}


@pytest.mark.parametrize(
    ("mode", "quantity"),
    [("PV", "velocity"), ("CSP", "position"), ("PP", "position"), ("CST", "effort"), (None, "velocity")],
)
def test_a_command_is_compared_with_what_the_mode_makes_of_it(mode, quantity):
    values = {"position": 1.0, "velocity": 2.0, "effort": 3.0}
    joint = joints_of([sample(10, mode=mode, command=5.0, **values)], 10)["wheel"]
    assert joint.quantity == quantity
    assert joint.error == [5.0 - values[quantity]]


def test_what_is_not_known_stays_unknown():
    joint = joints_of([sample(10, velocity=1.0), sample(11, command=1.0)], 10)["wheel"]
    assert joint.error == [None, None]
    assert joint.time == [0, 1]


def test_the_histogram_is_that_of_the_window():
    states = [sample(1, late_counts=[5, 1]), sample(3, late_counts=[100, 3])]
    cycle = cycle_of(states, Status(late_edges_s=[1e-5]))
    assert cycle.late_counts == [95, 2]
    assert cycle.late_edges_s == [1e-5]
    assert cycle.count == 100
    assert cycle_of([], Status(cycle=states[1].cycle)).late_counts == [100, 3]
    assert cycle_of([], None) is cycle_of([], Status()) is None


def test_a_histogram_that_begins_within_the_window_is_taken_as_it_is():
    states = [sample(1), sample(3, late_counts=[100, 3])]
    assert cycle_of(states, None).late_counts == [100, 3]


@pytest.mark.parametrize(
    ("speeds", "expected"),
    [
        ([4.0, 4.0, 2.0, 0.0, 0.0], {"wheel": 2.0}),
        ([4.0, -4.0, 0.01, 0.0, 0.0], {"wheel": 1.0}),
        ([4.0, 4.0, 2.0, 0.0, 1.0], {"wheel": None}),  # it moved again
        ([4.0, 4.0, 0.0, 0.0, 0.0, 3.0], {"wheel": 1.0}),  # it was commanded again later
        ([4.0, 4.0, None, None, None], {"wheel": None}),
        ([0.0, 0.0, 0.0, 0.0, 0.0], {}),
    ],
)
def test_when_a_joint_stood_still(speeds, expected):
    joints = joints_of([sample(time, velocity=speed) for time, speed in enumerate(speeds)], 0)
    assert stopped_after(joints, 1.0) == expected
