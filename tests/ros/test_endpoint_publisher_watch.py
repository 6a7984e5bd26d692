"""Publishers that command one controller alternately are detected."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from canopen_control.ros.endpoint import PublisherWatch

pytestmark = pytest.mark.ros
TOPIC = "forward/commands"
NAMES = ["/one", "/robot/other"]
RAMP = [turn * 0.02 for turn in range(50)]


def warnings(commands, names=NAMES, *, seconds=0.05):
    """Return what is reported for commands at equal intervals, on a topic with these publishers."""
    infos, reported = [], []
    for name in names:
        namespace, _, own = name.rpartition("/")
        infos.append(SimpleNamespace(node_namespace=namespace or "/", node_name=own))
    node = SimpleNamespace(get_publishers_info_by_topic=lambda topic: infos if topic == TOPIC else [])
    context, watch = SimpleNamespace(node=node, warn=lambda _key, text: reported.append(text)), PublisherWatch()
    for turn, values in enumerate(commands):
        watch.take(context, TOPIC, values, 100 + turn * seconds)
    return reported


@pytest.mark.parametrize("moved", [False, True])
def test_publishers_on_two_topics_of_one_controller_are_named(moved):
    """Teleop on `/cmd_vel` and a program on `~/cmd_vel`; a topic that is quiet does not count."""
    of = {"cmd_vel": "teleop", "base/cmd_vel": "program"}
    reported, watch = [], PublisherWatch()
    node = SimpleNamespace(
        get_publishers_info_by_topic=lambda topic: [SimpleNamespace(node_namespace="/", node_name=of[topic])]
    )
    context = SimpleNamespace(node=node, warn=lambda _key, text: reported.append(text))
    if moved:
        watch.take(context, "cmd_vel", (1.0,), 90.0)
    for turn in range(20):
        topic = "base/cmd_vel" if moved or turn % 2 else "cmd_vel"
        watch.take(context, topic, (float(turn % 2),), 100 + turn * 0.05)
    assert reported == ([] if moved else [
        "cmd_vel and base/cmd_vel: /teleop and /program publish alternately, so the motion jerks; each newer command "
        "applies; end all but one of them"
    ])  # fmt: skip


@pytest.mark.parametrize(
    "commands",
    [
        [(1.0, 1.0), (2.0, 2.0)] * 50,
        [(0.5, 0.0), (0.0, 0.0)] * 50,  # a base that another one holds
        [(1.0,), (1.0,), (1.0,), (1.0,), (2.0,)] * 20,  # one publishes faster
        [(speed + offset,) for speed in RAMP for offset in (0.0, 3.0)],  # both change their commands
    ],
)
def test_two_that_alternate_are_named_once_with_what_to_do(commands):
    assert warnings(commands) == [
        f"{TOPIC}: /one and /robot/other publish alternately, so the motion jerks; each newer command applies; "
        "end all but one of them"
    ]


def test_publishers_of_one_node_are_counted():
    (reported,) = warnings([(1.0,), (2.0,)] * 10, ["/one", "/one"])
    assert reported.startswith(f"{TOPIC}: 2 publishers of /one publish alternately")


@pytest.mark.parametrize(
    ("commands", "names", "seconds"),
    [
        ([(1.0, 1.0)] * 100, NAMES, 0.05),  # the same values, or one of them is silent
        ([(speed,) for speed in RAMP], NAMES, 0.05),
        ([(1.0,)] * 20 + [(-1.0,)] * 20 + [(1.0,)] * 20, NAMES, 0.05),
        ([(1.0,), (2.0,)] * 50, ["/one"], 0.05),  # one publisher that shakes
        ([(1.0,), (2.0,)] * 50, NAMES, 5.0),  # each when the command before has ended
        ([(1.0,), (math.nan,)] * 50, NAMES, 0.05),
        ([(1.0,), (1.0, 2.0)] * 50, NAMES, 0.05),  # a message of another size is refused
    ],
)
def test_what_is_normal_is_not_named(commands, names, seconds):
    assert warnings(commands, names, seconds=seconds) == []
