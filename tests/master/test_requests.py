"""Texts of a boot: counts, and descriptions of failures."""

import pytest
from support.conversation import NO_OBJECT, Device, plan

from canopen_control.errors import SdoAbort, SdoTimeout
from canopen_control.master.requests import BootTransfers, boot_error, reason_of


def test_an_object_that_a_node_lacks_is_none_and_counted_as_asked_for():
    transfers, device = BootTransfers(), Device({(0x6061, 0): b"\xfe"})
    assert device.run(transfers.try_read(0x5999)) is None
    assert device.run(transfers.number(0x5999)) is None
    assert device.run(transfers.number(0x6061)) == 0xFE
    assert device.run(transfers.number(0x6061, signed=True)) == -2
    assert (transfers.reads, transfers.writes) == (4, 0)


def test_only_what_the_node_took_counts_as_written_and_as_a_change():
    transfers, device = BootTransfers(), Device(refuse={(0x6083, 0): NO_OBJECT})
    device.run(transfers.write(0x6040, 0, b"\x06\0"))
    transfers.begin_configuration()
    with pytest.raises(SdoAbort):
        device.run(transfers.write(0x6083, 0, bytes(4)))
    assert (transfers.writes, transfers.changed) == (1, False)
    device.run(transfers.write(0x6084, 0, bytes(4)))
    assert (transfers.writes, transfers.changed) == (2, True)


def test_silence_is_not_a_missing_object():
    with pytest.raises(SdoTimeout):
        Device(silent=True).run(BootTransfers().try_read(0x1000))


def test_an_error_has_the_letter_its_words_and_the_node():
    message = str(boot_error(plan(), "M", "0x1018:02"))
    assert message == "node 3 (left_drive): boot error M: another product: 0x1018:02"
    assert reason_of(SdoAbort(3, 1, 2, 0x06020000, "no object")) == "abort 0x06020000 (no object)"
    assert reason_of(SdoTimeout(3, 1, 2, 1.5)).startswith("no answer within 1.5 s")
