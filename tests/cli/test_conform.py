"""The verb conform: output and exit codes."""

import json
import threading
from xml.etree import ElementTree as Xml

import pytest
from support.onbus import TMCM, OnBus

from canopen_control.bus.channel import open_port
from canopen_control.cli.main import main
from canopen_control.frame import CanFrame, pack_records

CAN = ["--can", "memory:conform"]


@pytest.fixture
def bus(private_folders):
    with OnBus("memory:conform", {5: TMCM}) as devices:
        yield devices


def test_a_drive_passes_and_the_reports_hold_every_check(bus, capsys, tmp_path):
    path, page, old = tmp_path / "conform.xml", tmp_path / "conform.html", tmp_path / "old.json"
    assert main(["conform", "5", *CAN, "--timeout", "0.05", "--junit", str(path), "--html", str(page), "--json"]) == 0
    assert "Summary for a buyer" in page.read_text()
    text = capsys.readouterr().out
    old.write_text(text)
    document = json.loads(text)
    assert document["node_id"] == 5
    assert len(document["results"]) > 20
    root = Xml.parse(path).getroot()
    assert root.attrib["failures"] == "0"
    assert len(root.findall("testsuite/testcase")) == int(root.attrib["tests"]) == len(document["results"])
    next(result for result in document["results"] if result["id"] == "S01")["verdict"] = "failed"
    old.write_text(json.dumps(document))
    assert main(["conform", "5", *CAN, "--timeout", "0.05", "--against", str(old)]) == 0
    output = capsys.readouterr().out
    assert "S01 (0x1000 is uploaded expedited with four bytes): failed -> passed" in output
    assert "2 failed" in output  # recommendations: the EDS gives no ramp


def test_what_cannot_be_tested_is_one_sentence_and_exit_code_2(bus, capsys, tmp_path):
    assert main(["conform", "6", *CAN, "--timeout", "0.05"]) == 2
    assert "node 6 on memory:conform does not answer" in capsys.readouterr().err
    assert main(["conform", "5", *CAN, "--configure"]) == 2
    assert "add --yes" in capsys.readouterr().err
    (tmp_path / "no.json").write_text("[1]")
    assert main(["conform", "5", *CAN, "--against", str(tmp_path / "no.json")]) == 2
    assert "is not a report of `conform --json`" in capsys.readouterr().err


def test_a_full_disk_is_one_sentence_after_the_report(bus, capsys):
    assert main(["conform", "5", *CAN, "--timeout", "0.05", "--level", "305", "--junit", "/dev/full"]) == 1
    captured = capsys.readouterr()
    assert "node 5: " in captured.out
    assert captured.err.strip().splitlines()[-1].startswith("canopen-control: /dev/full: No space left on device; ")


def test_a_master_on_the_bus_is_named_and_nothing_is_written(bus, capsys):
    ended = threading.Event()

    def sync():
        port = open_port("memory:conform")
        while not ended.wait(0.05):
            port.send(pack_records([CanFrame(0x80, b"")]))
        port.close()

    thread = threading.Thread(target=sync)
    thread.start()
    try:
        assert main(["conform", "5", *CAN, "--timeout", "0.05", "--configure", "--yes"]) == 2
    finally:
        ended.set()
        thread.join()
    assert "a master is active on memory:conform (SYNC); stop it" in capsys.readouterr().err
