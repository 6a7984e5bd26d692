import argparse
import signal
import subprocess
import sys
from dataclasses import replace

import pytest
from support.onbus import TMCM as TMCM_NAME
from support.onbus import OnBus
from support.parameter_node import restored, session_with

from canopen_control.cli.main import main
from canopen_control.commissioning.identity import DeviceIdentity
from canopen_control.commissioning.jobs import Reached
from canopen_control.commissioning.parameter_set import read_backup, read_parameters
from canopen_control.commissioning.restore import RestoreJournal, unfinished_words
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, DriveError
from canopen_control.host.files import state_dir
from canopen_control.od.eds import read_eds

TMCM = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
WANTED = {(0x6081, 0): 91, (0x6083, 0): 92, (0x6084, 0): 93}


def arguments(**changes):
    plain = {"protect": [], "include_protected": False, "keep": False, "store": False}
    plain |= {"any_node": True, "json": False, "can": "can0"}
    return argparse.Namespace(**{**plain, **changes})


def backup(values=WANTED, **changes):
    result = read_parameters(session_with(TMCM, serial=7), twice=False)[0]
    return replace(result, values={**result.values, **values}, where="left.dcf", **changes)


def journals():
    return sorted(state_dir("restores").glob("*.dcf"))


def held(session, addresses=WANTED):
    return {address: session.transfers.device.store.values[address] for address in addresses}


def interrupted(after=1, values=WANTED):
    """Return a session whose restore ended after some writes, and what it held before."""
    session = session_with(TMCM, serial=7)
    before = held(session)
    session.transfers.silent_from = after
    with pytest.raises(DriveError) as error:
        restored(session, backup(values), arguments())
    session.transfers.silent_from = None
    return session, before, str(error.value)


def test_the_same_command_continues_and_reports_what_it_found(capsys):
    session, _, text = interrupted()
    (journal,) = journals()
    undo = f"`canopen-control restore {journal} 5 --can can0` restores the previous values"
    assert text.endswith(undo)
    assert restored(session, backup(), arguments()) == 0
    assert f"was interrupted: repeat the command to continue it; {undo}" in capsys.readouterr().err
    assert held(session) == WANTED
    assert journals() == []


def test_entries_of_an_earlier_journal_are_older_and_stay():
    session, before, _ = interrupted()
    session.transfers.silent_from = len(session.transfers.written) + 1
    with pytest.raises(DriveError):
        restored(session, backup(), arguments())
    session.transfers.silent_from = None
    assert restored(session, read_backup(journals()[0]), arguments()) == 0
    assert held(session) == before


def test_a_refusal_that_is_undone_leaves_the_journal_of_before_alone():
    session, before, _ = interrupted()
    session.transfers.device.store.ceilings.inject({0x6083: 1})
    assert restored(session, backup(), arguments()) == 1
    (journal,) = journals()
    session.transfers.device.store.ceilings.clear()
    assert restored(session, read_backup(journal), arguments()) == 0
    assert held(session) == before


def test_it_is_there_before_the_first_value_is_written_and_holds_what_was():
    session = session_with(TMCM, serial=7)
    before, write, observed = held(session), session.transfers.write, []

    def look(index, subindex, data):
        (journal,) = journals()
        observed.append({address: read_backup(journal).values[address] for address in WANTED})
        write(index, subindex, data)

    session.transfers.write = look
    assert restored(session, backup(), arguments()) == 0
    assert observed == [before] * 3


def test_nothing_is_written_where_it_cannot_be_kept():
    session = session_with(TMCM, serial=7)
    state_dir().parent.mkdir(parents=True, exist_ok=True)
    state_dir().mkdir(exist_ok=True)
    (state_dir() / "restores").write_text("a file where the folder belongs")
    with pytest.raises(ConfigError, match=r"so nothing was written to the node: .*set XDG_STATE_HOME"):
        restored(session, backup(), arguments())
    assert session.transfers.written == []


def test_a_node_without_a_serial_number_is_known_by_its_channel():
    session = session_with(TMCM)
    paths = {RestoreJournal(session, DeviceIdentity(vendor_id=1), Reached(can)).path for can in ("can0", "can1")}
    assert len(paths) == 2
    known = {RestoreJournal(session, DeviceIdentity(serial_number=9), Reached(can)).path for can in ("can0", "can1")}
    assert len(known) == 1


def test_others_are_notified_of_it_and_a_node_without_one_is_not_asked():
    session, _, _ = interrupted()
    assert "was interrupted" in unfinished_words(session, Reached("can0"))
    restored(session, backup(), arguments())
    session.transfers.silent_from = 0
    assert unfinished_words(session, Reached("can0")) == ""


@pytest.mark.process
def test_a_restore_that_is_killed_is_undone_and_no_drive_moves_before(tmp_path, capfd):
    with OnBus("local:killed", {3: TMCM_NAME}) as bus:
        where, file = ["--can", "local:killed"], str(tmp_path / "drive.dcf")
        assert main(["backup", "3", "-o", file, *where, "--eds", TMCM_NAME]) == 0
        store = bus.nodes[3].store
        before = bus.call(lambda: [store.get(index) for index in (0x6081, 0x6083, 0x6084)])
        bus.call(lambda: [store.set(index, 0, 77) for index in (0x6081, 0x6083, 0x6084)])
        killed = (
            "import os, signal, sys\n"
            "from canopen_control.commissioning import restore\n"
            "write = restore.Restore._write_group\n"
            "def once(self, group):\n"
            "    write(self, group)\n"
            "    os.kill(os.getpid(), signal.SIGKILL)\n"
            "restore.Restore._write_group = once\n"
            "from canopen_control.cli.main import main\n"
            f"main(['restore', {file!r}, '3', '--can', 'local:killed'])\n"
        )
        assert subprocess.run([sys.executable, "-c", killed], check=False).returncode == -signal.SIGKILL
        mixed = bus.call(lambda: [store.get(index) for index in (0x6081, 0x6083, 0x6084)])
        assert mixed not in ([77, 77, 77], before)
        capfd.readouterr()
        assert main(["jog", "3", "--velocity", "10rpm", "--for", "1", *where, "--eds", TMCM_NAME]) == 1
        assert "the drive is not moved with mixed parameters" in capfd.readouterr().err
        (journal,) = journals()
        assert main(["restore", str(journal), "3", *where]) == 0
        assert bus.call(lambda: [store.get(index) for index in (0x6081, 0x6083, 0x6084)]) == [77, 77, 77]
