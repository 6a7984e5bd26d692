from __future__ import annotations

from types import SimpleNamespace

import pytest

from canopen_control.rpc.messages.state import StateSample

pytestmark = pytest.mark.ros
PLAIN, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"


class Ros:
    """A graph in which `published` are the types on the topic; `types` is what was subscribed to and left."""

    def __init__(self):
        self.published, self.types, self.warned, self.looks = [], [], [], 0
        self.node = SimpleNamespace(get_publishers_info_by_topic=self._info)

    def _info(self, topic):
        self.looks += 1
        return [SimpleNamespace(topic_type=item) for item in self.published]

    def subscribe(self, message, topic, callback, qos):
        self.types.append(message.__name__)
        return topic

    def unsubscribe(self, subscription):
        self.types.append(None)

    def warn(self, key, text):
        self.warned.append(text)


@pytest.fixture
def graph():
    return Ros()


@pytest.fixture
def follow(graph):
    """Return what makes a subscription and looks once for each list of published types; returns what it did."""
    from canopen_control.ros.base_topics import TwistSubscription

    def follow(*published, **how):
        twist_subscription = TwistSubscription(graph, "cmd_vel", print, **how)
        for number, graph.published in enumerate(published, 1):
            twist_subscription.check_types(StateSample(time=float(number)))
        twist_subscription.close()
        return graph.types

    return follow


@pytest.mark.parametrize("kind", ["Twist", "TwistStamped"])
def test_a_requested_type_stays_without_a_search(graph, follow, kind):
    assert follow([STAMPED], [PLAIN], kind=kind) == [kind, None]
    assert graph.looks == 0


def test_without_a_first_type_there_is_nothing_until_a_publisher_appears(follow):
    assert follow([], [PLAIN]) == ["Twist", None]


def test_it_changes_when_all_of_the_other_type_have_left_and_between_two_searches(graph, follow):
    assert follow([STAMPED], [STAMPED, PLAIN], [PLAIN], [PLAIN], [PLAIN]) == ["TwistStamped", None, "Twist", None]
    assert graph.warned == [f"cmd_vel is published as {PLAIN} and as {STAMPED}; only {STAMPED} is received"]


def test_the_first_type_holds_until_the_other_one_alone_is_there(follow):
    assert follow([], ["std_msgs/msg/String"], [PLAIN], [PLAIN], first="TwistStamped") == [
        "TwistStamped", None, "Twist", None,
    ]  # fmt: skip


def test_it_checks_four_times_a_second_at_any_rate_and_clock(graph):
    from canopen_control.ros.base_topics import TwistSubscription

    twist_subscription = TwistSubscription(graph, "cmd_vel", print)
    for time in (5.0, 5.1, 5.2, 5.3, 1.0, 1.1):
        twist_subscription.check_types(StateSample(time=time))
    assert graph.looks == 3, "at 5.0, 5.3, and after the clock was set back"
