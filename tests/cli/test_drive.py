from __future__ import annotations

import contextlib
import json
import re
import signal
import subprocess
import sys

import pytest
from support.host import ROOT, use_private_folders
from support.localbus import kill_hub, receive
from support.onbus import TMCM as EDS
from support.onbus import OnBus

from canopen_control.bus.channel import open_port
from canopen_control.cli.drive import _eds_files, _objects, parse_node_ids, run
from canopen_control.cli.main import main
from canopen_control.cli.support.parsers import parser_of
from canopen_control.errors import ConfigError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.sockets import list_sockets
from canopen_control.virtual.control import NodeControl

pytestmark = pytest.mark.process


@pytest.mark.parametrize(
    ("text", "ids"),
    [("3", [3]), ("255", [255]), ("2,3", [2, 3]), ("1-4", [1, 2, 3, 4]), ("1-2, 7,9-10", [1, 2, 7, 9, 10])],
)
def test_node_ids_are_one_several_or_a_range(text, ids):
    assert parse_node_ids(text) == ids


@pytest.mark.parametrize("text", ["", "0", "128", "3-2", "a", "1-", "3,3", "1-5,4", "-1", "1-128"])
def test_other_node_ids_are_refused_with_what_to_write(text):
    with pytest.raises(ConfigError, match="--node-id"):
        parse_node_ids(text)


def test_drives_without_a_node_id_are_processes_of_their_own():
    with pytest.raises(ConfigError, match="255 is only allowed alone: one process per drive"):
        parse_node_ids("255,255")


def drive(*arguments):
    command = [sys.executable, "-m", "canopen_control", "drive", *arguments]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for(process, word):
    for line in process.stdout:
        if word in line:
            return line.strip()
    raise AssertionError(process.stderr.read())


@pytest.fixture
def processes(tmp_path, monkeypatch):
    use_private_folders(monkeypatch, tmp_path)
    started = []

    def start(*arguments):
        started.append(drive(*arguments))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_drive_is_a_process_that_reports_when_it_is_ready_and_ends_cleanly(processes, number):
    process = processes("--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:clidrive")
    assert wait_for(process, "ready") == "drive 3 (TMCM-1270) ready on local:clidrive"
    assert list_sockets("drive") == ["clidrive-3"]
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, ""), out
    assert list_sockets("drive") == []


def test_a_node_id_that_answers_already_is_refused_with_a_sentence(processes):
    first = processes("--node-id", "2,3", "--eds", "TMCM-1270.eds", "--can", "local:clidrive")
    assert wait_for(first, "ready") == "drives 2, 3 (TMCM-1270) ready on local:clidrive"
    second = processes("--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:clidrive")
    out, err = second.communicate(timeout=60)
    assert second.returncode == 1
    assert "node-ID 3 already answers on local:clidrive" in err
    assert "Traceback" not in err + out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--node-id", "3", "--eds", "none.eds", "--can", "local:clidrive"), "none.eds"),
        (("--node-id", "300", "--eds", "TMCM-1270.eds", "--can", "local:clidrive"), "--node-id"),
        (("--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:a:b"), "local:a:b"),
        (
            ("--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:x", "--fault", "sillent"),
            "did you mean 'silent'",
        ),
    ],
)
def test_wrong_usage_is_a_sentence_and_exit_code_2(arguments, words, capsys):
    assert exit_code("drive", *arguments) == 2
    err = capsys.readouterr().err
    assert words in err
    assert "Traceback" not in err


def exit_code(*words):
    """Return the exit code of a command line, which the parser of options raises."""
    try:
        return main([*words])
    except SystemExit as end:
        return end.code


def test_a_local_bus_whose_hub_dies_and_returns_is_joined_again(processes):
    process = processes("--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:cliback")
    wait_for(process, "ready")
    kill_hub("cliback")
    with contextlib.closing(open_port("local:cliback")) as port:
        assert "is back" in wait_for(process, "is back")
        port.send(pack_records([CanFrame(0x603, bytes.fromhex("4000100000000000"))]))
        assert [frame.can_id for frame in receive(port, 1)] == [0x583]
    process.terminate()
    assert process.wait(60) == 0


def test_a_local_bus_whose_hub_is_gone_for_good_ends_it_with_1(processes):
    process = processes("--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:cligone")
    wait_for(process, "ready")
    kill_hub("cligone")
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "hub process has ended" in err
    assert "Traceback" not in err


