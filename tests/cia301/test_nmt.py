from __future__ import annotations

import pytest
from support.services import MS, frame, vectors

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.nmt import (
    SERVICES_BY_STATE,
    TRANSITIONS,
    CommunicationService,
    ErrorReaction,
    NmtCommand,
    NmtConfirmed,
    NmtMaster,
    NmtResetRequested,
    NmtSlave,
    NmtState,
    NmtStateChanged,
    NmtUnconfirmed,
    boot_up_frame,
    check_reaction,
    nmt_frame,
    parse_nmt,
    reaction,
)
from canopen_control.errors import LocalProtocolError

PRE, OP, STOPPED, INIT = (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL, NmtState.STOPPED, NmtState.INITIALISING)


@pytest.mark.parametrize(
    ("value", "state", "after"),
    [
        (ErrorReaction.PRE_OPERATIONAL, OP, PRE),
        (ErrorReaction.PRE_OPERATIONAL, PRE, PRE),
        (ErrorReaction.PRE_OPERATIONAL, STOPPED, STOPPED),
        (ErrorReaction.NO_CHANGE, OP, OP),
        (ErrorReaction.STOPPED, OP, STOPPED),
        (ErrorReaction.STOPPED, PRE, STOPPED),
        (ErrorReaction.STOPPED, STOPPED, STOPPED),
        (ErrorReaction.STOPPED, INIT, INIT),
        (0x80, OP, OP),
    ],
)
def test_reactions(value, state, after):
    command = reaction(value, state)
    assert (state if command is None else TRANSITIONS[state, command]) is after


def test_other_values_are_refused():
    assert [check_reaction(value) for value in (0, 1, 2)] == [None] * 3
    assert check_reaction(3) is AbortCode.INVALID_VALUE


COMMANDS = {
    "start": NmtCommand.START,
    "stop": NmtCommand.STOP,
    "enter_preop": NmtCommand.ENTER_PRE_OPERATIONAL,
    "reset_node": NmtCommand.RESET_NODE,
    "reset_comm": NmtCommand.RESET_COMMUNICATION,
}


def slave_in(state: NmtState, node_id: int = 3) -> NmtSlave:
    slave = NmtSlave(node_id)
    slave.boot()
    for (source, command), target in TRANSITIONS.items():
        if source is slave.state and target is state:
            slave.command(command)
    slave.frames()
    slave.events()
    assert slave.state is state
    return slave


@pytest.mark.parametrize("vector", vectors()["nmt"]["frames"], ids=lambda v: v["frame"])
def test_commands_are_the_vectors_both_ways(vector):
    command = COMMANDS[vector["command"]]
    assert nmt_frame(command, vector["node"]) == frame(vector["frame"])
    assert parse_nmt(frame(vector["frame"])) == (command, vector["node"])


@pytest.mark.parametrize("text", vectors()["nmt"]["invalid"])
def test_an_invalid_command_changes_nothing_and_is_counted(text):
    slave = slave_in(NmtState.OPERATIONAL)
    slave.receive(frame(text), 0)
    assert parse_nmt(frame(text)) is None
    assert (slave.state, slave.malformed, slave.events()) == (NmtState.OPERATIONAL, 1, [])


def test_a_node_id_above_127_is_refused():
    with pytest.raises(LocalProtocolError, match="128"):
        nmt_frame(NmtCommand.START, 128)


def test_boot_sends_the_boot_up_and_enters_pre_operational():
    slave = NmtSlave(3)
    slave.boot()
    assert slave.frames() == [frame("703#00")] == [boot_up_frame(3)]
    assert slave.events() == [NmtStateChanged(NmtState.INITIALISING, NmtState.PRE_OPERATIONAL)]
    slave.boot()
    assert (slave.frames(), slave.next_deadline()) == ([], None)


def test_a_self_starting_node_continues_to_operational():
    slave = NmtSlave(3, self_starting=True)
    slave.boot()
    assert slave.state is NmtState.OPERATIONAL
    assert len(slave.events()) == 2


@pytest.mark.parametrize("state", [NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL, NmtState.STOPPED])
@pytest.mark.parametrize("command", NmtCommand)
def test_every_state_obeys_every_command_to_its_node_and_to_all(state, command):
    for node_id in (0, 3):
        slave = slave_in(state)
        slave.receive(nmt_frame(command, node_id), 0)
        assert slave.state is TRANSITIONS[state, command]


