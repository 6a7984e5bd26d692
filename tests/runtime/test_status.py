import json

import pytest
from support.robots import LEFT, Bench, copy_robby
from support.samples import event_dict, layout_dict, nodes_dict, state_dict, status_dict

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.errors import ControlError
from canopen_control.master.event_log import Event
from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.version import __version__, build


def test_everything_is_plain_json_and_nan_is_none():
    bench = Bench("status", drives=(LEFT,))
    bench.robot.start()
    bench.run(500)
    status = status_dict(bench.robot)
    assert json.loads(json.dumps(status, allow_nan=False)) == status
    missing = status["nodes"]["right_drive"]
    assert (missing["nmt_state"], missing["age_s"], missing["ready"]) == (None, None, False)
    assert missing["axes"][0]["cia402_state"] is None
    assert status["joints"]["right_wheel_joint"]["position"] is None
    assert status["state"] == "starting"
    assert (status["version"], status["build"]) == (__version__, build())
    bench.close()


def test_a_state_sample_is_stamped_in_unix_time_and_lighter_than_the_status():
    bench = Bench("status2")
    bench.start()
    state = state_dict(bench.robot)
    assert abs(state["time"] - (bench.reactor.now() + bench.robot.wall_offset_ns) / 1e9) < 1e-6
    assert "events" not in state
    assert "boot" not in state
    event = event_dict(bench.robot, bench.events[-1])
    assert set(event) == {"time", "kind", "node", "level", "text"}
    emcy = Event(0, "emcy", "left_drive", "in words", details=FaultEvent(error_code=0x4310))
    assert event_dict(bench.robot, emcy)["details"] == {"error_code": 0x4310}
    bench.close()


def test_the_load_of_the_bus_is_known_after_a_second():
    bench = Bench("status3")
    bench.start()
    bench.run(2500)
    load = status_dict(bench.robot)["buses"]["can"]["load"]
    # SYNC and two TPDOs a drive each 20 ms, two RPDOs each 100 ms, three heartbeats: 2 % of 1 Mbit/s
    assert 0.015 < load < 0.035
    state = state_dict(bench.robot)
    assert state["load"] == {"can": load}
    assert state["cycle"]["work_s"] == 0.0  # simulated time stands while a cycle works
    bench.close()


def test_clients_receive_the_bus_and_the_eds_of_a_node():
    bench = Bench("status4")
    listing = nodes_dict(bench.robot)
    assert listing["buses"] == {"can": {"channel": "memory:status4", "node_id": 1}}
    left = next(node for node in listing["nodes"] if node["name"] == "left_drive")
    assert (left["node_id"], left["bus"], left["eds"].rpartition("/")[2]) == (LEFT, "can", "TMCM-1270.eds")
    assert (left["identity"]["vendor_id"], left["identity"]["product_code"]) == (0x286, 0x4F6)
    assert json.loads(json.dumps(listing)) == listing
    bench.close()


def test_subscribers_receive_the_pdo_mappings():
    bench = Bench("status-layout")
    layout = layout_dict(bench.robot)["buses"]["can"]
    assert layout["channel"] == "memory:status-layout"
    assert {node["name"]: len(node["pdos"]) for node in layout["nodes"]} == {"left_drive": 4, "right_drive": 4}
    bench.close()


def test_the_stream_carries_the_odometry_of_an_active_base_controller():
    bench = Bench("status5", controllers=["robby_base_controller"])
    bench.start()
    bench.robot.command("robby_base_controller", [0.2, 0.0], "test")
    bench.run(400)
    before = state_dict(bench.robot)["samples"]["robby_base_controller"]
    assert before["kind"] == "odometry"
    assert before["x"] > 0.005
    assert (before["frame_id"], before["child_frame_id"]) == ("odom", "base_footprint")
    assert before["pose_covariance"] == [0.001, 0.001, 0.001, 0.001, 0.001, 0.01]
    assert abs(before["time"] - (bench.reactor.now() + bench.robot.wall_offset_ns) / 1e9) < 0.05
    assert json.loads(json.dumps(before, allow_nan=False)) == before
    forward = Bench("status6")
    forward.start()
    assert list(state_dict(forward.robot)["samples"]) == ["joint_state_broadcaster"]
    for item in (bench, forward):
        item.close()


def test_a_twist_as_old_as_the_timeout_is_refused_by_its_stamp():
    bench = Bench("status7", controllers=["robby_base_controller"])
    bench.start()
    now = (bench.reactor.now() + bench.robot.wall_offset_ns) / 1e9
    bench.robot.command("robby_base_controller", [0.2, 0.0], "test", now - 0.1)
    with pytest.raises(ControlError, match=r"cmd_vel_timeout is 0\.5 s"):
        bench.robot.command("robby_base_controller", [0.2, 0.0], "test", now - 0.6)
    bench.close()


def test_a_simulation_reports_its_time_and_broadcasters_what_they_gather(tmp_path):
    bench = Bench("status8", config="diffbot_sim", drives=())
    bench.start()
    before = state_dict(bench.robot)["sim_time"]
    bench.run(500)
    assert state_dict(bench.robot)["sim_time"] - before == pytest.approx(0.5, abs=0.03)
    bench.close()
    types = {"io": "canopen_control/GpioBroadcaster", "health": "canopen_control/DiagnosticsBroadcaster"}
    declared = "".join(f"    {name}: {{type: {kind}, interfaces: [position]}}\n" for name, kind in types.items())
    config = copy_robby(
        tmp_path,
        controllers={
            "    robby_forward_controller:\n      type": f"{declared}    robby_forward_controller:\n      type"
        },
    )
    bench = Bench("status9", config=str(config), mock=True, drives=())
    bench.start()
    state = state_dict(bench.robot)
    assert state["sim_time"] is None
    samples = state["samples"]
    assert samples["io"]["parts"] == {f"{side}_wheel_joint": {"position": 0.0} for side in ("left", "right")}
    assert [sample["message"] for sample in samples["health"]["joints"]] == ["operational"] * 2
    assert json.loads(json.dumps(state, allow_nan=False)) == state
    bench.close()


def test_a_node_that_a_command_took_out_reports_this_until_it_is_started():
    bench = Bench("status5", drives=(LEFT,))
    bench.robot.start()
    bench.run(500)
    node = bench.robot.nodes["left_drive"]

    def taken_out():
        return {name: each["taken_out"] for name, each in status_dict(bench.robot)["nodes"].items()}

    assert taken_out() == {"left_drive": False, "right_drive": False}  # one is lost, and booted again and again
    node.command(NmtCommand.ENTER_PRE_OPERATIONAL, bench.reactor.now())
    bench.run(100)
    assert taken_out() == {"left_drive": True, "right_drive": False}
    node.command(NmtCommand.START, bench.reactor.now())
    assert not taken_out()["left_drive"]
    bench.close()
