"""Drives that are known by their identity or their names, and the keys that are proposed for them."""

import re

import pytest
import yaml
from support.makers import folder

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.cli.scan import FoundNode, known_lines
from canopen_control.commissioning.identity import DeviceIdentity
from canopen_control.data_files import data_path
from canopen_control.master.known_drives import known_drive, proposals
from canopen_control.od.eds import read_eds
from canopen_control.od.issues import Severity
from canopen_control.personality import read_personality
from canopen_control.runtime.robot_files import find_robot
from canopen_control.scaffold.bus_text import bus_text
from canopen_control.scaffold.new_robot import Device, plan_robot

ELMO, DELTA, IPOS = 0x9A, 0x1DD, 0x1A3


def of_vendor(vendor, *, product_name=""):
    """Return an edit of an EDS: another vendor id, and a name."""

    def edit(text):
        text = re.sub(r"(?m)^VendorNumber=.*", f"VendorNumber=0x{vendor:X}", text)
        text = re.sub(r"(?m)^ProductName=.*", f"ProductName={product_name or 'drive'}", text)
        return re.sub(r"(\[1018sub1\].*?DefaultValue=)\w+", rf"\g<1>0x{vendor:X}", text, count=1, flags=re.DOTALL)

    return edit


def findings(path):
    return [
        finding
        for finding in check_robot(find_robot(str(path)), CheckOptions()).findings
        if "and such drives need" in finding.text
    ]


@pytest.mark.parametrize(
    ("vendor", "product", "words", "name"),
    [
        (ELMO, 0, "", "elmo"),
        (0xFB, 0x61500000, "", "epos4"),
        (0x286, 0x4F6, "", "tmcm1270"),
        (0x286, 0x1, "", None),
        (0x7777, 1, "some drive", None),
        (0, 0, "ZLTECH ZLAC8015D", "zlac"),
        (0x7777, 1, "ZLTECH ZLAC8015D", "zlac"),
        (0x7777, 1, "Elmo of another vendor", None),
        (0, 0, "", None),
    ],
)
def test_a_drive_is_known_by_its_identity_or_else_by_its_name(vendor, product, words, name):
    result = known_drive(vendor, product, words)
    assert (None if result is None else result.name) == name


def test_what_a_user_has_written_is_not_proposed():
    elmo, delta, ipos = map(read_personality, ("elmo", "delta", "ipos"))
    assert [text for _, text in proposals(elmo, 10_000, (), (), ())] == ["enable_settle_ms: 600"]
    assert list(proposals(elmo, 10_000, {"enable_settle_ms"}, (), ())) == []
    assert [text for _, text in proposals(delta, 4000, (), (), ())] == [
        "sdo: [{index: 0x1006, sub_index: 0, value: 4000}]"
    ]
    assert list(proposals(delta, 4000, {"sdo"}, {0x1006}, ())) == []
    assert list(proposals(ipos, 4000, (), (), {"velocity"})) == []
    assert [text for _, text in proposals(ipos, 4000, (), (), {"position"})] == ["position_mode: 8"]


def test_check_proposes_a_key_with_its_source_and_is_silent_where_it_is_given(tmp_path):
    result = findings(folder(tmp_path, "csp", edit=of_vendor(ELMO)))
    assert {item.severity for item in result} == {Severity.NOTE}
    assert "pan_drive is recognized as Elmo" in result[0].text
    assert "`enable_settle_ms: 600`: set-points count when the brake has lifted (jsd#48)" in result[0].text
    assert findings(folder(tmp_path, "csp", edit=of_vendor(ELMO), keys="enable_settle_ms: 0")) == []
    assert findings(folder(tmp_path, "csp")) == []


@pytest.mark.parametrize(("vendor", "key"), [(ELMO, "# enable_settle_ms: 600"), (DELTA, "value: 20000}]")])
def test_a_new_bus_yml_has_the_keys_as_comments_with_their_sources(tmp_path, vendor, key):
    path = tmp_path / "drive.eds"
    path.write_text(of_vendor(vendor)(data_path("eds", "generic_cia402.eds").read_text()))
    text = bus_text(plan_robot("r", [Device(2, path, read_eds(path, 2).od)]))
    (place,) = [number for number, line in enumerate(text.splitlines()) if key in line]
    assert re.search(r"# (ELMO|DELTA): .* \(.*#\d+.*\):", text.splitlines()[place - 1])
    assert "enable_settle_ms" not in yaml.safe_load(text)["defaults"]
    assert not any(item.get("index") == 0x1006 for item in yaml.safe_load(text)["defaults"]["sdo"])


def test_scan_names_what_is_known_of_drives():
    elmo = DeviceIdentity(device_type=0x20192, vendor_id=ELMO, product_code=1)
    nodes = [FoundNode(3, elmo), FoundNode(4), FoundNode(5, elmo), FoundNode(6, DeviceIdentity(0x191, ELMO))]
    lines = list(known_lines(nodes))
    assert lines[0].startswith("nodes 3, 5 are known as Elmo")
    assert "`enable_settle_ms: 600`" in lines[1]
    assert len(lines) == 2
