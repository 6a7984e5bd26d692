import pytest
from support.simulated import MS, Judged


class Nothing:
    def __init__(self, *_parts):
        pass

    def on_sample(self, now):
        pass


@pytest.fixture
def judged():
    created = Judged(Nothing)
    yield created
    created.close()


def test_an_unaffected_node_is_not_disturbed(judged):
    judged.drive(5.0, 5.0).do("stop").run(1.0)
    assert judged.disturbed.last(2) == judged.disturbed.last(3) == 0


@pytest.mark.parametrize("act", [{"name": "drive_fault"}, {"name": "hand_moved"}])
def test_a_fault_disturbs_its_node_as_long_as_it_is_on(judged, act):
    judged.do("fault", 3, 0.2, **act).run(1.0)
    lasted = 0.2 if act["name"] == "drive_fault" else 0.0
    assert judged.disturbed.last(3) == pytest.approx(judged.robot.now_ns - (1.0 - lasted) * 1e9, abs=25 * MS)
    assert judged.disturbed.last(2) == 0


@pytest.mark.parametrize(
    ("kind", "target", "more", "both"),
    [
        ("power", 3, {}, False),
        ("stall", 3, {}, True),
        ("stall", "master", {}, True),
        ("kill", "", {}, True),
        ("cut", 2, {}, True),
        ("lose", "", {"values": (2.0,)}, True),
        ("frame", "", {"values": (0x203.__float__(), 0.0)}, True),
    ],
)
def test_nodes_disturbed_by_each_event(judged, kind, target, more, both):
    lasts = {} if kind == "frame" else {"seconds": 0.1}
    judged.do(kind, target, **lasts, **more).run(0.05)
    assert judged.disturbed.last(3) > judged.robot.now_ns - 60 * MS
    assert (judged.disturbed.last(2) > 0) is both
