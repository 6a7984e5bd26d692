"""The verb eds: output and exit codes."""

import json

import pytest
from support.eds import MALFORMED, eds, section

from canopen_control.cli.eds import changes_of, checked, entry_document, pdo_document, refused, run
from canopen_control.cli.main import main
from canopen_control.cli.support.output import json_text
from canopen_control.cli.support.parsers import parser_of
from canopen_control.data_files import data_path
from canopen_control.errors import EdsError
from canopen_control.od.dcf import write_dcf
from canopen_control.od.eds import read_eds
from canopen_control.od.pdos import pdos_of
from canopen_control.rpc.wire import plain

TMCM = "TMCM-1270.eds"


@pytest.fixture
def cli(capsys):
    def call(*arguments):
        code = run(parser_of("eds").parse_args([str(argument) for argument in arguments]))
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


@pytest.fixture
def cli_json(cli):
    def call(*arguments):
        code, out, _ = cli(*arguments, "--json")
        return code, json.loads(out)

    return call


def malformed(name):
    return MALFORMED / f"{name}.eds"


@pytest.mark.parametrize("name", [TMCM, "generic_cia402.eds"])
def test_the_bundled_files_are_good(cli, name):
    code, out, err = cli("check", name)
    assert (code, err) == (0, "")
    assert out.startswith(f"{name}: ")
    assert out.endswith("entries: no issue\n")


def test_an_error_is_reported_with_its_line_and_exit_code_1(cli):
    code, out, _ = cli("check", malformed("24_my_node_id"))
    assert code == 1
    assert "24_my_node_id.eds:93: error: DefaultValue=$MY_NODE_ID+0x200" in out
    assert out.endswith("10 entries: 1 error\n")


def test_warnings_alone_are_good(cli):
    code, out, _ = cli("check", malformed("39_pdomapping_empty"))
    assert code == 0
    assert ":131: warning:" in out


def test_a_file_that_is_not_an_eds_is_an_error_among_the_others(cli_json):
    code, reports = cli_json("check", TMCM, malformed("44_xdd"))
    assert code == 2
    assert [report["errors"] for report in reports] == [0, 1]
    (issue,) = reports[1]["issues"]
    assert (issue["line"], issue["code"], issue["severity"]) == (1, "not-canopen", "error")
    assert "XDD" in issue["text"]


def test_a_report_in_json(cli_json):
    code, (report,) = cli_json("check", malformed("06_dup_key"))
    assert code == 0
    assert (report["objects"], report["entries"], report["warnings"]) == (6, 10, 1)
    assert report["issues"][0]["line"] == 53


@pytest.mark.parametrize(
    "arguments", [("check", "none.eds", TMCM), ("show", "none.eds"), ("diff", TMCM, "none.eds"), ("pdos", "none.eds")]
)
def test_a_file_that_is_not_there_is_exit_code_2(cli, arguments):
    code, out, err = cli(*arguments)
    assert (code, out) == (2, "")
    assert err == "canopen-control: no such file: none.eds\n"


@pytest.mark.parametrize("arguments", [(), ("check",), ("show",), ("show", TMCM, "--node-id", "128"), ("diff", TMCM)])
def test_wrong_usage_is_exit_code_2(cli, arguments):
    with pytest.raises(SystemExit) as caught:
        cli(*arguments)
    assert caught.value.code == 2


