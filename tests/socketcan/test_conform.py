"""The verb conform on the CAN of a real kernel."""

import json

import pytest
from support.guest import scaled

pytestmark = pytest.mark.socketcan
CONFIGURED_S = 60.0  # three times a run with --configure


def test_a_drive_on_the_kernels_can_keeps_every_mandatory_clause(stage, vcan):
    drive = stage.start("drive", "--node-id", 3, "--eds", "TMCM-1270.eds", "--can", vcan)
    drive.until("ready on")
    options = ("--can", vcan, "--eds", "TMCM-1270.eds", "--level", 301, "--configure", "--yes", "--json")
    checked = stage.call("conform", 3, *options, "--timeout", scaled(0.5), seconds=scaled(CONFIGURED_S))
    results = json.loads(checked.out)["results"]
    failed = [
        (result["id"], result["observed"])
        for result in results
        if result["verdict"] == "failed" and result["level"] == "must"
    ]
    assert failed == []
    assert sum(result["verdict"] == "passed" for result in results) >= 100
