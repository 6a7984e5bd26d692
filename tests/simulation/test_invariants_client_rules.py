import pytest
from support.mutants import MUTANTS
from support.simulated import Judged

from canopen_control.simulation.invariants import ClientRules


@pytest.fixture
def made():
    robots = []

    def make():
        robots.append(Judged(lambda judged, _views, tell: ClientRules(judged.robot, judged.player.clients, tell)))
        return robots[-1]

    yield make
    robots[-1].close()


@pytest.mark.rest
def test_clients_that_hang_are_no_news(made):
    judged = made()
    judged.do("silent", values=(80.0,)).do("ask", seconds=2.0).do("deaf").run(6.0)
    judged.do("kill", seconds=0.3).run(2.0).do("ask", seconds=1.0).run(2.0)
    assert judged.told == []


def test_a_robot_that_is_stalled_owes_no_answer(made):
    judged = made()
    judged.do("ask").run(0.1).do("stall", "master", 3.0).run(4.0)
    assert judged.told == []


@pytest.mark.sources
@pytest.mark.parametrize(
    ("mutant", "acts", "rule"),
    [
        ("silent_clients_keep_all_places", [("silent", {"values": (80.0,)}), ("ask", {})], "client_waits"),
        ("deaf_clients_are_kept", [("deaf", {})], "client_kept"),
    ],
)
def test_a_server_that_does_not_part_with_a_client_is_told_once(made, monkeypatch, mutant, acts, rule):
    MUTANTS[mutant](monkeypatch)
    judged = made()
    for kind, more in acts:
        judged.do(kind, **more).run(0.1)
    judged.run(5.5)
    assert judged.broken == [rule]


@pytest.mark.sources
def test_a_server_that_waits_for_a_client_is_told(made, monkeypatch):
    MUTANTS["deaf_clients_are_waited_for"](monkeypatch)
    judged = made()
    judged.do("deaf").run(1.0)
    assert judged.broken[0] == "client_blocks"
