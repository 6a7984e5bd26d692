import pytest

from canopen_control.cli.main import main
from canopen_control.data_files import data_names, data_path, foreign_format, read_utf8


def test_the_bundled_robot_and_its_eds_are_there():
    assert "robby" in data_names("config")
    assert "TMCM-1270.eds" in data_names("eds")
    assert data_path("config", "robby").is_dir()
    assert data_path("eds", "TMCM-1270.eds").is_file()


def test_what_is_not_bundled_has_a_path_that_does_not_exist():
    assert not data_path("eds", "nothing.eds").exists()
    assert data_names("nothing") == []


KINDS = {
    b"PK\x03\x04\x14\0\0\0": "a ZIP archive; unpack it, and give the file in it",
    b"\x1f\x8b\x08\0": "compressed by gzip; unpack it, and give the file in it",
    b"%PDF-1.7": "a PDF document, not a text",
    b"\x7fELF\2\1\1\0": "a program, not a text",
    b"abc\0def": "a binary file, not a text",
    b"": "",
    b"[1000]\nParameterName=x\n": "",
    "\ufeff[1000]".encode("utf-16-le"): "",
    "[1000]".encode("utf-16-le"): "",
    b"caf\xe9": "",
}


@pytest.mark.parametrize("data", KINDS)
def test_data_that_are_not_a_text_are_named(data):
    assert foreign_format(data) == KINDS[data]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"PK\x03\x04", "it is a ZIP archive; unpack it"),
        (b"one\ncaf\xe9\n", "byte 0xE9 in line 2 is not UTF-8; save the file as UTF-8"),
        (b"123456", "more than the limit"),
    ],
)
def test_a_text_that_cannot_be_read_is_refused_with_the_reason(tmp_path, data, reason):
    path = tmp_path / "a"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=reason):
        read_utf8(path, 5 if reason.startswith("more") else 100)


#: verb with a file -> the suffix of the file
READERS = {
    "eds show FILE": ".eds",
    "eds pdos FILE": ".dcf",
    "eds convert FILE -o out.xdd": ".eds",
    "init r --eds FILE --node-id 3": ".eds",
    "drive --node-id 3 --eds FILE --can memory:x": ".eds",
    "drive --node-id 3 --eds generic_cia402.eds --can memory:x --scenario FILE": ".yml",
    "drive --buses FILE": ".yml",
    "restore FILE 3 --can memory:x": ".dcf",
    "sdo read 3 0x1000 --can memory:x --eds FILE": ".eds",
    "plan --bus FILE": ".yml",
    "trace --file FILE": ".log",
    "replay FILE": ".asc",
    "report FILE": ".log",
    "export csv FILE": ".log",
    "trajectory play FILE": ".yaml",
    "simulate robby --bus FILE": ".yml",
    "simulate robby --controllers FILE": ".yaml",
    "simulate robby --description FILE": ".urdf",
    "simulate robby --scenario FILE": ".yml",
    "check --launch FILE": ".launch.xml",
}
CONTENTS = {"missing": None, "empty": b"", "binary": bytes(range(256)), "zip": b"PK\x03\x04\x14\0\0\0\0\0"}


@pytest.mark.parametrize("kind", [*CONTENTS, "folder"])
@pytest.mark.parametrize("line", READERS)
def test_a_file_of_another_kind_is_one_sentence_and_exit_code_2(
    line, kind, private_folders, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    name = f"bad{READERS[line]}"
    if kind == "folder":
        (tmp_path / name).mkdir()
    elif (content := CONTENTS[kind]) is not None:
        (tmp_path / name).write_bytes(content)
    assert main([word.replace("FILE", name) for word in line.split()]) == 2
    error = capsys.readouterr().err
    assert error.startswith("canopen-control: ")
    assert name in error
    assert len(error.splitlines()) == 1
    if kind == "zip" and not line.startswith(("trace", "replay", "report", "export")):
        assert "is a ZIP archive; unpack it" in error


@pytest.mark.parametrize("kind", CONTENTS)
def test_eds_check_refuses_a_file_that_is_not_an_eds(kind, tmp_path, capsys):
    path = tmp_path / "bad.eds"
    if CONTENTS[kind] is not None:
        path.write_bytes(CONTENTS[kind])
    assert main(["eds", "check", str(path)]) == 2


def test_an_empty_bus_file_is_one_error(tmp_path, capsys):
    bus = tmp_path / "bus.yml"
    bus.write_text("")
    assert main(["check", "robby", "--bus", str(bus)]) == 2
    errors = [line for line in capsys.readouterr().out.splitlines() if ": error: " in line]
    assert errors == [f"{bus}:1:1: error: no `master` section; it needs at least node_id and sync_period"]
