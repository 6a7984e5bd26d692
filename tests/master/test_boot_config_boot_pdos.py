"""One PDO of a node: made what it should be, adopted, or left invalid."""

import pytest
from support.conversation import READ_ONLY, WRONG_STATE, Device, plan
from support.iomodule import IO, with_io_module
from support.robots import LEFT, RIGHT, Bench

from canopen_control.cia301.pdo import MappedObject
from canopen_control.errors import BootError
from canopen_control.master.boot_config import configure_pdo
from canopen_control.master.plan_builder import PdoLayout, PlannedWrite
from canopen_control.master.requests import BootTransfers
from canopen_control.od.model import DataType
from canopen_control.runtime.api_objects import write_mapped

CONTROLWORD = MappedObject(0x6040, 0, 16, DataType.UNSIGNED16)
MODE = MappedObject(0x6060, 0, 8, DataType.INTEGER8)
TARGET = MappedObject(0x60FF, 0, 32, DataType.INTEGER32)
LAYOUT = PdoLayout(1, 0x203, 255, (CONTROLWORD, MODE))


def number(value, size=4):
    return value.to_bytes(size, "little")


def write(index, subindex, value, size=4, **how):
    kind = DataType.UNSIGNED32 if size == 4 else DataType.UNSIGNED8
    return PlannedWrite(index, subindex, number(value, size), "x", pdo=("rpdo", 1), data_type=kind, **how)


GROUP = [
    write(0x1400, 1, 0x80000203),
    write(0x1600, 0, 0, 1),
    write(0x1600, 1, 0x60400010),
    write(0x1600, 2, 0x60600008),
    write(0x1600, 0, 2, 1),
    write(0x1400, 1, 0x203),
]


def device(*entries, cob_id=0x40000203, **how):
    """A node whose RPDO 1 carries `entries`."""
    mapping = {(0x1600, slot): number(entry) for slot, entry in enumerate(entries, 1)}
    return Device(
        {(0x1400, 1): number(cob_id), (0x1400, 2): b"\xff", (0x1600, 0): number(len(entries), 1), **mapping}, **how
    )


def run(node, group=GROUP, **changes):
    transfers = BootTransfers()
    node.run(configure_pdo(plan(**{"rpdos": (LAYOUT,), **changes}), group, transfers))
    return transfers


def held(node):
    return {
        address: int.from_bytes(data, "little")
        for address, data in node.objects.items()
        if address[0] in (0x1400, 0x1600)
    }


def test_a_pdo_that_is_as_wanted_is_only_read():
    node = device(0x60400010, 0x60600008)
    assert run(node).writes == 0
    assert node.written == []


def test_the_order_is_invalid_mapping_valid_and_bit_30_stays_the_devices():
    node = device(0x60410010)
    run(node)
    assert [(index, subindex, int.from_bytes(data, "little")) for index, subindex, data in node.written] == [
        (0x1400, 1, 0xC0000203),
        (0x1600, 0, 0),
        (0x1600, 1, 0x60400010),
        (0x1600, 2, 0x60600008),
        (0x1600, 0, 2),
        (0x1400, 1, 0x40000203),
    ]


def test_bit_30_that_the_device_does_not_have_is_not_given_to_it():
    node = device(0x60410010, cob_id=0x203)
    run(node)
    assert held(node)[0x1400, 1] == 0x203


MAPPING_FIXED = {(0x1600, slot): READ_ONLY for slot in range(9)}


def test_a_fixed_mapping_that_carries_what_is_needed_is_adopted_with_its_order():
    node = device(0x60600008, 0x60400010, refuse=MAPPING_FIXED)
    transfers = run(node)
    kind, layout = transfers.adopted[0]
    assert (kind, layout.number, layout.cob_id) == ("rpdo", 1, 0x203)
    assert layout.objects == (MODE, CONTROLWORD)
    assert held(node)[0x1400, 1] == 0x40000203
    assert "RPDO 1 is used as the node has it (0x6060:00, 0x6040:00): it refuses" in transfers.warnings[0]


def test_further_objects_of_an_adopted_rpdo_are_kept_at_what_they_are():
    node = device(0x60400010, 0x60600008, 0x60FF0020, refuse=MAPPING_FIXED)
    node.objects[0x60FF, 0] = number(77)
    transfers = run(node)
    assert transfers.adopted[0][1].objects == (CONTROLWORD, MODE, MappedObject(0x60FF, 0, 32, DataType.UNSIGNED32))
    assert transfers.presets == {(0x60FF, 0): 77}


def test_an_object_that_another_rpdo_carries_keeps_its_type_and_its_value():
    other = PdoLayout(2, 0x303, 255, (TARGET,))
    node = device(0x60400010, 0x60600008, 0x60FF0020, refuse=MAPPING_FIXED)
    transfers = run(node, rpdos=(LAYOUT, other))
    assert transfers.adopted[0][1].objects == (CONTROLWORD, MODE, TARGET)
    assert transfers.presets == {}


def test_a_fixed_mapping_that_lacks_an_object_leaves_the_pdo_invalid_and_names_it():
    node = device(0x60400010, refuse=MAPPING_FIXED)
    with pytest.raises(BootError) as caught:
        run(node)
    assert caught.value.letter == "J"
    assert "its own mapping (0x6040:00) lacks 0x6060:00; left invalid" in str(caught.value)
    assert held(node)[0x1400, 1] & 0x80000000


