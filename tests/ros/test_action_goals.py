"""Loss of a goal's client, and the number of notifications; the goals in ROS are in the tests of the two actions."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from canopen_control.ros.action_goals import ActionGoals, FollowedGoal, GoalRequest
from canopen_control.rpc.messages.gripper import GripperVerdict

pytestmark = pytest.mark.ros


class Clients:
    def __init__(self, here=False):
        self.here = here

    def runs_here(self, _participant):
        return self.here


def goal(clients=None, client=b"me"):
    return FollowedGoal(GoalRequest(b"uuid", SimpleNamespace(), client), None, clients or Clients())


def test_a_client_that_was_never_seen_is_not_gone():
    followed = goal()
    assert not followed.is_alone(set())
    assert not followed.is_alone({b"me"})
    assert followed.is_alone({b"another"})


def test_a_client_of_this_host_is_gone_as_soon_as_its_process_is():
    clients = Clients(here=True)
    followed = goal(clients)
    assert not followed.is_alone(set())
    clients.here = False
    assert followed.is_alone({b"me"})


def test_one_that_cannot_be_reported_from_others_is_gone_with_the_last_of_them():
    followed = goal(client=None)
    assert not followed.is_alone({b"a", b"b"})
    assert not followed.is_alone({b"b"})
    assert followed.is_alone(set())


def test_he_is_reported_at_the_rate_of_the_verdict():
    followed = goal()
    followed.verdict = GripperVerdict(accepted=True, feedback_rate=10.0)
    reported = [time for time in range(100) if followed.feedback_due(5.0 + time / 100)]
    assert len(reported) == 10
    assert followed.feedback_due(1.0), "the clock was set back"


class EndingGoals(ActionGoals):
    """Aborted goals without ROS; `requested` are those whose results were requested."""

    asks_for_end = cancels = client_result = failed = feedback = refused = send = None

    def __init__(self, *goals):
        self._aborted, self.requested = goals, set()
        self._server = SimpleNamespace(is_result_requested=self.requested.__contains__)


@pytest.mark.parametrize(("age", "awaits"), [(0.0, True), (3.4, True), (3.6, False)])
def test_a_request_for_the_result_is_awaited_as_long_as_dds_repeats_it_and_only_of_an_accepted_goal(
    monkeypatch, age, awaits
):
    accepted, unanswered = goal(), goal()
    accepted.accepted_at = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: 100.0 + age)
    goals = EndingGoals(unanswered, accepted)
    assert goals.awaits_result_requests() is awaits
    goals.requested.add(accepted.uuid)
    assert not goals.awaits_result_requests()
