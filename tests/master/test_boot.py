"""The boot as a conversation: requests on one side, a scripted node on the other."""

import pytest

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.errors import BootError, SdoAbort, SdoTimeout
from canopen_control.master.boot import AwaitBootUp, AwaitState, Command, Read, Step, Write, boot
from canopen_control.master.plan import Identity, NodePlan, PlannedWrite

IDENTITY = {(0x1000, 0): 0x192, (0x1018, 1): 0x286, (0x1018, 2): 0x4F6, (0x1018, 3): 0x3001A, (0x1018, 4): 7}
DRIVE = {**IDENTITY, (0x6502, 0): 0xA5, (0x6041, 0): 0x0240}


def plan(**changes):
    values = {
        "name": "left_drive",
        "node_id": 3,
        "source": "test.eds",
        "identity": Identity(device_type=0x192, vendor_id=0x286, product_code=0x4F6),
        "writes": (
            PlannedWrite(0x1017, 0, b"\x64\x00", "producer"),
            PlannedWrite(0x6083, 0, b"\x01\x00\x00\x00", "ramp"),
        ),
        "rpdos": (),
        "tpdos": (),
        "axes": (0,),
        "heartbeat_timeout_ns": 300_000_000,
    }
    return NodePlan(**{**values, **changes})


def converse(generator, objects, *, boots=True, heartbeat=True, starts_after=1, refuse=None):  # noqa: C901, PLR0912 - one branch for each request
    """Answer every request as a node with these objects would; return what it was asked and the result."""
    asked, starts, answer, error = [], 0, None, None
    while True:
        try:
            request = generator.throw(error) if error is not None else generator.send(answer)
        except StopIteration as end:
            return asked, end.value
        asked.append(request)
        answer, error = None, None
        match request:
            case Read(index, subindex):
                if objects is None:
                    error = SdoTimeout(3, index, subindex, 1.0)
                elif (index, subindex) in objects:
                    answer = objects[index, subindex].to_bytes(4, "little")
                else:
                    error = SdoAbort(3, index, subindex, 0x06020000, "object does not exist")
            case Write(index, subindex, _):
                if refuse == (index, subindex):
                    error = SdoAbort(3, index, subindex, 0x06010002, "read only")
            case Command(NmtCommand.START):
                starts += 1
            case AwaitBootUp():
                answer = boots
            case AwaitState(_, None):
                answer = heartbeat
            case AwaitState(_, NmtState.OPERATIONAL):
                answer = starts >= starts_after


def failure(objects, **how):
    changes = how.pop("changes", {})
    with pytest.raises(BootError) as caught:
        converse(boot(plan(**changes), reset=True), objects, **how)
    return caught.value


def test_a_boot_resets_identifies_configures_waits_for_a_heartbeat_and_starts():
    asked, result = converse(boot(plan(), reset=True), DRIVE)
    assert [request.name for request in asked if isinstance(request, Step)] == [
        "reset",
        "identify",
        "configure",
        "heartbeat",
        "start",
    ]
    assert [request.command for request in asked if isinstance(request, Command)] == [
        NmtCommand.RESET_COMMUNICATION,
        NmtCommand.START,
    ]
    assert [(request.index, request.data) for request in asked if isinstance(request, Write)] == [
        (0x1017, b"\x64\x00"),
        (0x6083, b"\x01\x00\x00\x00"),
    ]
    assert (result.vendor_id, result.product_code, result.revision_number, result.serial_number) == (
        0x286,
        0x4F6,
        0x3001A,
        7,
    )
    assert (result.supported_modes, result.writes, result.warnings) == (0xA5, 2, ())


def test_a_node_that_has_just_sent_its_boot_up_is_not_reset_again():
    asked, _ = converse(boot(plan(), reset=False), DRIVE)
    assert Command(NmtCommand.RESET_COMMUNICATION) not in asked


def test_a_node_without_boot_up_message_boots_all_the_same():
    _, result = converse(boot(plan(), reset=True), DRIVE, boots=False)
    assert result.vendor_id == 0x286


@pytest.mark.parametrize(
    ("key", "value", "letter"),
    [((0x1000, 0), 0x191, "C"), ((0x1018, 1), 0x287, "D"), ((0x1018, 2), 0x4F7, "M")],
)
def test_another_device_at_the_node_id_is_refused_with_the_letter_of_the_standard(key, value, letter):
    error = failure({**DRIVE, key: value})
    assert error.letter == letter
    assert f"0x{value:08X}" in str(error)
    assert "node 3 (left_drive)" in str(error)


@pytest.mark.parametrize(("field", "subindex", "letter"), [("revision_number", 3, "N"), ("serial_number", 4, "O")])
def test_revision_and_serial_are_checked_only_where_they_are_given(field, subindex, letter):
    strict = plan().identity
    wanted = Identity(strict.device_type, strict.vendor_id, strict.product_code, **{field: 99})
    assert failure(DRIVE, changes={"identity": wanted}).letter == letter


def test_a_revision_that_only_the_eds_names_is_a_warning():
    identity = Identity(0x192, 0x286, 0x4F6, eds_revision=0x30018)
    _, result = converse(boot(plan(identity=identity), reset=True), DRIVE)
    assert len(result.warnings) == 1
    assert "0x00030018" in result.warnings[0]


def test_a_silent_node_is_letter_b():
    error = failure(None)
    assert error.letter == "B"
    assert "powered" in str(error)


def test_a_refused_write_is_letter_j_with_the_object_and_the_abort_text():
    error = failure(DRIVE, refuse=(0x6083, 0))
    assert error.letter == "J"
    assert "ramp 0x6083:00" in str(error)
    assert "read only" in str(error)


def test_an_optional_write_may_be_refused():
    writes = (PlannedWrite(0x60C2, 1, b"\x14", "period", optional=True),)
    _, result = converse(boot(plan(writes=writes), reset=True), DRIVE, refuse=(0x60C2, 1))
    assert result.writes == 0
    assert "0x60C2:01" in result.warnings[0]


def test_no_heartbeat_after_the_configuration_is_letter_k():
    assert failure(DRIVE, heartbeat=False).letter == "K"


def test_a_lost_start_command_is_sent_again():
    asked, _ = converse(boot(plan(), reset=True), DRIVE, starts_after=3)
    assert asked.count(Command(NmtCommand.START)) == 3


def test_a_node_that_never_becomes_operational_is_an_error_and_no_endless_loop():
    error = failure(DRIVE, starts_after=99)
    assert error.letter == "T"
    assert "OPERATIONAL" in str(error)


def test_a_drive_left_enabled_loses_its_power_before_it_is_configured():
    asked, _ = converse(boot(plan(), reset=True), {**DRIVE, (0x6041, 0): 0x0637})
    writes = [request for request in asked if isinstance(request, Write)]
    assert writes[0] == Write(0x6040, 0, b"\x06\x00")


def test_an_io_node_is_asked_for_no_drive_objects():
    asked, result = converse(boot(plan(axes=()), reset=True), IDENTITY)
    assert Read(0x6502, 0) not in asked
    assert result.supported_modes is None