def test_a_constant_cob_id_is_adopted_where_the_mapping_will_do():
    node = device(0x60400010, 0x60600008, cob_id=0x40000277, refuse={(0x1400, 1): READ_ONLY})
    layout = run(node).adopted[0][1]
    assert (layout.cob_id, layout.objects) == (0x277, LAYOUT.objects)


def test_a_refusal_half_way_puts_back_what_was_there():
    full = {(0x1600, 2): lambda node, data: WRONG_STATE if data == number(0x60600008) else 0}
    node = device(0x60400010, 0x60FF0020, refuse=full)
    with pytest.raises(BootError, match=r"its own mapping \(0x6040:00, 0x60FF:00\) lacks 0x6060:00"):
        run(node)
    assert held(node)[0x1600, 0] == 2
    assert held(node)[0x1600, 2] == 0x60FF0020
    assert held(node)[0x1400, 1] & 0x80000000


def test_a_mapping_that_is_taken_and_not_kept_is_no_success():
    node = device(0x60410010, clamp={(0x1600, 1): number(0x60410010)})
    with pytest.raises(BootError, match="0x1600:01 holds 0x60410010 after 0x60400010 was written"):
        run(node)


UNLISTED = [write(0x1400, 1, 0x80000203, reason="live by default, configured by nobody", optional=True)]


def test_an_unlisted_pdo_is_switched_off_once():
    node = device(0x60400010)
    run(node, UNLISTED, rpdos=())
    assert held(node)[0x1400, 1] == 0xC0000203
    assert run(node, UNLISTED, rpdos=()).writes == 0


def test_an_unlisted_pdo_that_stays_live_is_told_and_a_listed_one_that_does_is_an_error():
    stubborn = {(0x1400, 1): READ_ONLY}
    assert "stays live" in run(device(0x60400010, refuse=stubborn), UNLISTED, rpdos=()).warnings[0]
    asked = [write(0x1400, 1, 0x80000203)]
    with pytest.raises(BootError, match="RPDO 1 cannot be made invalid"):
        run(device(0x60400010, refuse=stubborn), asked, rpdos=())


def test_silence_names_the_pdo_and_the_object():
    node = device(0x60400010)
    node.silent = True
    with pytest.raises(BootError, match="RPDO 1: 0x1400:01: no answer within 1 s"):
        run(node)


@pytest.fixture(params=[255, 254, 0, 1])
def robby(request, tmp_path):
    bench = Bench(f"io{request.param}", config=with_io_module(tmp_path, request.param), drives=(LEFT, RIGHT, IO))
    bench.start()
    bench.io = bench.robot.node("io_module")
    bench.until(lambda: bench.io.ready)
    yield bench
    bench.close()


def sent(bench, can_id):
    return [frame.data.hex() for label, frame in bench.bus.history if label == "master" and frame.can_id == can_id]


def values(bench):
    device = bench.drives[IO]
    return [device.get(index, subindex) for index in (0x6200, 0x6411) for subindex in (1, 2)]


def write_once(bench, index, subindex, data):
    write_mapped(bench.robot, bench.io, index, subindex, bytes.fromhex(data))


def test_nothing_is_sent_until_somebody_writes_and_then_once(robby):
    robby.run(2000)
    assert sent(robby, 0x205) + sent(robby, 0x305) == []
    assert values(robby) == [0x0F, 0xA0, 100, -200]
    assert sent(robby, 0x203), "a drive's go on"
    write_once(robby, 0x6200, 1, "31")
    robby.run(20)
    assert sent(robby, 0x205) == ["31a0"], "what nobody wrote stays as the module has it"
    order = [frame.can_id for label, frame in robby.bus.history if label == "master"]
    assert 0x080 in order[order.index(0x205) :], "before the SYNC that follows"
    robby.run(2000)
    assert sent(robby, 0x205) == ["31a0"]
    assert values(robby) == [0x31, 0xA0, 100, -200]
    write_once(robby, 0x6200, 1, "31")
    robby.run(100)
    assert sent(robby, 0x205) == ["31a0"] * 2, "the same value again is written again"
    assert sent(robby, 0x305) == []


def test_an_rpdo_does_not_undo_what_sdo_wrote(robby):
    write_once(robby, 0x6411, 2, "0100")
    robby.run(100)
    done = []
    robby.io.write(0x6411, 1, bytes.fromhex("0700"), done.append)
    robby.robot.bus_of(robby.io).send_waiting()
    robby.until(lambda: done)
    robby.run(1000)
    assert sent(robby, 0x305) == ["64000100"]
    assert values(robby)[2:] == [7, 1]
    write_once(robby, 0x6411, 2, "0200")
    robby.run(100)
    assert sent(robby, 0x305)[-1] == "07000200"
    assert values(robby)[2:] == [7, 2]


def test_after_a_restart_it_begins_with_the_values_it_has_then(robby):
    write_once(robby, 0x6200, 1, "31")
    robby.run(100)
    robby.power_off(IO)
    robby.run(1000)
    robby.power_on(IO)
    robby.until(lambda: not robby.io.ready)
    robby.until(lambda: robby.io.ready)
    robby.bus.clear_history()
    robby.run(1000)
    assert sent(robby, 0x205) == []
    assert values(robby) == [0x0F, 0xA0, 100, -200]
    write_once(robby, 0x6200, 2, "01")
    robby.run(100)
    assert sent(robby, 0x205) == ["0f01"]
