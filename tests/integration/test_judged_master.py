"""Our own master as processes, with one drive of robby replaced by the device that checks it."""

import json

import pytest
from support.channel import channel_of
from support.host import eventually
from support.robots import PATIENT_ROBBY, copy_robby

NAME, JUDGED, OTHER = "judged", 2, 3
OF_MACHINE = {"MY06", "MH02"}  # periods, which a busy machine does not keep
LONG_S = 60.0


@pytest.mark.rest
def test_robby_passes_its_boot_and_a_fault(stage, tmp_path):
    channel = channel_of(NAME)
    judge = stage.start("conform", "--master", "--can", channel, "--node-id", JUDGED, "--for", 22, "--json")
    assert eventually(lambda: "is waiting for its master" in judge.err, LONG_S), str(judge)
    stage.drive(NAME, OTHER)
    robot = stage.start("run", copy_robby(tmp_path, bus=PATIENT_ROBBY), "--as", NAME, "--can", channel, "--no-drives")
    robot.until(f"{NAME} runs", LONG_S)
    judge.wait(LONG_S)
    results = {result["id"]: result for result in json.loads(judge.out)["results"]}
    assert {check_id for check_id, result in results.items() if result["verdict"] == "failed"} <= OF_MACHINE
    assert results["MF01"]["verdict"] == results["MW01"]["verdict"] == "passed"
    assert "s: EMCY and FAULT (over-temperature)" in judge.err
