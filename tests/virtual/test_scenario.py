from __future__ import annotations

import contextlib

import pytest
from support.virtualbench import S, servo

from canopen_control.bus.memory import MemoryBus
from canopen_control.errors import ConfigError
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot, SetGrip, SwitchFault, SwitchQuirk
from canopen_control.virtual.control import NodeControl
from canopen_control.virtual.node_host import NodeHost
from canopen_control.virtual.plant import IndependentPlants, LoadedPlant
from canopen_control.virtual.scenario import ScenarioError, ScenarioEvent, Timeline, WorldEvent, read_scenario
from canopen_control.yamlfile.reader import load


def read(tmp_path, text, node_ids=(3,)):
    path = tmp_path / "scenario.yml"
    path.write_text(text)
    return read_scenario(path, node_ids)


def test_a_timeline_is_read_in_order_whatever_its_order_in_the_file(tmp_path):
    text = """
    steps:
      - {at: 8s, node: 3, fault: heartbeat_lost, state: off}
      - {at: 5s, node: 3, fault: heartbeat_lost}
      - {at: 500ms, node: 2, fault: silent, for: 2s}
      - {at: 9s, node: 2, quirk: brake_delay=0.7, for: 1s}
      - {at: 12, node: 3, plant: {stalled: 1, external: -300.5}}
    """
    assert read(tmp_path, text, (2, 3)) == [
        ScenarioEvent(S // 2, "fault", "2", "silent", for_ns=2 * S),
        ScenarioEvent(5 * S, "fault", "3", "heartbeat_lost"),
        ScenarioEvent(8 * S, "fault_off", "3", "heartbeat_lost"),
        ScenarioEvent(9 * S, "quirk", "2", "brake_delay=0.7", for_ns=S),
        ScenarioEvent(12 * S, "plant", "3", plant=(("stalled", 1.0), ("external", -300.5))),
    ]


def test_with_one_node_it_need_not_be_named(tmp_path):
    assert read(tmp_path, "steps: [{at: 1s, fault: silent}]") == [ScenarioEvent(S, "fault", "3", "silent")]


def test_every_error_is_reported_at_once_with_its_line(tmp_path):
    text = """steps:
  - {at: 1s, node: 9, fault: silent}
  - {at: soon, node: 3, fault: silent}
  - {at: 1s, node: 3, fault: sillent}
  - {at: 1s, node: 3}
  - {at: 1s, node: 3, fault: silent, plant: {stalled: 1}}
  - {at: 1s, node: 3, fault: silent, state: off, for: 1s}
  - {at: 1s, fault: silent}
  - {at: 1s, node: 3, quirk: brake_dely}
  - {at: 1s, node: 3, quirk: brake_delay=99}
"""
    with pytest.raises(ScenarioError) as caught:
        read(tmp_path, text, (2, 3))
    message = str(caught.value)
    for line, words in (
        (2, "node 9 is not in this process"),
        (3, "not a time"),
        (4, "did you mean 'silent'"),
        (5, "exactly one of fault, quirk, plant"),
        (6, "exactly one of fault, quirk, plant"),
        (7, "for: is possible only with"),
        (8, "node is missing"),
        (9, "did you mean 'brake_delay'"),
        (10, "the strength must be a number, 0.001 to 60 s"),
    ):
        assert f"scenario.yml:{line}:" in message
        assert words in message


@pytest.mark.parametrize(
    "text", ["", "steps: 5", "steps: [{fault: silent}]", "steps: [{at: 1, fautl: x}]", "[", "x: 1"]
)
def test_what_is_not_a_scenario_is_refused(tmp_path, text):
    with pytest.raises(ScenarioError):
        read(tmp_path, text)


def test_a_file_that_is_not_there_is_an_error_too(tmp_path):
    with pytest.raises(ScenarioError, match="cannot be read"):
        read_scenario(tmp_path / "none.yml", (3,))


def test_steps_happen_in_their_time_and_one_that_cannot_is_reported():
    with Reactor(ManualClock(S)) as reactor:
        port, node, text = MemoryBus("timeline").open("drives"), servo(5, plant=lambda axis: LoadedPlant()), []
        host = NodeHost(reactor, port, [node])
        control = NodeControl(host, node)
        steps = [
            ScenarioEvent(S, "fault", "5", "silent", for_ns=S),
            ScenarioEvent(3 * S, "plant", "5", plant=(("external", -50.0),)),
            ScenarioEvent(4 * S, "plant", "5", plant=(("colour", 1.0),)),
        ]
        Timeline(reactor, {node: control}, {5: node}, text.append).plan(steps)
        active = []
        for _ in range(4):
            reactor.run_for(S + 1)
            active.append(list(node.fault_switches.active))
        assert active[:2] == [["silent"], []]
        assert node.drives[0].mover.plant.external == -50.0
        assert text == ["node 5: scenario: plant: 'colour' is not a number of this plant"]
        control.close()
        host.close()
        port.close()


def test_the_world_acts_too_without_a_node(tmp_path):
    text = """
    steps:
      - {at: 1s, payload: {mass: 5}}
      - {at: 2s, block: wheel, for: 3s}
    """
    assert read(tmp_path, text, (2, 3)) == [
        ScenarioEvent(S, "world", "2", world=AddPayload(mass=5.0)),
        ScenarioEvent(2 * S, "world", "2", for_ns=3 * S, world=BlockJoint(joint="wheel")),
    ]


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ("payload: {mass: 5}, friction: 1", "a step has one of payload, push, block and friction"),
        ("payload: {mass: 5}, fault: silent", "and then no node, fault, quirk or plant"),
        ("payload: {mass: 5}, for: 1s", "for: is possible only with block"),
    ],
)
def test_what_does_not_go_together_is_reported(tmp_path, step, words):
    with pytest.raises(ScenarioError) as caught:
        read(tmp_path, f"steps: [{{at: 1s, {step}}}]")
    assert words in str(caught.value)


