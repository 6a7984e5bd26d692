import importlib.util

import pytest
from support.localbus import end_hubs, open_local

from canopen_control.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--config", "robby"], "--config, --bus and --eds require --can"),
        (["--name", "nobody"], "no robot 'nobody' is running"),
        (["--can", "local:x", "--config", "nowhere"], "nowhere"),
        (["--can", "local:x"], "bus local:x: no program has it open; no local bus is open now"),
    ],
)
def test_what_is_wrong_is_a_sentence_and_exit_code_2(private_folders, arguments, sentence, capsys):
    assert main(["monitor", *arguments]) == 2
    assert sentence in capsys.readouterr().err


@pytest.mark.process
def test_without_a_terminal_it_reports_what_a_script_can_ask(private_folders, capsys):
    port = open_local("x", "other")
    assert main(["monitor", "--can", "local:x"]) == 2
    assert "the monitor needs a terminal; for a script: canopen-control status --json" in capsys.readouterr().err
    port.close()
    end_hubs()


def test_a_robot_and_a_bare_bus_exclude_each_other():
    with pytest.raises(SystemExit) as caught:
        main(["monitor", "--can", "local:x", "--name", "robby"])
    assert caught.value.code == 2


def test_without_textual_it_suggests_what_to_type(monkeypatch, capsys):
    result = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *more: None if name == "textual" else result(name))
    assert main(["monitor"]) == 2
    assert "pip install 'canopen-control[monitor]'" in capsys.readouterr().err
