import msgspec

from canopen_control.rpc.messages.drive import WorldShape
from canopen_control.rpc.wire import text_of


def test_what_is_as_ever_is_not_written():
    box = WorldShape(name="box 0", kind="box", size=(1.0, 2.0, 3.0), position=(0.5, 0.0, 1.5))
    reported = {"name": "box 0", "kind": "box", "size": [1.0, 2.0, 3.0], "position": [0.5, 0.0, 1.5]}
    assert msgspec.json.decode(text_of(box)) == reported
    assert msgspec.convert(reported, WorldShape) == box
    assert (box.rotation, box.moves, box.robot, box.grip) == ((1.0, 0.0, 0.0, 0.0), False, "", 0.0)
