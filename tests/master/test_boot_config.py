"""The configuration of a node: read, compare, write, verify."""

import pytest
from support.conversation import NO_OBJECT, READ_ONLY, Device, plan
from support.iomodule import IO, with_io_module
from support.robots import LEFT, RIGHT, Bench
from support.vendor import NODE, Booted, write_bus

from canopen_control.data_files import data_path
from canopen_control.errors import BootError
from canopen_control.master.boot_config import compare_only, configure, store
from canopen_control.master.plan_builder import PlannedWrite
from canopen_control.master.requests import BootTransfers, Read, WriteObject
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType
from canopen_control.runtime.api_objects import write_mapped
from canopen_control.virtual.device import make_device


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


def test_nothing_is_sent_until_the_first_write_and_then_once(robby):
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


def u32(index, value, **how):
    return PlannedWrite(index, 0, value.to_bytes(4, "little"), "ramp", data_type=DataType.UNSIGNED32, **how)


def configured(device, *writes, **changes):
    transfers = BootTransfers()
    transfers.begin_configuration()
    device.run(configure(plan(writes=writes, **changes), transfers))
    return transfers


def asked(device):
    return [type(request).__name__ for request in device.log if isinstance(request, Read | WriteObject)]


def test_what_the_node_holds_is_not_written_again():
    device = Device({(0x6083, 0): b"\x05\0\0\0"})
    transfers = configured(device, u32(0x6083, 5))
    assert asked(device) == ["Read"]
    assert (transfers.reads, transfers.writes, transfers.warnings) == (1, 0, [])


def test_what_differs_is_written_and_read_back():
    device = Device({(0x6083, 0): b"\x05\0\0\0"})
    configured(device, u32(0x6083, 6))
    assert asked(device) == ["Read", "WriteObject", "Read"]
    assert device.objects[0x6083, 0] == b"\x06\0\0\0"


def test_a_value_that_the_drive_limits_is_a_warning_with_both_values():
    device = Device({(0x6083, 0): bytes(4)}, clamp={(0x6083, 0): b"\xe8\x03\0\0"})
    transfers = configured(device, u32(0x6083, 16000))
    assert transfers.warnings == [
        "ramp 0x6083:00 holds 0x000003e8 after 0x00003e80 was written; the node limits or rounds it"
    ]


@pytest.mark.parametrize("index", [0x1017, 0x6007])
def test_an_object_of_the_network_that_does_not_hold_what_was_written_is_letter_j(index):
    device = Device({(index, 0): bytes(4)}, clamp={(index, 0): b"\x09\0\0\0"})
    with pytest.raises(BootError, match=r"boot error J.*holds 0x00000009 after 0x00000001 was written"):
        configured(device, u32(index, 1))


def test_a_refused_write_is_letter_j_with_object_and_abort_text():
    device = Device({(0x6083, 0): bytes(4)}, refuse={(0x6083, 0): READ_ONLY})
    with pytest.raises(BootError, match=r"writing ramp 0x6083:00: abort 0x06010002 \(refused\)"):
        configured(device, u32(0x6083, 1))


def test_an_addition_that_the_node_refuses_is_done_without_and_reported():
    device = Device(refuse={(0x60C2, 0): NO_OBJECT})
    transfers = configured(device, u32(0x60C2, 1, reason="interpolation over the SYNC period", optional=True))
    assert "it refuses ramp 0x60C2:00 (interpolation over the SYNC period): abort 0x06020000" in transfers.warnings[0]


def test_a_vital_addition_that_the_node_refuses_is_letter_j_with_the_remedy():
    device = Device(refuse={(0x1016, 0): READ_ONLY})
    with pytest.raises(BootError, match="allow_unsupervised"):
        configured(device, u32(0x1016, 1, reason="the drive notices when the master is lost"))


def test_an_object_that_cannot_be_read_is_written_and_not_verified():
    device = Device()
    configured(device, u32(0x2FFF, 1, compare=False), u32(0x2FFE, 1))
    assert asked(device) == ["WriteObject", "Read", "WriteObject"]


def test_a_word_to_store_is_given_only_when_something_was_written_before_it():
    save = PlannedWrite(0x1010, 1, b"save", "Save all", compare=False)
    same, other = Device({(0x6083, 0): b"\x05\0\0\0"}), Device({(0x6083, 0): bytes(4)})
    configured(same, u32(0x6083, 5), save)
    configured(other, u32(0x6083, 5), save)
    assert same.written == []
    assert other.written[-1] == (0x1010, 1, b"save")


def test_flash_is_given_time():
    device = Device({(0x6083, 0): bytes(4)})
    transfers = configured(device, u32(0x6083, 5))
    device.run(store(plan(save=1), transfers))
    assert device.log[-1] == WriteObject(0x1010, 1, b"save", 20_000_000_000)


def test_silence_in_the_middle_is_letter_j_with_the_object():
    device = Device({(0x6083, 0): bytes(4)})
    device.silent = True
    with pytest.raises(BootError, match=r"boot error J.*reading ramp 0x6083:00"):
        configured(device, u32(0x6083, 1))


