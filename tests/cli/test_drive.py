from __future__ import annotations

import signal
import subprocess
import sys

import pytest
from support.host import ROOT, use_private_folders

from canopen_control.cli.drive import parse_node_ids
from canopen_control.errors import ConfigError
from canopen_control.host.sockets import list_sockets


@pytest.mark.parametrize(
    ("text", "ids"), [("3", [3]), ("2,3", [2, 3]), ("1-4", [1, 2, 3, 4]), ("1-2, 7,9-10", [1, 2, 7, 9, 10])]
)
def test_node_ids_are_one_several_or_a_range(text, ids):
    assert parse_node_ids(text) == ids


@pytest.mark.parametrize("text", ["", "0", "128", "3-2", "a", "1-", "3,3", "1-5,4", "-1", "1-128"])
def test_other_node_ids_are_refused_with_what_to_write(text):
    with pytest.raises(ConfigError, match="--node-id"):
        parse_node_ids(text)


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
def test_a_drive_is_a_process_that_says_when_it_is_ready_and_ends_cleanly(processes, number):
    process = processes("--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:clidrive")
    assert wait_for(process, "ready") == "drive 3 (TMCM-1270) ready on local:clidrive"
    process.send_signal(number)
    out, err = process.communicate(timeout=10)
    assert (process.returncode, err) == (0, ""), out


def test_a_node_id_that_answers_already_is_refused_with_a_sentence(processes):
    first = processes("--node-id", "2,3", "--eds", "TMCM-1270.eds", "--can", "local:clidrive")
    assert wait_for(first, "ready") == "drives 2, 3 (TMCM-1270) ready on local:clidrive"
    second = processes("--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:clidrive")
    out, err = second.communicate(timeout=10)
    assert second.returncode == 1
    assert "node id 3 already answers on local:clidrive" in err
    assert "Traceback" not in err + out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--node-id", "3", "--eds", "none.eds", "--can", "local:clidrive"), "none.eds"),
        (("--node-id", "300", "--eds", "TMCM-1270.eds", "--can", "local:clidrive"), "--node-id"),
        (("--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:a:b"), "local:a:b"),
        (("--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:x", "--fault", "sillent"), "did you mean silent"),
    ],
)
def test_wrong_usage_is_a_sentence_and_exit_code_2(processes, arguments, words):
    process = processes(*arguments)
    _, err = process.communicate(timeout=10)
    assert process.returncode == 2
    assert words in err
    assert "Traceback" not in err


def test_its_control_socket_goes_with_it(processes):
    process = processes("--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:clidrive")
    wait_for(process, "ready")
    assert list_sockets("drive") == ["clidrive-3"]
    process.terminate()
    process.communicate(timeout=10)
    assert list_sockets("drive") == []