def test_files_for_store_plant_and_scenario_are_used(processes, tmp_path):
    scenario, plant, store = tmp_path / "s.yml", tmp_path / "p.yml", tmp_path / "store"
    scenario.write_text("steps: [{at: 10ms, node: 3, fault: warning}, {at: 20ms, node: 3, plant: {external: -5}}]")
    plant.write_text('axes: {"3": {kind: loaded}}')
    files = ("--scenario", str(scenario), "--plant", str(plant), "--store", str(store))
    process = processes("--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:clifiles", *files, "--serial", "77")
    wait_for(process, "ready")
    assert "node 3: fault warning on" in wait_for(process, "fault")
    with contextlib.closing(open_port("local:clifiles")) as port:
        save = CanFrame(0x603, bytes.fromhex("2310100173617665"))
        port.send(pack_records([save, CanFrame(0x603, bytes.fromhex("4018100400000000"))]))
        answers = [frame.data for frame in receive(port, 2)]
    assert answers[0][0] == 0x60
    assert answers[1][4:] == (77).to_bytes(4, "little")
    assert store.exists()


@pytest.mark.parametrize("option", ["--scenario", "--plant", "--store"])
def test_errors_in_files_are_reported_before_the_drive_runs(tmp_path, option, capsys):
    path = tmp_path / "wrong.yml"
    path.write_text("nonsense: 5\n")
    words = ["--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:clidrive", option, str(path)]
    assert main(["drive", *words]) == 2
    out, err = capsys.readouterr()
    assert "wrong.yml" in err
    assert "Traceback" not in err
    assert "ready" not in out


@pytest.mark.parametrize(
    ("options", "words"),
    [((), "drive needs --eds FILE"), (("--eds", "TMCM-1270.eds", "--json"), "--json requires drive --status")],
)
def test_missing_facts_that_running_a_drive_needs_are_reported(options, words):
    with pytest.raises(ConfigError, match=words):
        run(parser_of("drive").parse_args(["--node-id", "3", "--can", "local:x", *options]))


def test_a_running_drive_reports_its_status(capsys):
    with OnBus("memory:status", {3: EDS}) as drives:
        control = drives.call(lambda: NodeControl(drives._host, drives.nodes[3]))
        ask = ["--node-id", "3", "--can", "memory:status", "--status"]
        assert run(parser_of("drive").parse_args(ask)) == 0
        assert run(parser_of("drive").parse_args([*ask, "--json"])) == 0
        drives.call(control.close)
    first, second, document = capsys.readouterr().out.splitlines()
    assert first.startswith("node 3, TMCM-1270: ")
    assert second.startswith("  axis 0: SWITCH_ON_DISABLED")
    assert json.loads(document)["axes"][0]["set_points"] is None


@pytest.mark.parametrize(
    ("inputs", "others"),
    [
        (["a.eds"], {}),
        (["a.eds", "3=b.eds"], {3: "b.eds"}),
        (["2=a.eds", "3,4=b.eds"], {2: "a.eds", 3: "b.eds", 4: "b.eds"}),
        (["with=sign.eds"], {}),
    ],
)
def test_nodes_of_one_process_may_have_an_eds_each(inputs, others):
    common, result = _eds_files(inputs, [2, 3, 4])
    assert {node: str(path) for node, path in result.items()} == others
    assert str(common) == inputs[0].removeprefix("2=")


@pytest.mark.parametrize(
    ("inputs", "words"),
    [
        (["3=b.eds"], "no file for node 2"),
        (["a.eds", "b.eds"], "a.eds and b.eds are both for all nodes"),
        (["a.eds", "9=b.eds"], "it is not in --node-id"),
        (["a.eds", "3=b.eds", "2-3=c.eds"], "node 3: another file is given for it"),
    ],
)
def test_an_eds_that_fits_no_node_or_too_many_is_reported(inputs, words):
    with pytest.raises(ConfigError, match=re.escape(words)):
        _eds_files(inputs, [2, 3])


def test_values_in_place_of_those_of_the_eds_are_for_all_nodes_or_for_some():
    texts = ["0x1018:03=5", "3=0x1018:04=0x4D", "2,3=6060=-1"]
    assert _objects(texts, [2, 3]) == {
        2: {(0x1018, 3): 5, (0x6060, 0): -1},
        3: {(0x1018, 3): 5, (0x1018, 4): 77, (0x6060, 0): -1},
    }


@pytest.mark.parametrize(
    "text", ["0x1018:04", "0x1018:04=x", "serial=3", "3=0x1018:04=5=6", "4=0x1018:04=5", "6000:1.3=1"]
)
def test_other_values_are_refused(text):
    with pytest.raises(ConfigError, match=f"--object {text}: .*(write an object and a number|not in --node-id)"):
        _objects([text], [2, 3])


def test_a_wrong_node_id_of_an_object_names_its_option():
    with pytest.raises(ConfigError, match=r"^--object x=0x1018:04=5: 'x' is not a node-ID"):
        _objects(["x=0x1018:04=5"], [2, 3])