def test_comparing_writes_nothing_and_names_each_object_once():
    device = Device({(0x6083, 0): bytes(4), (0x6084, 0): b"\x01\0\0\0"})
    writes = (u32(0x6083, 1), u32(0x6084, 1), u32(0x2FFF, 1, compare=False))
    missing = device.run(compare_only(plan(writes=writes), BootTransfers()))
    assert [write.index for write in missing] == [0x6083]
    assert device.written == []


# -- what a device has stored is not taken for what its EDS says

GENERIC = data_path("eds", "generic_cia402.eds")
UNSAID = """\
rpdo: {1: {enabled: false}, 2: {enabled: true}, 4: {enabled: true}}
tpdo: {1: {enabled: false}, 2: {enabled: true, transmission: 1}, 3: {enabled: true}, 4: {enabled: true}}
counts_per_revolution: 65536
gear_ratio: 50
"""


def booted_with(folder, *stored, node=UNSAID):
    """Boot a generic drive that has stored something else than its EDS says, with a bus.yml that does not say much."""
    path = write_bus(folder, read_eds(GENERIC).od, node)
    device = make_device(GENERIC, NODE)
    for index, subindex, value in stored:
        device.store.preset(index, subindex, value)
    return Booted(path, device).run(5000)


SWAPPED = ((0x1603, 0, 2), (0x1603, 1, 0x60FF0020), (0x1603, 2, 0x60400010))


@pytest.mark.parametrize(
    "stored",
    [
        SWAPPED,
        ((0x1A02, 0, 2), (0x1A02, 1, 0x60640020), (0x1A02, 2, 0x60410010)),
        ((0x1802, 2, 255),),
        ((0x1403, 1, 0x40000511),),
        ((0x1402, 1, 0x405),),  # valid, but not listed
        ((0x1803, 1, 0x385),),  # what TPDO 3 is to have
        ((0x1005, 0, 0x82),),
        ((0x1014, 0, 0x91),),
        ((0x1016, 2, 0x101F4),),  # watches the master in another place
    ],
    ids=lambda stored: f"{stored[0][0]:04X}",
)
def test_what_the_master_relies_on_is_written_whatever_the_device_has_stored(tmp_path, stored):
    fresh, other = booted_with(tmp_path), booted_with(tmp_path, *stored)
    assert fresh.node.ready, fresh.node.error
    assert other.node.ready, other.node.error
    ours = [0x1005, 0x1014, 0x1016, *range(0x1400, 0x1404), *range(0x1600, 0x1604), *range(0x1800, 0x1804)]
    for index in [*ours, *range(0x1A00, 0x1A04)]:
        for subindex in fresh.device.od.subindices(index):
            held, planned = other.device.get(index, subindex), fresh.device.get(index, subindex)
            same = held == planned
            if index & 0xFF00 in (0x1400, 0x1800) and subindex == 1:  # bit 30 is the device's own
                same = held & planned & 1 << 31 or (held ^ planned) & ~(1 << 30) == 0
            unlisted = index & 0x3FF == 2 and index < 0x1800  # RPDO 3 is off, whatever it maps
            assert same or unlisted, f"0x{index:04X}:{subindex:02X} 0x{held:X} 0x{planned:X}"


@pytest.mark.parametrize(
    "stored", [(0x607E, 0, 0xC0), (0x608F, 1, 4096), (0x6091, 1, 3), (0x6092, 1, 360)], ids=lambda each: f"{each[0]:X}"
)
def test_another_polarity_or_gear_than_bus_yml_was_made_for_is_refused_and_the_advice_works(tmp_path, stored):
    index, subindex, value = stored
    refused = booted_with(tmp_path, stored)
    assert not refused.node.ready
    line = f"{{index: 0x{index:04X}, sub_index: {subindex}, value: {value}}}"
    assert f" is {value}, but " in refused.node.error
    assert f"add `{line}` under `sdo:`" in refused.node.error
    accepted = booted_with(tmp_path, stored, node=f"{UNSAID}sdo: [{line}]\n")
    assert accepted.node.ready, accepted.node.error
    assert accepted.device.get(index, subindex) == value


def test_a_scale_that_was_made_for_the_drive_as_it_is_is_taken(tmp_path):
    own = UNSAID.replace("counts_per_revolution: 65536", "counts_per_revolution: 4096")
    booted = booted_with(tmp_path, (0x608F, 1, 4096), (0x6092, 1, 4096), node=own)
    assert booted.node.ready, booted.node.error


def test_pdos_of_a_device_that_is_not_listed_are_as_in_its_eds_too(tmp_path):
    live = [number for number in range(4) if not read_eds(GENERIC, 5).od.get(0x1800 + number, 1).default & 1 << 31]
    index = 0x1A00 + live[0]
    booted = booted_with(tmp_path, (index, 0, 1), (index, 1, 0x60640020), node="counts_per_revolution: 65536\n")
    assert booted.node.ready, booted.node.error
    assert booted.device.get(index, 1) == booted.device.od.get(index, 1).default == 0x60410010