def test_a_command_to_another_node_is_not_received():
    slave = slave_in(NmtState.PRE_OPERATIONAL)
    slave.receive(nmt_frame(NmtCommand.START, 4), 0)
    slave.receive(frame("080#0103"), 0)
    assert (slave.state, slave.malformed, slave.ignored) == (NmtState.PRE_OPERATIONAL, 0, 0)


def test_an_initialising_node_receives_nothing():
    slave = NmtSlave(3)
    slave.receive(nmt_frame(NmtCommand.START), 0)
    assert (slave.state, slave.ignored, slave.events()) == (NmtState.INITIALISING, 1, [])


@pytest.mark.parametrize("command", [NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION])
def test_a_reset_asks_the_owner_and_boots_again(command):
    slave = slave_in(NmtState.OPERATIONAL)
    slave.receive(nmt_frame(command, 3), 0)
    assert slave.events() == [NmtStateChanged(NmtState.OPERATIONAL, NmtState.INITIALISING), NmtResetRequested(command)]
    assert slave.frames() == []
    slave.boot()
    assert slave.frames() == [frame("703#00")]


def test_a_command_to_the_reached_state_reports_nothing():
    slave = slave_in(NmtState.OPERATIONAL)
    slave.command(NmtCommand.START)
    assert slave.events() == []


def test_services_by_state():
    pdo, sdo, emcy = CommunicationService.PDO, CommunicationService.SDO, CommunicationService.EMCY
    assert [state for state in NmtState if pdo in SERVICES_BY_STATE[state]] == [NmtState.OPERATIONAL]
    for service in (sdo, emcy, CommunicationService.SYNC, CommunicationService.TIME):
        states = [state for state in NmtState if service in SERVICES_BY_STATE[state]]
        assert states == [NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL]
    assert not slave_in(NmtState.STOPPED).allows(sdo)
    assert slave_in(NmtState.STOPPED).allows(CommunicationService.ERROR_CONTROL)
    assert NmtSlave(3).allows(CommunicationService.BOOT_UP)


def test_a_heartbeat_of_the_requested_state_confirms_the_command():
    master = NmtMaster(retry_ns=1500 * MS)
    master.command(NmtCommand.START, 3, 0)
    assert master.frames() == [frame("000#0103")]
    assert (master.pending(3), master.next_deadline()) == (NmtCommand.START, 1500 * MS)
    master.receive(frame("703#7F"), 10 * MS)
    assert master.events() == []
    master.receive(frame("703#05"), 20 * MS)
    assert master.events() == [NmtConfirmed(3, NmtCommand.START, 1, 20 * MS)]
    assert (master.pending(3), master.next_deadline()) == (None, None)


def test_an_unconfirmed_command_is_repeated_and_then_given_up():
    master = NmtMaster(retry_ns=1500 * MS, tries=3)
    master.command(NmtCommand.START, 3, 0)
    master.receive(frame("703#7F"), 1)
    master.tick(1500 * MS - 1)
    assert len(master.frames()) == 1
    master.tick(1500 * MS)
    master.tick(3000 * MS)
    assert master.frames() == [frame("000#0103")] * 2
    master.tick(4500 * MS)
    assert master.events() == [NmtUnconfirmed(3, NmtCommand.START, 3, NmtState.PRE_OPERATIONAL)]
    assert master.frames() == []


def test_a_reset_is_never_repeated():
    master = NmtMaster(reset_timeout_ns=5000 * MS)
    master.command(NmtCommand.RESET_NODE, 3, 0)
    master.frames()
    master.tick(4999 * MS)
    master.tick(5000 * MS)
    assert master.frames() == []
    assert master.events() == [NmtUnconfirmed(3, NmtCommand.RESET_NODE, 1, None)]


def test_a_broadcast_is_confirmed_by_the_named_nodes_and_repeated_to_the_silent_one():
    master = NmtMaster(retry_ns=1500 * MS)
    master.command(NmtCommand.START, 0, 0, confirm_by=(2, 3))
    assert master.frames() == [frame("000#0100")]
    master.receive(frame("702#05"), MS)
    master.tick(1500 * MS)
    assert master.frames() == [frame("000#0103")]
    master.command(NmtCommand.STOP, 0, 0)
    assert master.pending(2) is None


def test_a_cancelled_wait_reports_nothing_and_foreign_frames_are_ignored():
    master = NmtMaster()
    master.command(NmtCommand.START, 3, 0)
    master.receive(frame("703#"), 0)
    master.receive(frame("704#05"), 0)
    master.cancel(3)
    master.receive(frame("703#05"), 0)
    assert master.events() == []
