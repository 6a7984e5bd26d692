import pytest

from canopen_control.commissioning.identity import (
    DeviceIdentity,
    KnownEds,
    differences,
    identity_of,
    match_eds,
    read_known,
)
from canopen_control.data_files import data_path
from canopen_control.rpc.messages.robot import NodeIdentity

TMCM, GENERIC = data_path("eds", "TMCM-1270.eds"), data_path("eds", "generic_cia402.eds")


def known(path, revision, vendor=1, product=2):
    return KnownEds(path, vendor, product, revision)


def test_the_identity_is_made_of_what_was_answered():
    data = {
        (0x1000, 0): b"\x92\x01\x02\x00",
        (0x1018, 1): b"\x86\x02\0\0",
        (0x1018, 2): KeyError("the node has none"),
        (0x1018, 3): b"12345",
        (0x1008, 0): b"Servo \xb0\0\0",
    }
    assert identity_of(data) == DeviceIdentity(device_type=0x20192, vendor_id=0x286, device_name="Servo °")
    assert identity_of({}) == DeviceIdentity()


def test_files_report_whom_they_are_for_and_what_is_not_an_eds_is_named(tmp_path):
    broken = tmp_path / "broken.eds"
    broken.write_text("nothing")
    files, refused = read_known([TMCM, GENERIC, broken])
    assert [(eds.path, eds.vendor_id, eds.product_code) for eds in files] == [(TMCM, 0x286, 0x4F6), (GENERIC, 0, 0x402)]
    assert len(refused) == 1
    assert "broken.eds" in refused[0]


def test_a_file_without_a_product_code_matches_no_device(tmp_path):
    anonymous = tmp_path / "anonymous.eds"
    text = "[DeviceInfo]\nVendorNumber=5\n[MandatoryObjects]\nSupportedObjects=1\n1=0x1000\n"
    anonymous.write_text(text + "[1000]\nParameterName=Device type\nObjectType=7\nDataType=7\nAccessType=ro\n")
    assert read_known([anonymous]) == ([], [])


@pytest.mark.parametrize(
    ("revision", "best", "remark"),
    [(7, "b", ""), (3, "a", ""), (5, "b", "for revision 0x00000007"), (None, "b", "for")],
)
def test_vendor_and_product_decide_and_the_revision_chooses(revision, best, remark):
    files = [known("a", 3), known("b", 7), known("c", 7, vendor=9), known("d", 7, product=9)]
    result, text = match_eds(DeviceIdentity(vendor_id=1, product_code=2, revision_number=revision), files)
    assert result.path == best
    assert text == remark or (remark == "for" and text.startswith("for"))


def test_another_device_fits_to_no_file():
    assert match_eds(DeviceIdentity(vendor_id=1, product_code=3), [known("a", 3)]) == (None, "")
    assert match_eds(DeviceIdentity(), [known("a", 3)]) == (None, "")


def test_what_is_not_as_expected_is_reported_and_zero_expects_nothing():
    identity = DeviceIdentity(device_type=0x20192, vendor_id=1, product_code=2, revision_number=3)
    assert differences(identity, NodeIdentity(vendor_id=1, revision_number=3, eds_revision=9)) == []
    assert differences(identity, NodeIdentity(device_type=0x20192, vendor_id=5, serial_number=7)) == [
        "vendor 0x00000005 expected, 0x00000001 reported",
        "serial number 0x00000007 expected, none reported",
    ]
