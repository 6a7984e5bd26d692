import importlib.util
import os
from io import StringIO
from types import SimpleNamespace

import pytest

from canopen_control.cli import run
from canopen_control.cli.main import main
from canopen_control.errors import ConfigError
from canopen_control.master.event_log import Event
from canopen_control.view import require_view
from canopen_control.view.page_address import AccessRules, PageAddress


@pytest.fixture(autouse=True)
def as_urgent_as_before(monkeypatch):
    """The verb makes its process nice; this one is not its own."""
    monkeypatch.setattr(os, "nice", lambda _more: 0)


def test_an_address_that_cannot_be_bound_is_a_sentence(mock_robot, capsys):
    pytest.importorskip("nicegui")
    assert main(["view", "--host", "192.0.2.1", "--port", "0"]) == 2
    assert "cannot listen on 192.0.2.1" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["view"], ["run", "robby", "--mock", "--view"]], ids=["view", "run"])
def test_without_nicegui_it_suggests_what_to_type_and_starts_nothing(monkeypatch, capsys, words):
    result = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "nicegui" else result(name, *rest)
    )
    assert main(words) == 2
    output = capsys.readouterr()
    assert "pip install 'canopen-control[view]'" in output.err
    assert output.out == ""


def test_the_address_of_a_page_that_is_served_is_printed_with_its_token(private_folders, capsys):
    assert main(["view", "--address"]) == 1
    assert "no page of a robot is served" in capsys.readouterr().err
    address = PageAddress("robby", "127.0.0.1", 8080)
    rules = AccessRules("127.0.0.1", 8080)
    address.keep(rules)
    assert main(["view", "--address"]) == main(["view", "--address", "--name", "robby"]) == 0
    assert capsys.readouterr().out == f"{rules.url}\n" * 2
    assert main(["view", "--address", "--name", "other"]) == 1
    address.end()


def test_run_prints_the_token_that_the_event_does_not_carry(private_folders):
    address = PageAddress("robby", "127.0.0.1", 8080)
    rules = AccessRules("127.0.0.1", 8080)
    address.keep(rules)
    stream = StringIO()
    announcer = run.Announcer(stream)
    session = SimpleNamespace(robot=SimpleNamespace(nodes={}))
    printer = run._EventPrinter(announcer, session, table=False, prefix="robby: ")
    printer.event(Event(0, "view", "", f"view: {rules.place}"))
    announcer.close()
    assert stream.getvalue() == f"robby: view: {rules.url}\n"
    address.end()


def test_what_is_required_is_named_without_importing_it(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(ConfigError, match=r"pip install 'canopen-control\[view\]'"):
        require_view()
