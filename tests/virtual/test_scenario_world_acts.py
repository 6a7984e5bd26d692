import pytest

from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot, SetGrip
from canopen_control.virtual.scenario import WorldEvent
from canopen_control.yamlfile.reader import load


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
