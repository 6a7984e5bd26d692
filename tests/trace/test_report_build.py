"""The facts of a report, from a robot whose drive loses power."""

import pytest
from msgspec.structs import replace

from canopen_control.frame import EXTENDED_FLAG, CanFrame
from canopen_control.rpc.messages.layout import Layout
from canopen_control.rpc.messages.samples import (
    BatteriesSample,
    BatteryReading,
    GpioSample,
    GripperSample,
    ImuSample,
    JointStatesSample,
    PoseSample,
    RangeSample,
    WrenchSample,
)
from canopen_control.rpc.messages.state import (
    AxisReading,
    CycleTimes,
    JointReading,
    NodeReading,
    RobotEvent,
    StateSample,
    Status,
    TimedSnapshot,
)
from canopen_control.rpc.wire import plain
from canopen_control.trace.flight_file import NO_FAULT, FlightFile, FlightMeta
from canopen_control.trace.network_description import NetworkDescription
from canopen_control.trace.report_build import (
    Spans,
    cycle_of,
    facts_of,
    joints_of,
    measured,
    networks_of,
    node_spans,
    read_frames,
    stopped_after,
)
from canopen_control.trace.report_facts import Span
from canopen_control.trace.report_page import page_of

SAMPLES = {
    "imu": ImuSample(time=1.0, frame_id="i", orientation=(0.0, 0.0, 0.6, 0.8), angular_velocity=(None, None, 0.5),
                     linear_acceleration=(None, None, 9.81)),
    "front": RangeSample(time=1.0, frame_id="f", range=1.25),
    "wrist": WrenchSample(time=1.0, frame_id="w", force=(1.0, None, None), torque=(None, None, 0.25)),
    "gps": PoseSample(time=1.0, frame_id="m", position=(1.0, 2.0, 3.0), orientation=(None,) * 4),
    "power": BatteriesSample(time=1.0, batteries=[BatteryReading(name="main", voltage=24.5, percentage=0.5)],
                             together=BatteryReading(name="")),
    "io": GpioSample(time=1.0, parts={"box": {"lamp": 1.0, "pressed": None}}),
    "gripper": GripperSample(time=1.0, joint="finger", position=0.01, velocity=0.0, effort=None, target=0.04,
                             executing=True, stalled=False, reached_goal=False),
    "states": JointStatesSample(time=1.0, names=("a",), joints={"a": {"position": 1.0}}),
}  # fmt: skip


def test_each_kind_has_its_values_with_their_units():
    rows = {(item.controller, item.what): (item.unit, item.last) for item in measured([StateSample(samples=SAMPLES)])}
    assert rows == {
        **{("imu", f"orientation.{axis}"): ("", value) for axis, value in zip("xyzw", (0, 0, 0.6, 0.8), strict=True)},
        ("imu", "angular_velocity.z"): ("rad/s", 0.5),
        ("imu", "linear_acceleration.z"): ("m/s²", 9.81),
        ("front", "range"): ("m", 1.25),
        ("wrist", "force.x"): ("N", 1.0),
        ("wrist", "torque.z"): ("Nm", 0.25),
        **{("gps", f"position.{axis}"): ("m", value) for axis, value in zip("xyz", (1.0, 2.0, 3.0), strict=True)},
        ("power", "main voltage"): ("V", 24.5),
        ("power", "main percentage"): ("", 0.5),
        ("io", "box/lamp"): ("", 1.0),
        ("gripper", "finger position"): ("rad or m", 0.01),
        ("gripper", "finger target"): ("rad or m", 0.04),
    }


def ranges(*values):
    samples = (RangeSample(time=float(at), frame_id="f", range=value) for at, value in values)
    return [StateSample(time=item.time, samples={"front": item}) for item in samples]


def test_the_least_the_most_and_the_last_are_of_all_publications_and_what_is_not_known_counts_as_nothing():
    (row,) = measured(ranges((1, 2.0), (2, 0.5), (3, None), (4, 1.5)))
    assert (row.least, row.most, row.last) == (0.5, 2.0, 1.5)
    assert measured(ranges((1, None))) == []
    assert measured([TimedSnapshot(time=1.0)]) == []


