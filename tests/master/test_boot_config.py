"""The configuration of a node: read, compare, write, verify."""

import pytest
from support.conversation import NO_OBJECT, READ_ONLY, Device, plan

from canopen_control.errors import BootError
from canopen_control.master.boot_config import compare_only, configure, store
from canopen_control.master.plan_builder import PlannedWrite
from canopen_control.master.requests import BootTransfers, Read, Write
from canopen_control.od.model import DataType


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
