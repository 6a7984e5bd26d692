"""The verb conform --master: output and exit codes."""

import json
import threading
from xml.etree import ElementTree as Xml

import pytest
from support.lockstep import lockstep
from support.onbus import TMCM, OnBus

from canopen_control.bus.channel import open_port
from canopen_control.cli.main import main
from canopen_control.frame import CanFrame, pack_records

CAN = ["--can", "memory:judged"]


@pytest.fixture
def bus(private_folders):
    with OnBus("memory:judged", {5: TMCM}) as devices:
        yield devices


def test_a_master_is_checked_and_the_reports_name_it(private_folders, capsys, tmp_path):
    page, path = tmp_path / "master.html", tmp_path / "master.xml"
    reports = ["--html", str(page), "--junit", str(path), "--json"]
    with lockstep():
        ended = threading.Event()
        master = threading.Thread(target=_start_nodes, args=(ended,))
        master.start()
        try:
            assert main(["conform", "--master", *CAN, "--node-id", "5", "--for", "0.6", *reports]) == 1
        finally:
            ended.set()
            master.join()
    document = json.loads(capsys.readouterr().out)
    assert (document["node_id"], document["subject"]) == (5, "master")
    observed = {result["id"]: result["observed"] for result in document["results"]}
    assert observed["MC05"].startswith("0x1017 is 0, and no node guarding request was received")
    assert observed["MF08"] == "not tested: the run was too short for this check; allow more time with --for"
    assert "Conformance of the master of node 5" in page.read_text()
    assert Xml.parse(path).getroot().find("testsuite").attrib["name"] == "canopen.node5.master"


def _start_nodes(ended):
    """Be a master that does nothing but start all nodes."""
    port = open_port("memory:judged", label="master")
    while not ended.wait(0.1):
        port.send(pack_records([CanFrame(0, b"\1\0")]))
    port.close()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "give the node-ID of the device to check, or --master"),
        (("5", "--for", "3"), "--for requires --master"),
        (("5", "--master"), "write --node-id 5"),
        (("--master",), "--master needs --node-id"),
        (("--master", "--node-id", "6", "--motion"), "--motion is for the check of a device"),
        (("--master", "--node-id", "5", "--for", "1"), "node-ID 5 already answers"),
        (("--master", "--node-id", "6", "--for", "0.1"), "no master on memory:judged sent anything to node 6 in 0.1 s"),
    ],
)
def test_what_is_wrong_with_a_check_of_a_master_is_one_sentence(bus, capsys, arguments, sentence):
    assert main(["conform", *arguments, *CAN]) == 2
    assert sentence in capsys.readouterr().err
