import msgspec
import pytest

from canopen_control.rpc.messages.drive import (
    DRIVE,
    DriveState,
    SetInputs,
    SetPlant,
    SetPointQuality,
    Spread,
    SwitchFault,
    WorldShape,
    WorldState,
)
from canopen_control.rpc.wire import convert, plain, text_of


@pytest.mark.parametrize("method", DRIVE.methods.values(), ids=lambda each: each.name)
def test_every_method_reports_what_it_does_and_declares_its_answer(method):
    assert method.text.endswith("."), method.name
    assert msgspec.inspect.type_info(method.answer)
    assert msgspec.inspect.type_info(method.request).forbid_unknown_fields


@pytest.mark.parametrize(
    ("kind", "params", "words"),
    [
        (SwitchFault, {}, "missing required field `name`"),
        (SwitchFault, {"name": "silent", "on": "yes"}, r"Expected `bool`, got `str` - at `\$\.on`"),
        (SetInputs, {"value": -1}, r"at `\$\.value`"),
        (SetInputs, {"value": 1 << 32}, r"at `\$\.value`"),
        (SetPlant, {"numbers": {"external": "far"}}, r"at `\$\.numbers\[\.\.\.\]`"),
        (SetPlant, {"external": -50}, "unknown field `external`"),
    ],
)
def test_what_is_out_of_range_is_not_a_request(kind, params, words):
    with pytest.raises(ValueError, match=words):
        convert(params, kind)


def test_numbers_of_a_plant_may_be_switches():
    assert convert({"numbers": {"stalled": True, "external": -5}}, SetPlant).numbers == {
        "stalled": True,
        "external": -5,
    }


def test_a_world_is_reported_only_where_there_is_one():
    state = DriveState(node_id=5, name="a", nmt_state="STOPPED", error_register=0, errors=[], faults=[], axes=())
    assert "world" not in plain(state)
    assert plain(WorldState()) == {}


def test_of_the_quality_of_set_points_only_what_was_is_reported():
    assert plain(SetPointQuality(taken=2, phase_us=Spread(1.0, 2.0, 4.0))) == {
        "taken": 2,
        "phase_us": {"min": 1.0, "mean": 2.0, "max": 4.0},
    }


# -- world shape


def test_what_is_as_ever_is_not_written():
    box = WorldShape(name="box 0", kind="box", size=(1.0, 2.0, 3.0), position=(0.5, 0.0, 1.5))
    reported = {"name": "box 0", "kind": "box", "size": [1.0, 2.0, 3.0], "position": [0.5, 0.0, 1.5]}
    assert msgspec.json.decode(text_of(box)) == reported
    assert msgspec.convert(reported, WorldShape) == box
    assert (box.rotation, box.moves, box.robot, box.grip) == ((1.0, 0.0, 0.0, 0.0), False, "", 0.0)
