from __future__ import annotations

from support.virtualbench import Bench, servo

from canopen_control.frame import CanFrame
from canopen_control.virtual.twin import make_twin, serve_twin


def test_a_twin_is_the_same_device_with_another_serial_and_a_life_of_its_own():
    first = Bench(servo())
    twin = make_twin(first.node, first.now)
    assert [frame.data for frame in serve_twin(twin) if frame.can_id == 0x705] == [b"\0"]
    assert (twin.node_id, twin.get(0x1018, 4)) == (5, 1005)
    twin.receive(CanFrame(0, b"\x01\x05"), first.now)
    assert twin.operational
    assert not first.node.operational
    assert twin.drives.keys() == first.node.drives.keys()
    serve_twin(twin)
    assert twin.events() == []
