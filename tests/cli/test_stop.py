from types import SimpleNamespace

import pytest
from support.fake_client import FakeClient

from canopen_control.cli import stop
from canopen_control.cli.main import main
from canopen_control.errors import CanopenError
from canopen_control.rpc.messages.robot import GetStatus
from canopen_control.rpc.messages.state import AxisReading, NodeReading


def test_without_drives_it_reports_that_the_next_command_moves(mock_robot, capsys):
    assert main(["stop"]) == 0
    output = capsys.readouterr().out
    assert output.startswith("stopped; no drive")
    assert "stop --latch" in output
    assert main(["command", "robby_forward_controller", "1", "1", "--once"]) == 0


@pytest.mark.parametrize(
    ("latch", "release", "begin", "end"),
    [
        (False, False, "stopped and disabled", "axis enable all"),
        (True, False, "stopped and disabled, and latched", "stop --release"),
        (False, True, "released, the drives are disabled", "axis enable all"),
    ],
)
def test_with_drives_it_reports_what_it_did_and_how_to_continue(latch, release, begin, end):
    text = stop._done(latch, release, True)
    assert text.startswith(begin)
    assert text.endswith(end)


def test_the_next_step_names_the_robot_that_was_named(mock_robot, capsys):
    assert main(["stop", "--latch", "--name", "mock"]) == 0
    assert capsys.readouterr().out.endswith("canopen-control stop --release --name mock\n")
    assert main(["stop", "--release", "--name", "mock"]) == 0
    assert capsys.readouterr().out.endswith("canopen-control stop --latch --name mock\n")


def test_a_latched_stop_lasts_until_the_release(mock_robot, capsys):
    assert main(["stop", "--latch"]) == 0
    assert "canopen-control stop --release" in capsys.readouterr().out
    assert main(["command", "robby_forward_controller", "1", "1", "--once"]) == 1
    assert "STOP is latched (by canopen-control stop)" in capsys.readouterr().err
    assert main(["stop", "--release"]) == 0
    assert capsys.readouterr().out.startswith("released; ")
    assert main(["stop", "--release"]) == 1
    assert capsys.readouterr().err == "canopen-control: nothing was released, because no STOP of mock is latched\n"
    assert main(["command", "robby_forward_controller", "1", "1", "--once"]) == 0


def test_without_a_name_all_robots_are_stopped(monkeypatch, capsys):
    requests = []

    def request(_args, name):
        requests.append(name)
        if name == "hung":
            raise CanopenError("does not answer")
        return {"robot": name, "stopped": True, "latched": False, "disabled": True}

    monkeypatch.setattr(stop, "find_robots", lambda: ["hung", "one", "two"])
    monkeypatch.setattr(stop, "_request", request)
    assert main(["stop"]) == 1
    output = capsys.readouterr()
    assert sorted(requests) == ["hung", "one", "two"]
    assert output.out.splitlines() == [
        f"{name}: stopped and disabled; to continue: canopen-control axis enable all --name {name}"
        for name in ("one", "two")
    ]
    assert output.err == "canopen-control: hung: does not answer\n"


@pytest.mark.parametrize(
    ("axes", "begin"), [((AxisReading(joint="x"),), "stopped and disabled;"), ((), "stopped; no drive")]
)
def test_a_robot_of_io_modules_has_no_drives(axes, begin, monkeypatch, capsys):
    status = SimpleNamespace(nodes={"io": NodeReading(name="io", node_id=5, axes=axes)})
    client = FakeClient(answers={GetStatus: status})
    client.robot = "lamps"
    monkeypatch.setattr(stop.RobotClient, "connect", lambda _name: client)
    monkeypatch.setattr(stop, "find_robots", lambda: ["lamps"])
    assert main(["stop"]) == 0
    assert capsys.readouterr().out.startswith(begin)