def test_a_publication_that_two_samples_show_counts_once():
    first, second = ranges((1, 2.0), (1, 3.0))
    assert measured([first, second])[0].last == 2.0


@pytest.fixture
def file():
    meta = FlightMeta(robot="r", reason=NO_FAULT)
    return FlightFile(meta, states=ranges((1, 2.0), (2, 0.5)))


def test_a_report_has_them_in_its_facts_and_on_its_page(file):
    facts = facts_of(file)
    assert [(item.controller, item.least) for item in facts.measured] == [("front", 0.5)]
    page = page_of(facts)
    assert ">Measured<" in page
    assert ">front<" in page
    assert ">Measured<" not in page_of(replace(facts, measured=()))


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
    assert spans.end(5.0) == [Span(0.0, 2.0, "A"), Span(2.0, 3.0, "B"), Span(3.0, 5.0, None)]
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


def test_the_histogram_is_that_of_the_window():
    states = [sample(1, late_counts=[5, 1]), sample(3, late_counts=[100, 3])]
    cycle = cycle_of(states, Status(late_edges_s=[1e-5]))
    assert cycle.late_counts == [95, 2]
    assert cycle.late_edges_s == [1e-5]
    assert cycle.count == 100
    assert cycle_of([], Status(cycle=states[1].cycle)).late_counts == [100, 3]
    assert cycle_of([], None) is cycle_of([], Status()) is None


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


NS = 1_000_000_000


