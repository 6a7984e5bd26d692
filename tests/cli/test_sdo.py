"""The verb sdo: through a running robot, and directly on a bus."""

import json
import re
import sys
from io import BytesIO, TextIOWrapper

import pytest
from support.liverobot import STRANGER, live_robot
from support.onbus import GENERIC, TMCM, OnBus

from canopen_control.cli.main import main


@pytest.fixture
def bus(private_folders):
    with OnBus("memory:sdo", {3: TMCM, 5: GENERIC}):
        yield ["--can", "memory:sdo"]


@pytest.fixture(scope="module")
def shared_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    folder.chmod(0o700)
    return folder


@pytest.fixture(scope="module")
def robot(shared_folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(shared_folder))
        with live_robot("sdorobot") as drives:
            yield drives


@pytest.fixture
def robby(robot, shared_folder, private_folders, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(shared_folder))
    return robot


@pytest.mark.rest
def test_a_running_robot_has_the_names_and_types_of_each_node(robby, capsys):
    assert main(["sdo", "read", "left_drive", "0x1008"]) == 0
    assert main(["sdo", "read", "3", "Product code"]) == 0
    assert main(["sdo", "read", "3", "60C2:2", "--name", "sdorobot"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        'node 3 (left_drive): 0x1008:00 Manufacturer device name: "TMCM-1270" (9 bytes)',
        "node 3 (left_drive): 0x1018:02 Identity object.Product code: 1270 (0x000004F6)",
        "node 3 (left_drive): 0x60C2:02 Interpolation time period.Interpolation time index: -3 (0xFD)",
    ]


def test_a_value_is_reported_as_trace_reports_it(robby, bus, capsys):
    robby.call(lambda: robby.nodes[3].store.set(0x6060, 0, 3))
    for name in ("Statusword", "0x6502", "0x6060", "1017", "0x1001", "1800:2", "1600:1", "60FF"):
        assert main(["sdo", "read", "left_drive", name]) == 0
    state, *others = [line.partition(": 0x")[2].partition(": ")[2] for line in capsys.readouterr().out.splitlines()]
    assert re.fullmatch(r"\d+ \(0x[0-9A-F]{4}\): [A-Z ]+(, .*)?", state)
    assert others == [
        "165 (0x000000A5): PP, PV, HM, CSP",
        "3 (0x03): 3 PV",
        "100 (0x0064): 100 ms",
        "0 (0x00): no error",
        "1 (0x01): every SYNC",
        "1614807056 (0x60400010): 0x6040:00 Controlword, 16 bits",
        "0 (0x00000000)",
    ]
    assert main(["sdo", "read", "3", "0x6041", *bus]) == 0  # by the profile, unless an EDS differs
    assert "SWITCH ON DISABLED" in capsys.readouterr().out


def test_an_object_named_without_subindex_is_read_whole(robby, bus, capsys):
    for name in ("0x1018", "Identity object"):
        assert main(["sdo", "read", "left_drive", name]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert [line.partition(": ")[2].partition(" ")[0] for line in lines] == [
            f"0x1018:{sub:02X}" for sub in range(5)
        ]
    assert main(["sdo", "read", "left_drive", "0x1018", "--json"]) == 0
    assert [load["subindex"] for load in json.loads(capsys.readouterr().out)] == [0, 1, 2, 3, 4]
    assert main(["sdo", "read", "left_drive", "1018:0"]) == 0
    assert main(["sdo", "read", "3", "1018", *bus]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_what_a_node_refuses_of_an_object_is_reported_and_the_rest_is_read(bus, capsys):
    assert main(["sdo", "read", "3", "0x1003", *bus, "--eds", GENERIC]) == 1  # this node has none of it
    assert capsys.readouterr().err.count("abort 0x06020000") > 1
    assert main(["sdo", "read", "3", "0x60C1", *bus, "--eds", GENERIC]) == 1
    assert main(["sdo", "read", "3", "0x1018", *bus, "--eds", GENERIC]) == 0


def test_what_is_written_through_the_robot_arrives_at_the_drive(robby, capsys):
    assert main(["sdo", "write", "left_drive", "Profile velocity", "1234"]) == 0
    assert capsys.readouterr().out == "node 3 (left_drive): 0x6081:00 Profile velocity: written 1234 (0x000004D2)\n"
    assert robby.call(lambda: robby.nodes[3].get(0x6081)) == 1234


def test_negative_numbers_are_right_by_type(bus, robby, capsys):
    for text in ("-500", "-0x1F4", "0xFFFFFE0C"):
        assert main(["sdo", "write", "5", "0x60FF", text, *bus, "--eds", GENERIC]) == 0
        assert main(["sdo", "read", "5", "0x60FF", *bus, "--eds", GENERIC]) == 0
        written, read = capsys.readouterr().out.splitlines()
        assert written.endswith("written -500 (0xFFFFFE0C)")
        assert read.endswith("Target velocity: -500 (0xFFFFFE0C)")


def test_on_a_bare_bus_a_type_or_an_eds_is_reported_and_reading_needs_neither(bus, capsys):
    assert main(["sdo", "read", "5", "0x1000", *bus]) == 0
    assert main(["sdo", "write", "5", "0x60FF", "-7", "--type", "i32", *bus]) == 0
    assert main(["sdo", "read", "5", "0x60FF", *bus]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "node 5: 0x1000:00: 131474 (0x00020192): profile 402",
        "node 5: 0x60FF:00: written -7 (0xFFFFFFF9)",
        "node 5: 0x60FF:00: 4294967289 (0xFFFFFFF9, signed -7)",
    ]
    assert main(["sdo", "write", "5", "0x60FF", "-7", *bus]) == 2
    assert capsys.readouterr().err == (
        "canopen-control: 0x60FF:00: its EDS is missing; give its type, as in --type u32\n"
    )


def test_json_has_value_and_bytes(robby, capsys):
    assert main(["sdo", "read", "left_drive", "0x60C2:2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "node_id": 3,
        "node": "left_drive",
        "index": 0x60C2,
        "subindex": 2,
        "name": "Interpolation time index",
        "type": "INTEGER8",
        "value": -3,
        "data": "fd",
    }


def test_data_of_another_length_are_shown_and_the_user_is_notified(bus, capsys):
    assert main(["sdo", "read", "5", "0x6041", "--type", "i32", *bus]) == 0
    output = capsys.readouterr()
    assert "INTEGER32 has 4 bytes, not 2; shown without a type" in output.err
    assert output.out.startswith("node 5: 0x6041:00: ")


@pytest.mark.parametrize("length", [0, 3, 100, 50_000])
def test_files_travel_both_ways(bus, tmp_path, capsys, length):
    source, target = tmp_path / "in", tmp_path / "out"
    source.write_bytes(bytes(n % 256 for n in range(length)))
    assert main(["sdo", "download", "5", "0x2000", str(source), *bus]) == 0
    assert main(["sdo", "upload", "5", "0x2000", str(target), *bus]) == 0
    assert target.read_bytes() == source.read_bytes()
    assert capsys.readouterr().out.splitlines() == [
        f"node 5: 0x2000:00: {length} bytes from {source}",
        f"node 5: 0x2000:00: {length} bytes to {target}",
    ]


def test_files_travel_through_a_running_robot_too(robby, tmp_path):
    assert main(["sdo", "upload", "left_drive", "0x1008", str(tmp_path / "name")]) == 0
    assert (tmp_path / "name").read_bytes() == b"TMCM-1270"


def test_a_file_may_be_a_stream(bus, monkeypatch):
    monkeypatch.setattr(sys, "stdin", TextIOWrapper(BytesIO(b"\x00\xff12")))
    assert main(["sdo", "download", "5", "0x2000", "-", *bus]) == 0
    out = TextIOWrapper(BytesIO())
    monkeypatch.setattr(sys, "stdout", out)
    assert main(["sdo", "upload", "5", "0x2000", "-", *bus]) == 0
    assert out.buffer.getvalue() == b"\x00\xff12"


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["read", "3", "0x9999"], 1, "node 3 (left_drive): 0x9999:00: abort 0x06020000 (object does not exist"),
        (["write", "3", "0x6041", "1"], 1, "abort 0x06010002 (attempt to write a read-only object)"),
        (["read", "9", "0x1000"], 2, "robot sdorobot has no node '9'; its nodes: 2 right_drive, 3 left_drive"),
        (["read", "3", "Vendor"], 2, "did you mean 0x1018:01 Vendor-ID?"),
        (["write", "3", "0x6060", "300"], 2, "value 300 is not a valid INTEGER8: the range is -128 to 127"),
        (["write", "3", "0x9999", "1"], 2, "it is not in the EDS; give its type"),
        (["write", "3", "0x6060", "1", "--type", "u9"], 2, "no data type 'u9'"),
        (["read", "3", "0x1000", "--name", "nobody"], 2, "no robot 'nobody' is running; running: sdorobot"),
        (["read", "3", "0x1000", "--eds", "nope.eds"], 2, "no EDS file nope.eds"),
        (["read", "3", "0x1000", "--can", "memory:sdorobot"], 2, "belongs to the running robot sdorobot"),
        (["read", "x", "0x1000", "--can", "memory:sdorobot"], 2, "on a bare bus a node is a number, 1 to 127"),
        (["read", "0", "0x1000", "--can", "memory:sdorobot"], 2, "node-IDs are 1 to 127"),
        (["read", "9", "0x1000", "--can", "memory:sdorobot", "--timeout", "0.05"], 1, "no answer within 0.1 s"),
        (["read", "3", "0x1000", "--can", "nonsense"], 2, "no such CAN interface"),
        (["read", "3", "0x1000", "--timeout", "0"], 2, "not a time in seconds above 0 and up to 60"),
        (["upload", "3", "0x1008", "/nope/x"], 2, "no folder /nope for /nope/x"),
        (["upload", "3", "0x1008", "/dev/full"], 1, "/dev/full: No space left on device; "),
        (["upload", "3", "0x1008", "/"], 2, "/ cannot be written: Is a directory"),
        (["download", "3", "0x1008", "/nope"], 2, "/nope cannot be read: No such file or directory"),
        (["write", "3", "0x6060"], 2, "the following arguments are required: VALUE"),
        ([], 2, "the following arguments are required: ACTION"),
    ],
)
def test_what_does_not_work_is_one_sentence(robby, arguments, code, text, capsys):
    try:
        result = main(["sdo", *arguments])
    except SystemExit as stop:  # argparse
        result = stop.code
    error = capsys.readouterr().err
    assert (result, text in error) == (code, True), error


def test_a_node_that_no_robot_has_is_open_to_everybody(robby, capsys):
    assert main(["sdo", "read", str(STRANGER), "0x1008", "--can", "memory:sdorobot"]) == 0
    assert capsys.readouterr().out == f'node {STRANGER}: 0x1008:00: "Generic CiA 402 servo" (21 bytes)\n'


def test_a_file_that_the_api_does_not_carry_is_refused_before_it_is_sent(robby, tmp_path, capsys):
    big = tmp_path / "big"
    big.write_bytes(bytes(400_001))
    assert main(["sdo", "download", "3", "0x2000", str(big)]) == 2
    assert "more than the 400000 that a running robot can transfer" in capsys.readouterr().err
