"""The verb world, on a virtual drive in a world that records its requests."""

from __future__ import annotations

import json

import pytest
from support.virtualbench import served, servo

from canopen_control.cli.main import main
from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.drive import AddPayload, BasePose, BlockJoint, PushRobot, SetGrip, WorldState
from canopen_control.virtual.plant import IndependentPlants

CAN = "memory:cli-world"


class Noting(IndependentPlants):
    def __init__(self):
        self.acts = []
        self.base = BasePose(1.0, -2.0, 3.141592653589793, 7, z=0.5, pitch=-0.1)

    def act(self, what):
        if getattr(what, "on", "") == "roof":
            raise ConfigError("the robot has no link 'roof'")
        self.acts.append(what)

    def describe(self):
        return WorldState(self.base, sensors={"range": (1.5,)})


@pytest.fixture
def world(request):
    created = getattr(request, "param", Noting)()
    with served(CAN, servo(5), created):
        yield created


def test_it_reports_where_the_robot_is(world, capsys):
    assert main(["world", "--can", CAN]) == 0
    output = capsys.readouterr().out
    assert (
        output == "x 1.0000 m, y -2.0000 m, z 0.5000 m, heading 180.00 deg, roll 0.0 deg, pitch -5.7 deg\nrange: 1.5\n"
    )
    assert main(["world", "--can", CAN, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["base"]["z"] == 0.5


@pytest.mark.parametrize(
    ("words", "act"),
    [
        ("payload 12 --on base_link --at 0,0,0.1", AddPayload(mass=12.0, on="base_link", position=(0.0, 0.0, 0.1))),
        ("payload -3", AddPayload(mass=-3.0)),
        ("push 0,30,0 --for 0.3", PushRobot(force=(0.0, 30.0, 0.0), seconds=0.3)),
        ("block wheel", BlockJoint(joint="wheel")),
        ("block wheel off", BlockJoint(joint="wheel", on=False)),
        ("friction 0.2", SetGrip(friction=0.2)),
    ],
)
def test_what_is_asked_for_happens(world, words, act):
    assert main(["world", *words.split(), "--can", CAN]) == 0
    assert world.acts == [act]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("payload", "give the mass in kg"),
        ("payload much", "'much': write KG"),
        ("push 1,2", "'1,2': write X,Y,Z"),
        ("push 1,2,nan", "write X,Y,Z"),
        ("friction 0.2 off", "only block takes on or off"),
        ("payload 1 --on roof", "the robot has no link 'roof'"),
    ],
)
def test_what_cannot_be_is_reported_and_nothing_happens(world, capsys, words, text):
    assert main(["world", *words.split(), "--can", CAN]) in (1, 2)
    assert text in capsys.readouterr().err
    assert world.acts == []


@pytest.mark.parametrize("world", [IndependentPlants], indirect=True)
def test_without_physics_it_suggests_what_to_do(world, capsys):
    assert main(["world", "--can", CAN]) == 0
    assert "have no physics" in capsys.readouterr().out
    assert main(["world", "block", "wheel", "--can", CAN]) != 0
    assert "start the robot with --physics" in capsys.readouterr().err


def test_without_drives_it_suggests_how_to_start_them(capsys):
    assert main(["world"]) == 1
    assert "canopen-control run ROBOT --physics" in capsys.readouterr().err
