from support.virtualbench import Bench, tmcm

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.frame import CanFrame
from canopen_control.virtual.virtual_node import SYNC_LENGTH_ERROR, merged


def test_each_identifier_has_its_receiver_and_two_of_one_both_hear_in_order():
    heard = []
    routes = [(1, lambda f, now: heard.append("a")), (2, lambda f, now: heard.append("b"))]
    table = merged([*routes, (1, lambda f, now: heard.append("c"))])
    assert table.keys() == {1, 2}
    table[1](CanFrame(1, b""), 0)
    assert heard == ["a", "c"]
    table[2](CanFrame(2, b""), 0)
    assert heard == ["a", "c", "b"]


def test_a_version_tells_that_the_identifiers_changed_and_only_that():
    bench = Bench(tmcm())
    before = bench.node.routing.version
    bench.write(0x1016, 127 << 16 | 1000, 1)
    assert (bench.node.routing.version > before, 0x77F in bench.node.routes()) == (True, True)
    before = bench.node.routing.version
    bench.write(0x1016, 127 << 16 | 900, 1)
    assert bench.node.routing.version == before


def test_a_stopped_node_hears_neither_sdo_nor_sync():
    bench = Bench(tmcm())
    bench.nmt(NmtCommand.STOP)
    assert bench.read(0x1000) is None
    bench.put(0x080, b"12345678")
    assert SYNC_LENGTH_ERROR not in bench.node.emcy.active
    bench.start()
    bench.put(0x080, b"12345678")
    assert SYNC_LENGTH_ERROR in bench.node.emcy.active
    bench.put(0x080)
    assert SYNC_LENGTH_ERROR not in bench.node.emcy.active
