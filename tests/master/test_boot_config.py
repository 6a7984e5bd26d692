"""The configuration of a node: read, compare, write, verify."""

import pytest
from support.conversation import NO_OBJECT, READ_ONLY, Device, plan
from support.vendor import NODE, Booted, write_bus

from canopen_control.data_files import data_path
from canopen_control.errors import BootError
from canopen_control.master.boot_config import compare_only, configure, store
from canopen_control.master.plan_builder import PlannedWrite
from canopen_control.master.requests import BootTransfers, Read, Write
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType
from canopen_control.virtual.device import make_device


def u32(index, value, **how):
    return PlannedWrite(index, 0, value.to_bytes(4, "little"), "ramp", data_type=DataType.UNSIGNED32, **how)


def configured(device, *writes, **changes):
    transfers = BootTransfers()
    transfers.begin_configuration()
    device.run(configure(plan(writes=writes, **changes), transfers))
    return transfers


def asked(device):
    return [type(request).__name__ for request in device.log if isinstance(request, Read | Write)]


def test_what_the_node_holds_is_not_written_again():
    device = Device({(0x6083, 0): b"\x05\0\0\0"})
    transfers = configured(device, u32(0x6083, 5))
    assert asked(device) == ["Read"]
    assert (transfers.reads, transfers.writes, transfers.warnings) == (1, 0, [])


def test_what_differs_is_written_and_read_back():
    device = Device({(0x6083, 0): b"\x05\0\0\0"})
    configured(device, u32(0x6083, 6))
    assert asked(device) == ["Read", "Write", "Read"]
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


def test_an_addition_that_the_node_refuses_is_done_without_and_told():
    device = Device(refuse={(0x60C2, 0): NO_OBJECT})
    transfers = configured(device, u32(0x60C2, 1, reason="interpolation over the SYNC period", optional=True))
    assert "it refuses ramp 0x60C2:00 (interpolation over the SYNC period): abort 0x06020000" in transfers.warnings[0]


def test_a_vital_addition_that_the_node_refuses_is_letter_j_with_the_way_out():
    device = Device(refuse={(0x1016, 0): READ_ONLY})
    with pytest.raises(BootError, match="allow_unsupervised"):
        configured(device, u32(0x1016, 1, reason="the drive notices when the master dies"))


def test_an_object_that_cannot_be_read_is_written_and_not_verified():
    device = Device()
    configured(device, u32(0x2FFF, 1, compare=False), u32(0x2FFE, 1))
    assert asked(device) == ["Write", "Read", "Write"]


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
    assert device.log[-1] == Write(0x1010, 1, b"save", 20_000_000_000)


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
        ((0x1402, 1, 0x405),),  # live, and nobody lists it
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
    assert f"holds {value}" in refused.node.error
    assert f"add `{line}` under `sdo:`" in refused.node.error
    accepted = booted_with(tmp_path, stored, node=f"{UNSAID}sdo: [{line}]\n")
    assert accepted.node.ready, accepted.node.error
    assert accepted.device.get(index, subindex) == value


def test_a_scale_that_was_made_for_the_drive_as_it_is_is_taken(tmp_path):
    own = UNSAID.replace("counts_per_revolution: 65536", "counts_per_revolution: 4096")
    booted = booted_with(tmp_path, (0x608F, 1, 4096), (0x6092, 1, 4096), node=own)
    assert booted.node.ready, booted.node.error


def test_pdos_of_a_device_that_nobody_lists_are_as_in_its_eds_too(tmp_path):
    live = [number for number in range(4) if not read_eds(GENERIC, 5).od.get(0x1800 + number, 1).default & 1 << 31]
    index = 0x1A00 + live[0]
    booted = booted_with(tmp_path, (index, 0, 1), (index, 1, 0x60640020), node="counts_per_revolution: 65536\n")
    assert booted.node.ready, booted.node.error
    assert booted.device.get(index, 1) == booted.device.od.get(index, 1).default == 0x60410010