def test_the_load_is_bits_by_the_bit_rate():
    frames = [(NS + n * NS // 1000, "can", CanFrame(0x181, bytes(8))) for n in range(1000)]
    bus = read_frames(frames, {"can": NetworkDescription(bitrate=500_000)}, 1.0, None).buses()["can"]
    assert bus.frames == 1000
    assert bus.services == {"pdo": 1000}
    assert bus.load.time == [0.25, 0.75]
    assert bus.load.value == pytest.approx([(47 + 64) * 1000 / 500_000] * 2, rel=0.01)


def test_heartbeats_report_nmt_states_and_silence():
    beats = [(0, 5), (NS, 5), (2 * NS, 0x7F)]
    frames = [(time, "can", CanFrame(0x703, bytes([state]))) for time, state in beats]
    nodes = read_frames([*frames, (9 * NS, "can", CanFrame(0x80))], {}, 0.0, None).nodes()
    assert [(span.state, span.end) for span in nodes["node 3"].nmt] == [
        ("OPERATIONAL", 2.0),
        ("PRE_OPERATIONAL", 2.0),
        (None, 9.0),
    ]


def test_frames_before_and_after_the_fault_and_the_last_of_each_node(lost_drive):
    begin = lost_drive.frames[0][0] / NS
    facts = read_frames(lost_drive.frames, networks_of(lost_drive), begin, 2.5)
    times = [frame.time for frame in facts.around]
    assert times == sorted(times)
    assert sum(time <= 2.5 for time in times) == 40
    assert sum(time > 2.5 for time in times) == 15
    last = facts.last_words
    assert last[0].node == "left_drive"
    assert last[0].time == pytest.approx(2.0, abs=0.15)
    assert "Statusword" in " ".join(frame.text for frame in facts.around)


def test_a_29_bit_identifier_is_not_taken_for_one_of_11_bits():
    frames = [(n, "can", CanFrame(can_id, b"")) for n, can_id in enumerate((0x183, 0x183 | EXTENDED_FLAG))]
    around = read_frames(frames, {}, 0.0, None).around
    assert [(frame.id, frame.node) for frame in around] == [("183", "node 3"), ("00000183", "")]


EMPTY = FlightMeta(robot="", reason=NO_FAULT)


@pytest.mark.rest
def test_what_went_wrong_first_is_found_and_named(lost_drive):
    facts = facts_of(lost_drive)
    assert facts.fault.node == "left_drive"
    assert 1.9 < facts.fault.at < 3.0
    assert "left_drive" in facts.summary[1]
    assert facts.last_state == "fault"


def test_the_eds_files_in_the_recording_name_the_objects(lost_drive):
    bus = lost_drive.meta.layout.buses["can"]
    nodes = tuple(replace(node, eds="/gone/" + node.eds.rsplit("/", 1)[-1]) for node in bus.nodes)
    lost_drive.meta = replace(lost_drive.meta, layout=Layout({"can": replace(bus, nodes=nodes)}))
    network = networks_of(lost_drive)["can"]
    assert network.notes == ()
    assert network.nodes[3].od.device.product_name
    lost_drive.eds = {}
    assert len(networks_of(lost_drive)["can"].notes) == 2
    assert "no names" in " ".join(facts_of(lost_drive).summary)


def test_facts_are_printed_with_the_stable_json_keys(lost_drive):
    facts = plain(facts_of(lost_drive))
    assert " ".join(facts) == (
        "summary robot begin end seconds channels fault events nodes joints stopped_after_s last_state cycle boot sdo "
        "buses frames last_words gaps measured true_pose"
    )
    assert set(facts["joints"]["left_wheel_joint"]) == set(
        "quantity time command actual error position velocity effort tracking".split()  # noqa: SIM905 - one line
    )
    assert list(facts["nodes"]["left_drive"]["axes"]["left_wheel_joint"][0]) == ["from", "to", "state"]
    assert facts["buses"]["can"]["load"]["value"]
    assert facts["fault"] in facts["events"]
    assert facts["cycle"]["late_counts"]
    assert plain(facts_of(FlightFile(EMPTY)))["cycle"] is None


def test_the_reason_of_the_file_is_the_fault_where_the_window_holds_none(calm_run):
    died = calm_run.states[-1].time
    reason = RobotEvent(time=died, kind="died", level="error", node=None, text="it died")
    calm_run.meta = replace(calm_run.meta, reason=reason)
    assert facts_of(calm_run).fault.text == "it died"


def test_what_is_missing_is_reported(calm_run):
    calm_run.meta = replace(calm_run.meta, unheard=("arm",), frames_lost=7, faults_left_out=3)
    calm_run.unread_lines = 2
    text = " ".join(facts_of(calm_run).summary)
    for words in ("Not recorded: the frames of arm", "7 frames were lost", "2 lines", "3 earlier faults"):
        assert words in text


def test_frames_alone_make_a_report(lost_drive):
    facts = facts_of(
        FlightFile(replace(EMPTY, buses={"can": "run.log"}), frames=lost_drive.frames), networks_of(lost_drive)
    )
    assert facts.nodes["right_drive"].axes["axis 0"]
    assert facts.buses["can"].frames == len(lost_drive.frames)
    unnamed = facts_of(FlightFile(EMPTY, frames=lost_drive.frames), {"can": NetworkDescription()})
    assert "node 3" in unnamed.nodes


@pytest.mark.parametrize("file", [FlightFile(EMPTY), FlightFile(replace(EMPTY, written=5.0, robot="x"))])
def test_an_empty_recording_makes_an_empty_report(file):
    facts = facts_of(file)
    assert facts.seconds == 0
    assert "no node was seen" in facts.summary[0]


def test_without_events_the_first_emcy_is_the_fault(lost_drive):
    times = [time for time, _, _ in lost_drive.frames]
    emcy = (times[500], "can", CanFrame(0x83, bytes.fromhex("3081110000000000")))
    frames = [*lost_drive.frames[:501], emcy, (times[501], "can", emcy[2]), *lost_drive.frames[501:]]
    facts = facts_of(FlightFile(EMPTY, frames=frames), networks_of(lost_drive))
    assert facts.fault.kind == "emcy"
    assert facts.fault.node == "left_drive"
    assert "0x8130" in facts.summary[1]
    assert sum("0x8130" in event.text for event in facts.events) == 1


def test_without_eds_files_in_it_those_of_this_machine_are_read(calm_run):
    calm_run.eds = {}
    assert networks_of(calm_run)["can"].notes == ()
