"""The report page of a run: a verdict per clause, decoded frames, and the summary for buyers."""

from canopen_control.conformance.report import frame_name, html_page
from canopen_control.conformance.run import CHECKS, run_checks
from canopen_control.virtual.quirks import QUIRKS

DOES = {quirk.name: quirk.does for quirk in QUIRKS.values()}


def page_of(node, *ids):
    return html_page(run_checks(node, [check for check in CHECKS if check.id in ids]), DOES, ["a.eds:7: <odd>"])


def test_a_failure_names_its_frames_the_quirk_and_the_key_of_the_bus_file(bench):
    page = page_of(bench(quirks=["remote_never"]), "D01", "D08")
    assert "No mandatory check failed" in page
    assert "<code>remote_never</code>: never sets bit 9" in page
    assert "Key of bus.yml: <code>ignore_remote</code>" in page
    assert "SDO request: upload of 0x6041:00" in page
    assert "will refuse to enable the drive" in page
    assert "recommendation not kept" in page


def test_the_page_needs_no_network_and_escapes_what_it_shows(bench):
    page = page_of(bench(), "S01", "P09")
    assert "http" not in page.replace("<!DOCTYPE html>", "")
    assert "a.eds:7: &lt;odd&gt;" in page
    assert "P09, a remote frame" in page


def test_frames_have_names():
    assert frame_name("1.0 < 585 80 04 10 00 00 00 02 06").startswith("SDO answer: abort of 0x1004:00, 0x06020000 (obj")
    assert frame_name("1.0 < 705 7F") == "HEARTBEAT of node 5"
    assert frame_name("1.0 > 080") == "SYNC"
    assert frame_name("1.0 > 7FF 01") == ""
