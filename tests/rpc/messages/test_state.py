from msgspec.structs import asdict

from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.rpc.messages.state import (
    AxisReading,
    ControllerReading,
    JointReading,
    NodeReading,
    RobotEvent,
    Snapshot,
    StateSample,
    Status,
)
from canopen_control.rpc.wire import convert, plain


def test_the_wire_has_the_names_of_the_field():
    axis = plain(AxisReading("wheel", state="FAULT"))
    assert (axis["cia402_state"], "state" in axis) == ("FAULT", False)
    node = plain(NodeReading(name="left", node_id=3, age=0.5))
    assert (node["age_s"], node["sdo"], node["axes"]) == (0.5, {"reads": 0, "writes": 0, "failed": 0}, [])
    assert plain(ControllerReading(name="c", type="t", state="active", claims=("a/velocity",)))[
        "claimed_interfaces"
    ] == ["a/velocity"]


def test_an_event_reports_only_what_there_is_to_report():
    event = RobotEvent(time=2.0, kind="emcy", node=None, level="info", text="t")
    assert plain(event) == {"time": 2.0, "kind": "emcy", "node": None, "level": "info", "text": "t"}
    assert event.first == 2.0
    several = RobotEvent(
        time=9.0, kind="emcy", node="a", level="info", text="t", count=3, since=2.0, details=FaultEvent(error_code=1)
    )
    assert several.first == 2.0
    assert plain(several)["details"] == {"error_code": 1}


def test_a_joint_has_its_interfaces_by_name():
    joint = JointReading("wheel", 1.0, 2.0, None, 3.0, {"temperature": 40.0})
    assert [joint.value(name) for name in ("position", "velocity", "effort", "temperature", "other")] == (
        [1.0, 2.0, None, 40.0, None]
    )
    assert joint.values == {"position": 1.0, "velocity": 2.0, "effort": None, "temperature": 40.0}


def test_a_controller_is_known_by_its_width_topics_and_state():
    controller = ControllerReading(
        name="c", type="t", state="inactive", claims=("a/x",), publishes=("c/joint_states", "c/dynamic_joint_states")
    )
    assert (controller.width, controller.active, controller.became("active").active) == (1, False, True)
    assert controller.published("joint_states") == "c/joint_states"
    assert controller.published("states") is None


def test_a_sample_and_a_status_share_what_both_report():
    document = {"state": "running", "controllers": {"a": "active", "b": "inactive"}, "time": 1, "unknown": 1}
    assert convert(document, StateSample).active == convert(document, Status).active == ["a"]


def test_a_snapshot_grows_into_a_message_with_all_its_fields():
    snapshot = Snapshot(state="running", hint="why", latched=True, latched_by="me", controllers={"base": "active"})
    status = snapshot.grown(Status, robot="robby")
    assert {name: getattr(status, name) for name in Snapshot.__struct_fields__} == asdict(snapshot)
    assert (status.robot, status.build) == ("robby", "")
