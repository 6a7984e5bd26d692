"""The verb of the how-to page, put where verbs are, works as they do."""

import json
import sys

import pytest
from support.documents import EXAMPLES, load
from support.mockrobot import running

from canopen_control.cli.main import main
from canopen_control.cli.verbs import VERBS


@pytest.fixture
def where(monkeypatch):
    monkeypatch.setitem(sys.modules, "canopen_control.cli.where", load(EXAMPLES / "verb_where.py"))
    monkeypatch.setitem(VERBS, "where", "the positions of the joints")


def test_it_reports_the_positions_of_a_robot(where, private_folders, capsys):
    with running("elsewhere"):
        assert main(["where"]) == 0
        assert "left_wheel_joint: 0.000 rad" in capsys.readouterr().out
        assert main(["where", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["right_wheel_joint"] == 0.0


def test_its_help_and_its_errors_are_those_of_any_verb(where, private_folders, capsys):
    with pytest.raises(SystemExit):
        main(["where", "--help"])
    assert "canopen-control where --json" in capsys.readouterr().out
    assert main(["where"]) == 2
    assert "no robot is running" in capsys.readouterr().err
