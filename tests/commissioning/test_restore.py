import errno
import os
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.drive_shapes import MAKERS, SHAPES
from support.parameter_node import BOOTED, session_with

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.commissioning.identity import DeviceIdentity
from canopen_control.commissioning.parameter_set import (
    ParameterSet,
    backup_text,
    differences,
    parameters_of,
    read_backup,
    read_parameters,
    without_unused_slots,
)
from canopen_control.commissioning.restore import (
    KeptParameters,
    Restore,
    RestoreStep,
    check_device,
    refuse_moving,
    restore_groups,
    store,
)
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, DiskFull, DriveError, SdoAbort, SdoTimeout
from canopen_control.host.files import state_dir
from canopen_control.od.codec import default_of
from canopen_control.od.eds import read_eds

OD_OF_ORDER = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
HELD = without_unused_slots({entry.address: default_of(entry) for entry in parameters_of(OD_OF_ORDER)})


def order(wanted, held=HELD):
    return [write.address for group in restore_groups(OD_OF_ORDER, {**held, **wanted}, held) for write in group.writes]


def test_resolution_comes_before_values_and_the_mode_last():
    expected = {(0x6060, 0): 3, (0x6081, 0): 7, (0x2000, 0): 4, (0x607D, 2): 9, (0x1017, 0): 100, (0x2003, 0): 1}
    assert order(expected) == [(0x1017, 0), (0x2000, 0), (0x2003, 0), (0x607D, 2), (0x6081, 0), (0x6060, 0)]


def test_a_pdo_is_invalid_while_it_is_changed_and_mapped_as_a_whole():
    (group,) = restore_groups(OD_OF_ORDER, {**HELD, (0x1A01, 2): 0x60640020, (0x1801, 2): 1}, HELD)
    assert group.name == "TPDO 2"
    assert [(write.address, int.from_bytes(write.data, "little")) for write in group.writes] == [
        ((0x1801, 1), 0xC0000285),
        ((0x1801, 2), 1),
        ((0x1A01, 0), 0),
        ((0x1A01, 1), 0x60410010),
        ((0x1A01, 2), 0x60640020),
        ((0x1A01, 0), 2),
        ((0x1801, 1), 0x40000285),
    ]


def test_records_that_cannot_be_written_are_left_alone():
    fixed = {address: value for address, value in HELD.items() if address not in ((0x1801, 1), (0x1A01, 0))}
    assert order({(0x1A01, 2): 0x60640020}, fixed) == [(0x1A01, 2)]


@pytest.mark.parametrize("shift", [0, 1, 2])
def test_every_value_that_differs_is_written_once(shift):
    changed = {
        address: value + 1
        for number, (address, value) in enumerate(HELD.items())
        if isinstance(value, int) and number % 3 == shift and address[0] > 0x2000 and value < 100
    }
    assert sorted(order(changed)) == sorted(changed)


@given(st.lists(st.sampled_from([address for address in HELD if 0x1400 <= address[0] < 0x1C00]), max_size=6))
def test_a_count_is_never_above_0_while_an_entry_is_written(addresses):
    expected = {
        **HELD,
        **{address: 0 if address[1] == 0 else 0x60640020 for address in addresses if address[0] >= 0x1A00},
    }
    counts = {index: value for (index, sub), value in HELD.items() if sub == 0}
    valid = {
        index: not value & 1 << 31
        for (index, sub), value in HELD.items()
        if sub == 1 and index in range(0x1800, 0x1A00)
    }
    for group in restore_groups(OD_OF_ORDER, expected, HELD):
        for write in group.writes:
            (index, sub), value = write.address, int.from_bytes(write.data, "little")
            if 0x1800 <= index < 0x1A00 and sub == 1:
                valid[index] = not value & 1 << 31
            elif sub == 0:
                assert not valid[index - 0x200]
                counts[index] = value
            else:
                assert counts[index] == 0


OD = read_eds(data_path("eds", "generic_cia402.eds"), 5).od
GAINS = {(0x60F9, 1): 12_345, (0x60FB, 2): 900}


def kept(od=OD, channel="can0"):
    session = session_with(od)
    return KeptParameters("gains", session, session.identity(), channel)


