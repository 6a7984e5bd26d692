"""trace, record, replay and export with a robot that runs: processes that listen, and change nothing for it."""

import csv
import io
import json
import subprocess
import sys

import pytest
from support.channel import channel_of
from support.host import eventually

from canopen_control.bus.recordings import Recording
from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import GetStatus


@pytest.fixture
def robot(stage):
    return stage.robby("heard")


def test_what_is_recorded_is_reported_as_it_was_reported_live(stage, robot, tmp_path):
    log, dbc = tmp_path / "run.log", tmp_path / "heard.dbc"
    with RobotClient.connect("heard") as client:
        before = client.ask(GetStatus())
    live = stage.start("trace", "--json", "--name", "heard", "--service", "nmt,sdo,emcy,hb,pdo")
    recorder = stage.start("record", "-o", log, "--json", "--name", "heard")
    assert eventually(lambda: '"pdo"' in live.out and log.exists() and log.stat().st_size > 0)
    assert stage.call("sdo", "read", "--name", "heard", "3", "0x1018:1").wait() == 0
    assert stage.call("nmt", "preop", "3", "--name", "heard").wait() == 0
    assert eventually(lambda: "ENTER PRE OPERATIONAL" in live.out)
    assert (recorder.end(), live.end(2)) == (0, 0)
    result = json.loads(recorder.out)
    assert (result["lost"], result["left_out"], result["channel"]) == (0, 0, channel_of("heard"))
    assert result["frames"] == len(list(Recording(log))) > 100

    robots = str(robot.arguments[1])
    reported = stage.call("replay", log, robots, "--json", "--service", "sdo,nmt")
    texts = [json.loads(line)["text"] for line in reported.out.splitlines()]
    assert texts[:2] == [
        "read 0x1018:01 Identity object: Vendor-ID",
        "0x1018:01 Identity object: Vendor-ID = 0x00000286",
    ]
    assert "ENTER PRE OPERATIONAL, node 3 (left_drive)" in texts
    heard_live = [json.loads(line) for line in live.out.splitlines()]
    texts_live = [item["text"] for item in heard_live if item["service"] in ("sdo", "nmt")]
    assert texts_live[: len(texts)] == texts  # it listened a little longer

    assert stage.call("export", "dbc", robots, "-o", dbc).out == f"{dbc}: 2 nodes, 8 PDOs\n"
    table = list(csv.DictReader(io.StringIO(stage.call("export", "csv", log, robots).out)))
    assert {row["node"] for row in table if row["service"] == "pdo"} == {"left_drive", "right_drive"}

    refused = stage.call("replay", log, "--can", channel_of("heard"))
    assert (refused.wait(), refused.out) == (2, "")
    assert "is the bus of the running robot heard" in refused.err
    with RobotClient.connect("heard") as client:
        after = client.ask(GetStatus())
    assert after.cycle.count > before.cycle.count
    assert after.buses["can"].unknown == before.buses["can"].unknown  # no new frames were sent


def test_a_reader_that_leaves_ends_the_trace_quietly(stage, robot):
    trace = subprocess.Popen(
        [sys.executable, "-m", "canopen_control", "trace", "--name", "heard"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert trace.stdout.readline()
    trace.stdout.close()
    assert trace.wait(60) == 0
    assert trace.stderr.read() == ""
    trace.stderr.close()