def test_an_act_is_played_in_the_world_and_reported_where_there_is_none():
    done = []

    class Acting(IndependentPlants):
        def act(self, what):
            done.append(what)

    for world, reported in ((Acting(), 0), (IndependentPlants(), 1)):
        lines, bus = [], MemoryBus("scenario-act")
        with Reactor(ManualClock(S)) as reactor, contextlib.closing(bus.open("drive")) as port:
            node = servo(5)
            with (
                contextlib.closing(NodeHost(reactor, port, [node])) as host,
                contextlib.closing(NodeControl(host, node, world)) as control,
            ):
                timeline = Timeline(reactor, {node: control}, {5: node}, lines.append)
                timeline.plan([ScenarioEvent(S, "world", "5", world=SetGrip(friction=0.5))])
                reactor.run_for(2 * S)
        assert [line for line in lines if "scenario: node 5 is not in a world with physics" in line] == lines
        assert len(lines) == reported
    assert done == [SetGrip(friction=0.5)]


def test_a_file_of_simulate_that_has_drives_alone_is_played_and_what_needs_a_robot_is_named(tmp_path):
    path = tmp_path / "s.yml"
    path.write_text("for: 5min\nseed: 7\nsteps:\n  - {at: 1s, node: 3, fault: silent, for: 500ms}\n")
    assert read_scenario(path, [2, 3]) == [ScenarioEvent(S, "fault", "3", "silent", for_ns=S // 2)]
    path.write_text("steps:\n  - {at: 1s, node: 3, do: stall, when: axis power RAMPING_DOWN}\n")
    with pytest.raises(ScenarioError, match=r":2:.*do, when: only for a whole robot; .* canopen-control simulate"):
        read_scenario(path, [3])


BLOCKED = BlockJoint(joint="a")


@pytest.mark.parametrize(
    ("event", "begin", "end"),
    [
        (ScenarioEvent(0, "fault", name="f"), SwitchFault(name="f", on=True), SwitchFault(name="f", on=False)),
        (ScenarioEvent(0, "fault_off", name="f"), SwitchFault(name="f", on=False), SwitchFault(name="f", on=False)),
        (ScenarioEvent(0, "quirk", name="q"), SwitchQuirk(quirk="q", on=True), SwitchQuirk(quirk="q", on=False)),
        (ScenarioEvent(0, "quirk_off", name="q"), SwitchQuirk(quirk="q", on=False), SwitchQuirk(quirk="q", on=False)),
        (ScenarioEvent(0, "world", world=BLOCKED), BLOCKED, BlockJoint(joint="a", on=False)),
        (ScenarioEvent(0, "power", "5"), None, None),
    ],
    ids=lambda value: getattr(value, "kind", None),
)
def test_an_event_of_a_drive_is_a_request_for_its_beginning_and_one_for_its_end(event, begin, end):
    assert (event.request(), event.request(on=False)) == (begin, end)


def test_an_act_in_words_reports_when_what_and_how_long():
    act = ScenarioEvent(1_500_000_000, "command", "wheels", values=(1.0, -2.5), for_ns=2_000_000_000)
    assert act.words == "1.500 s: command wheels 1 -2.5 for 2 s"
    assert ScenarioEvent(0, "fault", "3", name="silent").words == "0.000 s: fault 3 silent"


# -- world acts


@pytest.mark.parametrize(
    ("text", "act"),
    [
        ("payload: {mass: 3}", AddPayload(mass=3.0)),
        (
            "payload: {mass: -3, on: base, position: [1, 0, 2]}",
            AddPayload(mass=-3.0, on="base", position=(1.0, 0.0, 2.0)),
        ),
        ("push: {force: [0, 5, 0]}", PushRobot(force=(0.0, 5.0, 0.0))),
        ("push: {force: [0, 5, 0], on: base, seconds: 2}", PushRobot(force=(0.0, 5.0, 0.0), on="base", seconds=2.0)),
        ("block: joint", BlockJoint(joint="joint")),
        ("friction: 0", SetGrip(friction=0.0)),
    ],
)
def test_each_key_is_what_the_socket_takes(tmp_path, text, act):
    path = tmp_path / "step.yml"
    path.write_text(text)
    assert load(path, WorldEvent, error=ConfigError).acts() == [act]


def test_none_is_nothing_and_all_are_all(tmp_path):
    assert WorldEvent().acts() == []
    assert len(WorldEvent(block="a", friction=1.0).acts()) == 2