@pytest.mark.parametrize("action", ["show", "pdos"])
def test_a_file_that_is_not_an_eds_cannot_be_shown(capsys, action):
    assert main(["eds", action, str(malformed("43_empty"))]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.endswith("43_empty.eds:1: is empty\n")


def test_one_value_is_shown_with_type_access_default_and_mappability(cli):
    code, out, _ = cli("show", TMCM, "607D:1")
    assert code == 0
    header, row = out.splitlines()
    assert header.split() == ["address", "name", "type", "access", "PDO", "default", "limits"]
    assert row.split("  ")[0] == "0x607D:01"
    assert row.split()[-5:] == ["INTEGER32", "rw", "-", "-2147483647", "-"]
    assert cli("show", TMCM, "60FF")[1].splitlines()[1].split()[-3] == "RT"
    assert cli("show", TMCM, "0x1600:0")[1].splitlines()[1].split()[-1] == "0..3"


def test_a_dcf_is_shown_with_defaults_and_parameter_values_apart(cli, tmp_path):
    path = tmp_path / "a.dcf"
    write_dcf(path, read_eds(data_path("eds", TMCM)).od, 3, 1_000_000, {(0x6083, 0): 16000})
    header, row = cli("show", path, "6083")[1].splitlines()
    assert header.split("  ")[-1].strip() == "limits"
    assert "parameter value" in header
    assert row.split()[-2:] == ["0x00003E80", "-"]
    assert row.split()[-3] == cli("show", TMCM, "6083")[1].splitlines()[1].split()[-2]
    assert "parameter value" not in cli("show", TMCM, "6083")[1]


def test_a_whole_object_and_a_whole_file_are_shown(cli):
    assert len(cli("show", TMCM, "0x1018")[1].splitlines()) == 1 + 5
    assert len(cli("show", TMCM)[1].splitlines()) == 1 + 243


@pytest.mark.parametrize(
    ("name", "rows"),
    [("Target velocity", 1), ("TARGET VELOCITY", 1), ("Identity object", 5), ("Identity object.Serial number", 1)],
)
def test_objects_have_names_for_people(cli, name, rows):
    code, out, _ = cli("show", TMCM, name)
    assert (code, len(out.splitlines())) == (0, 1 + rows)


def test_an_object_that_is_not_there_is_exit_code_1_with_a_hint(cli):
    code, out, err = cli("show", TMCM, "velocity actual")
    assert (code, out) == (1, "")
    assert "no object 'velocity actual'; did you mean 0x606C Velocity actual value?" in err
    assert cli("show", TMCM, "603F")[0] == 1


def test_the_node_id_is_left_open_or_filled_in(cli, cli_json):
    assert "$NODEID+0x40000200" in cli("show", TMCM, "1400:1")[1]
    assert "0x40000205" in cli("show", TMCM, "1400:1", "--node-id", "5")[1]
    _, (entry,) = cli_json("show", TMCM, "1400:1")
    assert (entry["default"], entry["plus_node_id"]) == (0x40000200, True)
    _, (entry,) = cli_json("show", TMCM, "1400:1", "--node-id", "5")
    assert (entry["default"], entry["plus_node_id"]) == (0x40000205, False)


def test_values_that_json_lacks_are_text(cli_json, tmp_path):
    path = tmp_path / "a.eds"
    path.write_text(eds(data_type=8, DefaultValue="0x7FC00000") + eds("2001", data_type=15, DefaultValue="01 02"))
    _, entries = cli_json("show", path)
    assert [entry["default"] for entry in entries] == ["0x7FF8000000000000", "0102"]


def test_files_with_the_same_objects_are_stated_to_be_equal(cli, cli_json):
    assert cli("diff", TMCM, TMCM) == (0, f"{TMCM} and {TMCM}: 243 entries, equal\n", "")
    assert cli_json("diff", TMCM, TMCM) == (0, [])


def test_differences_are_reported_value_by_value(cli, cli_json, tmp_path):
    a, b = tmp_path / "a.eds", tmp_path / "b.eds"
    a.write_text(eds("2000", DefaultValue=1) + eds("2001"))
    b.write_text(eds("2000", DefaultValue=2, data_type=6, name="Other") + eds("2002"))
    code, out, _ = cli("diff", a, b)
    assert code == 1
    assert out.splitlines() == [
        "~ 0x2000:00 Other: name Thing -> Other, data_type UNSIGNED32 -> UNSIGNED16, default 1 -> 2",
        "- 0x2001:00 Thing",
        "+ 0x2002:00 Thing",
    ]
    code, changes = cli_json("diff", a, b)
    assert (code, [change["change"] for change in changes]) == (1, ["changed", "removed", "added"])
    assert changes[0]["fields"]["default"] == {"a": 1, "b": 2}


def test_the_map_of_the_pdos_with_bits_used_of_64(cli, cli_json):
    code, out, _ = cli("pdos", TMCM)
    assert code == 0
    assert "RPDO4  off  500+node  type 254  48 of 64 bits, 3 slots" in out.splitlines()
    assert "    0x60FF:00  32 bits  Target velocity" in out.splitlines()
    assert "RPDO3  on   403  type 255  48 of 64 bits, 3 slots" in cli("pdos", TMCM, "--node-id", "3")[1].splitlines()
    _, pdos = cli_json("pdos", TMCM, "--node-id", "3")
    assert [pdo["bits"] for pdo in pdos] == [16, 24, 48, 48] * 2
    assert (pdos[3]["enabled"], pdos[3]["cob_id"], pdos[3]["cob_id_entry"]) == (False, 0x503, 0xC0000503)


def test_pdos_that_are_not_whole_are_shown_too(cli, tmp_path):
    path = tmp_path / "a.eds"
    mapping = section("1600", ParameterName="M", ObjectType=9)
    mapping += eds("1600sub1", DefaultValue="0x00050008") + eds("1600sub2", DefaultValue="0x60400010")
    path.write_text(mapping)
    assert cli("pdos", path)[1].splitlines() == [
        "RPDO1  off  no COB-ID  type ?  24 of 64 bits, 2 slots",
        "    0x0005:00   8 bits  dummy",
        "    0x6040:00  16 bits  (not in the file)",
    ]


def test_a_conversion_names_the_values_that_the_new_format_cannot_have(tmp_path, capsys):
    dcf, eds, again = (str(tmp_path / name) for name in ("a.dcf", "b.eds", "c.dcf"))
    text = data_path("eds", TMCM).read_text(encoding="latin-1").replace("[6081]", "[6081]\nParameterValue=7", 1)
    (tmp_path / "a.dcf").write_text(text, encoding="latin-1")
    assert main(["eds", "convert", dcf, "-o", eds]) == 0
    assert f"{eds}: without ParameterValue (1 in the input); .dcf and .xdc include it" in capsys.readouterr().out
    assert main(["eds", "convert", dcf, "-o", again, "--node-id", "3"]) == 0
    assert "without the" not in capsys.readouterr().out


def test_a_file_is_converted_to_the_format_of_the_outputs_ending(tmp_path, capsys):
    xdd, eds, xdc = (str(tmp_path / name) for name in ("a.xdd", "b.eds", "c.xdc"))
    assert main(["eds", "convert", TMCM, "-o", xdd]) == 0
    assert main(["eds", "convert", xdd, "-o", eds]) == 0
    assert main(["eds", "diff", TMCM, eds]) == 0
    assert main(["eds", "convert", xdd, "-o", xdc, "--node-id", "3"]) == 0
    assert read_eds(xdc).od.node_id == 3
    capsys.readouterr()
    for words, complaint in (
        ([xdd, "-o", xdc], "c.xdc already exists; choose another name, or --force"),
        ([xdd, "-o", f"{xdc}2"], "the suffix chooses the format, and must be one of: .eds, .dcf, .xdd, .xdc"),
        ([xdd, "-o", str(tmp_path / "d.dcf")], "a.xdd has no node-ID; give --node-id N"),
        ([xdd, "-o", str(tmp_path / "no" / "d.eds")], "cannot be written: no such folder"),
    ):
        assert main(["eds", "convert", *words]) == 2
        assert complaint in capsys.readouterr().err


# Output of `eds --json` for the bundled file and for each malformed file.


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
