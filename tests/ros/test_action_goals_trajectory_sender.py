from __future__ import annotations

import pytest
from support.endpoints import Client

from canopen_control.errors import RemoteError
from canopen_control.ros.action_goals import HEARTBEAT_S, TrajectorySender
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.rpc.messages.trajectory import SetTrajectory, TrajectoryData, TrajectoryHeartbeat


class Scene:
    def __init__(self):
        self.clients, self.answers = [], []
        self.sender = TrajectorySender(self.connect)

    def connect(self):
        self.clients.append(Client())
        return self.clients[-1]

    def send(self, *pieces):
        def request(points):
            return SetTrajectory(controller="arm", joints=["a"], points=points)

        self.sender.send(iter(pieces), request, lambda *answer: self.answers.append(answer))

    def answer(self, result=None, error=None):
        self.clients[-1].asked[-1][1](result, error)


@pytest.fixture
def scene():
    return Scene()


def piece(*times):
    return [TrajectoryPoint(time_from_start=time) for time in times]


def times(request):
    return [point.time_from_start for point in request.points]


def test_a_piece_is_sent_when_the_one_before_was_answered_and_the_last_one_with_the_request(scene):
    scene.send(piece(1.0), piece(2.0), piece(3.0))
    for count, kind in enumerate((TrajectoryData, TrajectoryData, SetTrajectory), 1):
        requested = scene.clients[0].asked
        assert (len(requested), type(requested[-1][0]), times(requested[-1][0])) == (count, kind, [float(count)])
        assert scene.answers == []
        scene.answer(Done())
    assert scene.answers == [(Done(), None)]


def test_trajectories_after_one_another_share_their_connection_until_it_is_closed(scene):
    scene.send(piece(1.0))
    scene.answer(Done())
    scene.send(piece(2.0))
    assert len(scene.clients) == 1
    scene.sender.close()
    scene.sender.close()
    assert scene.clients[0].closed == 1
    scene.send(piece(3.0))
    assert len(scene.clients) == 2


def test_a_connection_reports_that_the_bridge_is_at_work_several_times_within_what_is_promised(scene):
    scene.send(piece(1.0))
    scene.answer(Done())
    scene.send(piece(2.0))
    ((text, every_ns),) = scene.clients[0].said
    assert isinstance(text, TrajectoryHeartbeat)
    assert every_ns * 4 < HEARTBEAT_S * 1e9


def test_a_piece_that_is_refused_is_the_answer(scene):
    scene.send(piece(1.0), piece(2.0))
    scene.answer(None, "too many")
    assert scene.answers == [(None, "too many")]


def test_what_is_wrong_with_the_first_piece_is_the_answer_and_nothing_is_sent(scene):
    def wrong():
        raise ValueError("a nan")
        yield

    scene.sender.send(wrong(), None, lambda *answer: scene.answers.append(answer))
    assert (scene.answers, scene.clients) == ([(None, "a nan")], [])


def test_an_invalid_later_file_clears_the_earlier_ones(scene):
    def wrong():
        yield piece(1.0)
        yield piece(2.0)
        raise ValueError("a nan")

    scene.sender.send(wrong(), None, lambda *answer: scene.answers.append(answer))
    scene.answer(Done())
    assert scene.answers == [(None, "a nan")]
    assert scene.clients[0].closed == 1


def test_a_robot_that_is_gone_is_the_answer():
    def gone():
        raise RemoteError("BusClosed", "robot fake is gone")

    answers = []
    sender = TrajectorySender(gone)
    sender.send(iter([piece(1.0)]), lambda points: None, lambda *answer: answers.append(answer))
    assert answers == [(None, "robot fake is gone")]