def test_another_process_finds_what_was_kept(private_folders):
    kept().keep(OD, GAINS)
    result = kept()
    assert result.read() == GAINS
    result.forget()
    assert kept().read() == {}
    result.forget()


def test_a_folder_that_cannot_be_written_is_reported(private_folders):
    state_dir().mkdir(parents=True, exist_ok=True)
    state_dir("gains").write_text("in the way")
    with pytest.raises(ConfigError, match=r"cannot be saved in .*, so nothing was written to the node"):
        kept().keep(OD, GAINS)


def test_a_full_disk_is_no_mistake_of_the_user(private_folders, monkeypatch):
    def full(_self, _data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(DiskFull) as caught:
        kept().keep(OD, GAINS)
    failure, advice = str(caught.value).split("; ")
    assert failure.endswith(".dcf, so nothing was written to the node: No space left on device")
    assert advice.startswith("free some space on the file system of /")


TMCM = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
CHANGES = {(0x6081, 0): 1600, (0x6083, 0): 5, (0x607D, 1): -500, (0x607D, 2): 500, (0x1017, 0): 250}


def held_by(session):
    return read_parameters(session, twice=False)[0]


def restore(session, wanted, *, keep=False):
    one = Restore(session, session.od, wanted)
    return one, one.run(keep=keep)


def test_what_differs_is_written_and_all_is_proven():
    session = session_with(TMCM)
    before = held_by(session).values
    one, good = restore(session, {**before, **CHANGES})
    assert good
    assert held_by(session).values == {**before, **CHANGES}
    assert (one.verified, len(one.written), one.refused, one.step) == (len(before), 5, [], RestoreStep.DONE)
    again, good = restore(session, {**before, **CHANGES})
    assert good
    assert again.written == []


@pytest.mark.parametrize("name", [*SHAPES, *MAKERS])
def test_every_manufacturers_shape_takes_its_backup_back(name, tmp_path):
    od = (SHAPES | MAKERS)[name][0]()
    session = session_with(od)
    path = tmp_path / "backup.dcf"
    path.write_text(backup_text(held_by(session)), encoding="utf-8")
    backup = read_backup(path)
    for entry in session.od:  # all writable values have been changed
        if entry.address in backup.values and entry.index >= 0x2000 and entry.data_type.is_integer:
            session.transfers.device.store.set(entry.index, entry.subindex, entry.low or 0)
    damage_pdos(session, backup.values)
    one, good = restore(session, backup.values)
    assert one.refused == []
    assert good
    assert [*differences(backup, held_by(session))] == []


def damage_pdos(session, values):
    """Switch the first TPDO off and map nothing in it, unless its EDS maps what it says cannot be mapped."""
    store, od = session.transfers.device.store, session.od
    if (0x1800, 1) in values:
        store.set(0x1800, 1, values[0x1800, 1] | 1 << 31)
    mapped = [value for (index, sub), value in values.items() if index == 0x1A00 and sub]
    if (0x1A00, 0) in values and all(od[value >> 16, value >> 8 & 0xFF].tpdo_mappable for value in mapped):
        store.set(0x1A00, 0, 0)


def test_a_refusal_puts_everything_back():
    session = session_with(TMCM)
    before = held_by(session).values
    session.transfers.device.store.guard([0x6084], refusing)
    one, good = restore(session, {**before, **CHANGES, (0x6084, 0): 9})
    assert not good
    assert one.undone
    assert [str(item) for item in one.refused] == [
        "0x6084:00 Profile deceleration: abort 0x08000022 (data cannot be transferred or stored to the application "
        "because of the present device state)"
    ]
    assert held_by(session).values == before


def refusing(_entry, _value):
    from canopen_control.cia301.sdo_server import SdoServerAbort

    raise SdoServerAbort(0x08000022)


def test_with_keep_what_was_taken_stays():
    session = session_with(TMCM)
    before = held_by(session).values
    session.transfers.device.store.guard([0x6084], refusing)
    one, good = restore(session, {**before, **CHANGES, (0x6084, 0): 9}, keep=True)
    assert not good
    assert not one.undone
    assert held_by(session).values == {**before, **CHANGES}


def test_a_value_that_the_drive_cuts_counts_as_refused():
    session = session_with(TMCM)
    before = held_by(session).values
    session.transfers.device.store.ceilings.inject({0x6081: 1000})
    one, _ = restore(session, {**before, **CHANGES})
    assert [str(item) for item in one.refused] == [
        "0x6081:00 Profile velocity: 1600 was written, but the drive reports 1000"
    ]
    assert one.undone
    assert held_by(session).values == before


def test_what_depends_on_a_later_object_is_tried_again():
    session = session_with(TMCM)
    before = held_by(session).values
    device = session.transfers.device

    def after_6085(_entry, value):
        if device.store.number(0x6085) != 77:
            refusing(None, None)
        return value

    device.store.guard([0x6081], after_6085)
    one, good = restore(session, {**before, (0x6081, 0): 5, (0x6085, 0): 77})
    assert good
    assert one.written == ["0x6085:00 Quick stop deceleration", "0x6081:00 Profile velocity"]


def test_what_the_drive_does_not_have_is_refused_before_anything_is_written():
    session = session_with(TMCM)
    expected = {**held_by(session).values, **CHANGES}
    session.transfers.lacking.add((0x6084, 0))
    one, good = restore(session, expected)
    assert not good
    assert one.undone
    assert "0x6084:00" in str(one.refused[0])
    assert session.transfers.written == []


@pytest.mark.parametrize("count", [1, 3])
def test_an_interruption_reports_what_is_written_and_the_same_again_finishes(count):
    session = session_with(TMCM)
    before = held_by(session).values
    session.transfers.silent_from = count
    one = Restore(session, session.od, {**before, **CHANGES})
    with pytest.raises(SdoTimeout):
        one.run()
    assert (len(one.written), one.planned, one.step) == (count, 5, RestoreStep.WRITING)
    session.transfers.silent_from = None
    again, good = restore(session, {**before, **CHANGES})
    assert good
    assert len(again.written) == 5 - count


def test_another_product_is_refused_and_another_revision_reported():
    session = session_with(TMCM)
    file = ParameterSet(TMCM, 5, DeviceIdentity(0xFFFF0192, 0x286, 0x4F6, 1), {}, "left.dcf")
    assert check_device(file, DeviceIdentity(0xFFFF0192, 0x286, 0x4F6, 2), session) == [
        "revision 0x00000001 and 0x00000002"
    ]
    with pytest.raises(
        ConfigError, match=r"left.dcf belongs to a different product than node 5: product .*nothing was written"
    ):
        check_device(file, DeviceIdentity(0xFFFF0192, 0x286, 0x4F5, 1), session)


def test_a_drive_with_torque_is_refused():
    session = session_with(TMCM)
    refuse_moving(session)
    session.transfers.device.store.on_read(0x6041, 0, lambda: 0x0637)
    with pytest.raises(DriveError, match=r"node 5 is enabled; nothing was written: disable it first"):
        refuse_moving(session)


def test_what_is_stored_outlasts_the_power():
    session = session_with(TMCM)
    restore(session, {**held_by(session).values, **CHANGES})
    store(session)
    device = session.transfers.device
    device.command(NmtCommand.RESET_NODE, 2 * BOOTED)
    device.tick(3 * BOOTED)
    assert held_by(session).values[0x6081, 0] == 1600


def test_a_drive_that_is_silent_while_it_stores_is_waited_for():
    session, pauses = session_with(TMCM), []
    session.transfers.silent_from = 0

    def pause(seconds):
        pauses.append(seconds)
        if len(pauses) == 3:  # and never again
            session.transfers.silent_from = None

    session.transfers.pause = pause
    store(session)
    assert len(pauses) == 3
    session.transfers.silent_from = 0
    with pytest.raises(DriveError, match="do not switch the drive off yet"):
        store(session)


def test_a_drive_that_cannot_store_reports_this():
    session = session_with(TMCM)
    session.transfers.device.store.guard([0x1010], refusing)
    with pytest.raises(SdoAbort):
        store(session)
    session.od = replace(TMCM, entries={key: entry for key, entry in TMCM.entries.items() if key[0] != 0x1010})
    with pytest.raises(ConfigError, match="has no 0x1010:01"):
        store(session)
