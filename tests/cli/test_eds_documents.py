"""Output of `eds --json` for the bundled file and for each malformed file."""

import json

import pytest
from support.eds import MALFORMED

from canopen_control.cli.eds import changes_of, checked, entry_document, pdo_document, refused
from canopen_control.cli.support.output import json_text
from canopen_control.data_files import data_path
from canopen_control.errors import EdsError
from canopen_control.od.eds import read_eds
from canopen_control.od.pdos import pdos_of
from canopen_control.rpc.wire import plain


@pytest.fixture(scope="module")
def tmcm():
    return read_eds(data_path("eds", "TMCM-1270.eds"))


@pytest.mark.parametrize("path", sorted(MALFORMED.glob("*.eds")), ids=lambda path: path.stem)
def test_whatever_is_in_a_file_has_its_documents(path):
    try:
        file = read_eds(path)
    except EdsError as error:
        report, place = refused(path.name, error), error.line
        file = None
    if file is None:
        assert [(issue.line, issue.code, issue.severity.value) for issue in report.issues] == [
            (place, "not-canopen", "error")
        ]
        return
    report = checked(path.name, file)
    assert report.errors + report.warnings + report.notes == len(report.issues)
    documents = [entry_document(file.od, entry) for entry in file.od]
    assert [load["name"] for load in json.loads(json_text(documents))] == [entry.name for entry in file.od]
    assert [pdo_document(pdo).bits for pdo in pdos_of(file.od)] == [pdo.bits for pdo in pdos_of(file.od)]


def test_an_entry_has_the_stable_json_keys(tmcm):
    entry = plain(entry_document(tmcm.od, tmcm.od[0x607D, 1]))
    assert " ".join(entry) == (
        "index subindex name object object_type data_type access pdo_mappable rpdo_mappable tpdo_mappable default "
        "parameter_value plus_node_id low high line"
    )
    assert (entry["index"], entry["default"], entry["object_type"]) == ("0x607D", -2147483647, "ARRAY")


def test_a_pdo_has_its_identifier_without_and_with_its_flags(tmcm):
    pdo = plain(pdo_document(pdos_of(tmcm.od)[0]))
    assert (pdo["cob_id"], pdo["cob_id_entry"]) == (0x200, 0x40000200)
    assert pdo["mapped"][0] == {"index": "0x6040", "subindex": 0, "bits": 16, "name": "Controlword"}


def test_a_change_reports_which_fields_an_addition_has_none(tmcm):
    other = read_eds(data_path("eds", "TMCM-1270.eds")).od
    del other.entries[0x6040, 0]
    changes = [plain(item) for item in changes_of(tmcm.od, other)]
    assert changes == [{"index": "0x6040", "subindex": 0, "change": "removed", "name": "Controlword"}]
    assert [item.change for item in changes_of(other, tmcm.od)] == ["added"]
    assert list(changes_of(tmcm.od, tmcm.od)) == []
    shifted = tmcm.od.for_node(5)
    fields = {field for item in changes_of(tmcm.od, shifted) for field in item.fields}
    assert fields == {"default"}
