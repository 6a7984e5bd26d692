import contextlib

import pytest
from support.samples import sample_of, status_of
from support.service_node import NodeStub

from canopen_control.commissioning.jobs import ScopeOptions
from canopen_control.commissioning.node_session import NodeSession
from canopen_control.commissioning.scope_run import KEPT, Scope, ScopeRun
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, DriveError
from canopen_control.od.eds import read_eds
from canopen_control.rpc.messages.robot import GetStatus, MappedValue, NodePlace, ProcessData
from canopen_control.view.robot_view import NodeJobs

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 3).od
SPEED, STATUS = "left_drive:0x606C:00", "left_drive:0x6041:00"


class Robot:
    """Says what TPDOs bring: `stories` is one batch of messages for each time that is asked."""

    robot = "pair"

    def __init__(self, *stories):
        self.stories, self.cycles = list(stories), 0

    def __call__(self, _robot, _timeout):
        return contextlib.nullcontext(self)

    def ask(self, request):
        self.cycles += 100
        cycle = {"period_s": 0.02, "count": self.cycles, "missed": 2, "work_s": 0.0}
        return status_of({"joints": {"left": {}}, "cycle": cycle}) if isinstance(request, GetStatus) else None

    def messages(self, _timeout):
        """Yield the messages of a batch; messages after a `break` remain, as in a RobotClient."""
        while self.stories and self.stories[0]:
            yield self.stories[0].pop(0)
        del self.stories[:1]


class Desk(NodeJobs):
    def __init__(self):
        super().__init__("pair", NodePlace(name="left_drive", node_id=3, bus="can"))

    @contextlib.contextmanager
    def session(self):
        held = {(0x606C, 0): bytes(4), (0x6041, 0): bytes(2)}
        yield NodeSession(NodeStub(held), 3, OD, name="left_drive", robot="pair")


def data(moment, index, value, size=4):
    return ProcessData(moment, {"left_drive": [MappedValue(index, 0, value.to_bytes(size, "little"))]})


def speeds(*values, begin=1000.0):
    return [data(begin + number / 10, 0x606C, value) for number, value in enumerate(values)]


def wish(signals, length=2.0, trigger="", before=None, **more):
    return signals, ScopeOptions(1000.0, length, trigger, before, **more)


def run(chosen, *stories):
    scope = ScopeRun(Desk(), *chosen, Robot(*stories))
    scope.run()
    return scope


def test_one_shot_is_taken_and_reported_with_the_cycles_of_the_robot():
    scope = run(wish((SPEED,), 0.35), speeds(1, 2, 3, 4, 5))
    (named,) = scope.shots
    assert (named.names, named.units) == (("left_drive:0x606C",), ("counts/s",))
    assert [row[0] for _, row in named.shot.rows] == [1.0, 2.0, 3.0, 4.0]
    assert (scope.over, scope.good, scope.captures) == (True, True, 1)
    assert scope.words == "1 capture; 100 cycles of the robot, 0 missed"


def test_a_trigger_has_what_was_before_it_and_a_fault_needs_no_statusword_among_the_signals():
    scope = run(wish((SPEED,), 0.3, "1:rising:3", 0.1), speeds(1, 2, 3, 4, 5, 6))
    assert [row[0] for _, row in scope.shots[0].shot.rows] == [2.0, 3.0, 4.0]
    fault = [data(1000.25, 0x6041, 0x08, 2)]
    scope = run(
        wish((SPEED,), 0.3, "fault", 0.1),
        [data(999.9, 0x6041, 0x27, 2), *speeds(1, 2, 3), *fault, *speeds(4, 5, 6, begin=1000.3)],
    )
    assert scope.shots[0].shot.triggered == 1000.25
    assert scope.shots[0].names == ("left_drive:0x606C",)


def test_rolling_continues_until_it_is_ended_and_keeps_only_the_newest():
    scope = ScopeRun(Desk(), *wish((SPEED,), 0.25, rolling=True), None)
    story = Robot(*(speeds(1, 2, 3, begin=1000.0 + number) for number in range(2 * KEPT)))
    real = story.messages

    def messages(timeout):
        if not story.stories:
            scope.end()
        return real(timeout)

    story.messages = messages
    scope._connect = story
    scope.run()
    assert scope.over
    assert scope.captures >= 2 * KEPT
    assert len(scope.shots) == KEPT


def test_joints_are_looked_at_too():
    sample = sample_of({"time": 1000.0, "joints": {"left": {"velocity": 2.5}}})
    late = sample_of({"time": 1001.0, "joints": {"left": {"velocity": 2.5}}})
    scope = run(wish(("left:velocity",), 0.5), [sample, late])
    assert scope.shots[0].shot.rows[0][1] == (2.5,)


@pytest.mark.parametrize(
    ("chosen", "why"),
    [
        (wish(()), "at least one signal"),
        (wish((SPEED,) * 9), "9 signals are too many"),
        (wish((SPEED,), 1.0, "1:rising:0", 1.0), "do not fit into"),
        (wish((SPEED,), 1.0, "2:rising:0"), "counted from 1 to 1"),
    ],
)
def test_an_invalid_viewpoint_is_reported_before_the_start(chosen, why):
    with pytest.raises(ConfigError, match=why):
        ScopeRun(Desk(), *chosen)


def test_what_goes_wrong_is_its_end_and_its_words():
    scope = run(wish(("left_drive:0x5FFE",), 1.0))
    assert (scope.over, scope.good) == (True, False)
    assert "has no 0x5FFE:00" in scope.words

    class Gone(Desk):
        def session(self):
            raise DriveError("node 3 does not answer")

    scope = ScopeRun(Gone(), *wish((SPEED,)), Robot())
    scope.run()
    assert scope.words == "node 3 does not answer"


def test_joints_and_a_fault_need_a_robot_and_a_drive():
    options = ScopeOptions(trigger="fault")
    with pytest.raises(ConfigError, match="joints exist only in a running robot"):
        Scope(["left:velocity"], {}, None, options)
    with pytest.raises(ConfigError, match="a trigger on faults needs a signal of a drive"):
        Scope(["left:velocity"], {}, Robot(), options)
    with pytest.raises(ConfigError, match="--before requires --trigger"):
        ScopeRun(Desk(), (SPEED,), ScopeOptions(before=0.5))
