from __future__ import annotations

import pytest
from support.host import use_private_folders

from canopen_control.errors import RemoteError
from canopen_control.host.jsonlines import LineServer
from canopen_control.host.reactor import ManualClock, Reactor
from canopen_control.host.sockets import socket_path
from canopen_control.ros.asker import Asker

MS = 1_000_000


class Scene:
    """A robot that answers when it is told to, and somebody who asks, on one reactor with a manual clock."""

    def __init__(self):
        self.reactor = Reactor(ManualClock())
        self.requests, self.answers = [], []
        self.server = LineServer(
            self.reactor, socket_path("robot", "fake"), self.greet, self.on_message, lambda connection: None
        )
        self.asker = Asker("fake", self.reactor, timeout_ns=1000 * MS)

    def greet(self, connection):
        connection.send({"hello": {"robot": "fake"}})

    def on_message(self, connection, message):
        self.requests.append((connection, message))

    def ask(self, method, **params):
        self.asker.ask(method, params, lambda result, error: self.answers.append((method, result, error)))
        self.reactor.run_for(0)

    def answer(self, index, **content):
        connection, message = self.requests[index]
        connection.send({"id": message["id"], **content})
        self.reactor.run_for(0)


@pytest.fixture
def scene(tmp_path, monkeypatch):
    use_private_folders(monkeypatch, tmp_path)
    made = Scene()
    yield made
    made.asker.close()
    made.server.close()
    made.reactor.close()


def test_answers_find_their_questions_in_any_order(scene):
    scene.ask("enable", node="all")
    scene.ask("stop")
    assert scene.requests[0][1]["params"] == {"node": "all"}
    scene.answer(1, result={})
    assert scene.answers == [("stop", {}, None)]
    scene.answer(0, result=[1])
    assert scene.answers[1:] == [("enable", [1], None)]


def test_a_refusal_is_an_answer(scene):
    scene.ask("enable")
    scene.answer(0, error={"kind": "ControlError", "message": "no"})
    assert scene.answers == [("enable", None, "no")]


def test_what_is_not_answered_in_time_is_told_and_a_late_answer_is_nobodys(scene):
    scene.ask("enable")
    scene.reactor.run_for(999 * MS)
    assert scene.answers == []
    scene.reactor.run_for(2 * MS)
    assert scene.answers == [("enable", None, "the robot has not answered")]
    scene.answer(0, result={})
    assert len(scene.answers) == 1


def test_when_the_robot_goes_everybody_is_told_and_so_is_who_asks_later(scene):
    scene.ask("enable")
    scene.server.close()
    scene.reactor.run_for(0)
    scene.ask("stop")
    assert [method for method, _, _ in scene.answers] == ["enable", "stop"]
    assert all("has closed the connection" in error for _, _, error in scene.answers)


def test_what_cannot_be_sent_is_refused_and_the_next_question_goes_on(scene):
    scene.ask("command", values=[float("nan")])
    assert scene.answers[0][2] is not None
    scene.ask("status")
    assert [message["method"] for _, message in scene.requests] == ["status"]


def test_leaving_tells_who_waits_and_twice_is_once(scene):
    scene.ask("enable")
    scene.asker.close()
    scene.asker.close()
    assert scene.answers == [("enable", None, "the bridge has left the robot")]


def test_without_a_robot_there_is_no_asker(scene):
    with pytest.raises(RemoteError):
        Asker("nobody", scene.reactor)
