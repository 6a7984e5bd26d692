"""Publishers that command one controller alternately, by what they publish."""

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
    infos, told = [], []
    for name in names:
        namespace, _, own = name.rpartition("/")
        infos.append(SimpleNamespace(node_namespace=namespace or "/", node_name=own))
    node = SimpleNamespace(get_publishers_info_by_topic=lambda topic: infos if topic == TOPIC else [])
    watch = PublisherWatch(SimpleNamespace(node=node, warn=lambda _key, text: told.append(text)), TOPIC)
    for turn, values in enumerate(commands):
        watch.take(values, 100 + turn * seconds)
    return told


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
    (told,) = warnings([(1.0,), (2.0,)] * 10, ["/one", "/one"])
    assert told.startswith(f"{TOPIC}: 2 publishers of /one publish alternately")


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
