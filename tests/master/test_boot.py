"""The boot as a conversation: requests on one side, a scripted node on the other."""

from dataclasses import replace

import pytest
from support.conversation import READ_ONLY, Device
from support.conversation import plan as scripted

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia301.pdo import MappedObject
from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.errors import BootError
from canopen_control.frame import CanFrame
from canopen_control.master.boot import BootTask, boot, disable_axes
from canopen_control.master.plan import NodePlan
from canopen_control.master.plan_builder import PlannedPdo, PlannedWrite
from canopen_control.master.requests import LETTERS, AwaitBootUp, AwaitHeartbeat, Read, WriteObject
from canopen_control.od.model import DataType
from canopen_control.rpc.messages.robot import NodeIdentity

MS = 1_000_000
PLAN = NodePlan(
    name="io",
    node_id=3,
    source="io.eds",
    identity=NodeIdentity(),
    writes=(PlannedWrite(0x1017, 0, b"\x64\x00", "producer"),),
    rpdos=(),
    tpdos=(),
    axes=(),
    heartbeat_timeout_ns=300 * MS,
)


class Harness:
    def __init__(self, *, reset=True):
        self.sdo, self.commands, self.held = SdoClient(3, timeout_ns=100 * MS), [], {}
        self.task = BootTask(PLAN, self.sdo, self.commands.append, reset=reset, now=0)

    def serve(self, now):
        """Answer what the client asks, as a node that takes everything and holds it."""
        while frames := self.sdo.frames():
            for frame in frames:
                mux, kind = frame.data[1:4], frame.data[0]
                if kind & 0xE0 == 0x20:
                    self.held[mux] = frame.data[4 : 8 - (kind >> 2 & 3)]
                    answer = bytes((0x60,)) + mux + bytes(4)
                else:
                    data = self.held.get(mux, bytes(4))
                    answer = bytes((0x43 | 4 - len(data) << 2,)) + mux + data.ljust(4, b"\0")
                self.sdo.receive(CanFrame(0x583, answer), now)
            self.pump(now)

    def pump(self, now):
        for request in self.sdo.events():
            self.task.transfer_ended(request, now)


def test_a_successful_boot_executes_its_steps_and_records_their_times():
    harness = Harness()
    task = harness.task
    assert task.awaits_boot_up
    assert harness.commands == [NmtCommand.RESET_COMMUNICATION]
    task.boot_up(20 * MS)
    harness.serve(25 * MS)
    assert task.step == "heartbeat"
    task.heartbeat(NmtState.PRE_OPERATIONAL, 60 * MS)
    assert harness.commands[-1] is NmtCommand.START
    task.heartbeat(NmtState.PRE_OPERATIONAL, 70 * MS)
    assert not task.done
    task.heartbeat(NmtState.OPERATIONAL, 80 * MS)
    assert task.result is not None
    assert [(step.name, round(step.seconds * 1000)) for step in task.steps] == [
        ("reset", 20),
        ("identify", 5),
        ("configure", 0),
        ("heartbeat", 35),
        ("start", 20),
    ]


def test_a_boot_up_that_never_comes_is_waited_for_a_second():
    harness = Harness()
    assert harness.task.next_deadline() == 1000 * MS
    harness.task.tick(999 * MS)
    assert harness.task.step == "reset"
    harness.task.tick(1000 * MS)
    assert harness.task.step == "identify"


def test_a_server_that_is_silent_ends_the_boot_with_its_step():
    harness = Harness(reset=False)
    harness.sdo.frames()
    for ms in range(0, 5000, 50):
        harness.sdo.tick(ms * MS)
        harness.sdo.frames()
        harness.pump(ms * MS)
    assert harness.task.error is not None
    assert harness.task.steps[-1].name == "identify"
    assert "boot error B" in harness.task.steps[-1].error


def test_a_cancelled_boot_receives_nothing_any_more():
    harness = Harness(reset=False)
    harness.task.cancel()
    harness.serve(10 * MS)
    harness.task.heartbeat(NmtState.OPERATIONAL, 20 * MS)
    harness.task.tick(10_000 * MS)
    assert harness.task.result is None
    assert harness.task.error is None


def test_a_tpdo_confirms_operational_as_a_heartbeat_does():
    harness = Harness(reset=False)
    task, received = harness.task, [0]
    task._count_tpdos = lambda: received[0]
    harness.serve(5 * MS)
    received[0] = 7  # of an earlier run
    task.heartbeat(NmtState.PRE_OPERATIONAL, 60 * MS)
    assert task.step == "start"
    assert task.next_deadline() == 0, "every tick looks for a TPDO"
    task.tick(80 * MS)
    assert not task.done
    received[0] += 1
    task.tick(100 * MS)
    assert task.result is not None


def test_start_is_repeated_when_nothing_shows_it_and_then_given_up():
    harness = Harness(reset=False)
    task = harness.task
    harness.serve(5 * MS)
    task.heartbeat(NmtState.PRE_OPERATIONAL, 60 * MS)
    for ms in range(60, 4000, 20):
        task.tick(ms * MS)
    assert harness.commands == [NmtCommand.START] * 3
    assert "boot error T" in str(task.error)


def test_the_boots_own_sdo_timeout_is_used_for_its_requests_only():
    sdo = SdoClient(3, timeout_ns=100 * MS)
    BootTask(replace(PLAN, sdo_timeout_ns=2000 * MS), sdo, lambda _command: None, reset=False, now=0)
    assert sdo.next_deadline() == 2000 * MS
    other = SdoClient(3, timeout_ns=100 * MS)
    BootTask(PLAN, other, lambda _command: None, reset=False, now=0)
    assert other.next_deadline() == 100 * MS


def test_a_node_to_be_kept_alive_is_asked_for_its_state_by_its_heartbeat():
    sdo, commands = SdoClient(3, timeout_ns=100 * MS), []
    harness = Harness(reset=False)
    harness.sdo, harness.commands, harness.held = sdo, commands, {}
    harness.task = BootTask(replace(PLAN, keep_alive=True), sdo, commands.append, reset=True, now=0)
    harness.serve(5 * MS)
    assert harness.task.step == "keep alive"
    harness.task.heartbeat(NmtState.OPERATIONAL, 50 * MS)
    assert harness.task.step == "compare"
    harness.serve(60 * MS)
    harness.task.heartbeat(NmtState.OPERATIONAL, 100 * MS)
    assert harness.task.result is not None
    assert commands == []
    assert harness.held == {b"\x17\x10\x00": b"d\x00"}, "its supervision, which it lacked, and nothing else"


WRITES = (PlannedWrite(0x1017, 0, b"\x64\x00", "producer"), PlannedWrite(0x6083, 0, b"\x01\0\0\0", "ramp"))


def drive(objects=(), **behaviour):
    """Return a drive that holds these numbers, besides those of a drive that is switched off."""
    held = {(0x6502, 0): 0xA5, (0x6041, 0): 0x0240, **dict(objects)}
    return Device({key: number.to_bytes(4, "little") for key, number in held.items()}, **behaviour)


def booted(device, **changes):
    return device.run(boot(scripted(**{"axes": (0,), "writes": WRITES} | changes), reset=True))


def test_a_boot_resets_identifies_configures_waits_for_a_heartbeat_and_starts():
    device = drive()
    result = booted(device)
    assert device.steps == ["reset", "identify", "configure", "heartbeat", "start"]
    assert device.commands == [NmtCommand.RESET_COMMUNICATION, NmtCommand.START]
    assert device.written == [(0x1017, 0, b"\x64\x00"), (0x6083, 0, b"\x01\0\0\0")]
    results = (result.vendor_id, result.product_code, result.revision_number, result.serial_number)
    assert results == (0x286, 0x4F6, 0x3001A, 7)
    assert (result.supported_modes, result.writes, result.warnings) == (0xA5, 2, ())


def test_a_node_that_has_just_sent_its_boot_up_is_not_reset_again():
    device = drive()
    device.run(boot(scripted(axes=(0,), writes=WRITES), reset=False))
    assert device.commands == [NmtCommand.START]


def test_a_node_without_boot_up_message_boots_all_the_same():
    device = drive()
    device.boots = False
    assert booted(device).vendor_id == 0x286


ENDINGS = {
    "type": ({(0x1000, 0): 0x191}, {}, {}, "C", "0x00000191"),
    "vendor": ({(0x1018, 1): 0x287}, {}, {}, "D", "0x00000287"),
    "product": ({(0x1018, 2): 0x4F7}, {}, {}, "M", "0x000004F7"),
    "boot-loader": ({(0x1000, 0): 0}, {}, {}, "C", "in its boot-loader without a program, which `firmware` loads"),
    "revision": ({}, {}, {"revision_number": 99}, "N", "0x0003001A"),
    "serial number": ({}, {}, {"serial_number": 99}, "O", "0x00000007"),
    "silent": ({}, {"silent": True}, {}, "B", "powered"),
    "refused": ({}, {"refuse": {(0x6083, 0): READ_ONLY}}, {}, "J", "ramp 0x6083:00: abort 0x06010002 (refused)"),
    "no heartbeat": ({}, {"heartbeats": False}, {}, "K", ""),
    "never operational": ({}, {"starts_after": 99}, {}, "T", "OPERATIONAL"),
}


@pytest.mark.parametrize(("objects", "behaviour", "expected", "letter", "words"), ENDINGS.values(), ids=ENDINGS)
def test_what_ends_a_boot_has_the_letter_of_the_standard(objects, behaviour, expected, letter, words):
    identity = NodeIdentity(device_type=0x192, vendor_id=0x286, product_code=0x4F6, **expected)
    with pytest.raises(BootError) as caught:
        booted(drive(objects, **behaviour), identity=identity)
    assert caught.value.letter == letter
    assert words in str(caught.value)
    assert "node 3 (left_drive)" in str(caught.value)


def test_a_revision_that_only_the_eds_names_is_a_warning():
    (warning,) = booted(drive(), identity=NodeIdentity(0x192, 0x286, 0x4F6, eds_revision=0x30018)).warnings
    assert "0x00030018" in warning


def test_an_optional_write_may_be_refused():
    writes = (PlannedWrite(0x60C2, 1, b"\x14", "period", optional=True),)
    result = booted(drive(refuse={(0x60C2, 1): READ_ONLY}), writes=writes)
    assert result.writes == 0
    assert "0x60C2:01" in result.warnings[0]


def test_a_lost_start_command_is_sent_again():
    device = drive(starts_after=3)
    booted(device)
    assert device.commands.count(NmtCommand.START) == 3


def test_a_drive_left_enabled_loses_its_power_before_it_is_configured():
    device = drive({(0x6041, 0): 0x0637})
    booted(device)
    assert device.written[0] == (0x6040, 0, b"\x06\x00")


@pytest.mark.parametrize(
    ("objects", "behaviour", "changes"),
    [
        ({(0x1018, 1): 0x287}, {}, {}),
        ({}, {}, {"software_version": 0x10}),
        ({}, {"state": NmtState.OPERATIONAL}, {"keep_alive": True, "software_version": 0x10}),
        ({}, {"state": None}, {"keep_alive": True}),
    ],
    ids=["another vendor", "another software", "kept alive", "kept alive, state unknown"],
)
def test_a_drive_left_enabled_loses_its_power_also_if_its_boot_is_refused(objects, behaviour, changes):
    device = drive({(0x6041, 0): 0x0637, **objects}, **behaviour)
    with pytest.raises(BootError):
        booted(device, identity=NodeIdentity(vendor_id=0x286), **changes)
    assert device.written == [(0x6040, 0, b"\x06\x00")]


def test_a_device_of_another_type_and_a_disabled_drive_are_not_written_when_a_boot_is_refused():
    for objects in ({(0x6041, 0): 0x0637, (0x1000, 0): 0x191}, {(0x1018, 1): 0x287}):
        device = drive(objects)
        with pytest.raises(BootError):
            booted(device, identity=NodeIdentity(device_type=0x192, vendor_id=0x286))
        assert device.written == []


def test_an_io_node_is_asked_for_no_drive_objects():
    device = Device()
    assert booted(device, axes=()).supported_modes is None
    assert Read(0x6502, 0) not in device.log


# --------------------------------------------------------------------------------------- what CiA 302-2 asks besides


def test_a_node_to_be_kept_alive_that_is_operational_is_only_compared():
    device = Device({(0x6083, 0): b"\x05\0\0\0"}, state=NmtState.OPERATIONAL)
    write = PlannedWrite(0x6083, 0, b"\x01\0\0\0", "ramp", data_type=DataType.UNSIGNED32)
    result = device.run(boot(scripted(keep_alive=True, writes=(write,)), reset=True))
    assert device.commands == []
    assert device.written == []
    assert device.steps == ["identify", "keep alive", "compare", "heartbeat"]
    assert "boot status L: was operational already" in result.warnings[0]
    assert "differs from bus.yml in 0x6083:00" in result.warnings[0]


def test_a_node_to_be_kept_alive_gets_the_supervision_that_it_lacks():
    device = Device({(0x1016, 1): bytes(4)}, state=NmtState.OPERATIONAL)
    write = PlannedWrite(0x1016, 1, b"\x2c\x01\x01\0", "consumer", data_type=DataType.UNSIGNED32)
    result = device.run(boot(scripted(keep_alive=True, writes=(write,)), reset=True))
    assert device.written == [(0x1016, 1, b"\x2c\x01\x01\0")]
    assert "only its supervision was written" in result.warnings[0]


def test_a_node_to_be_kept_alive_with_other_process_data_is_refused():
    device = Device({(0x1800, 1): b"\x83\x01\0\0"}, state=NmtState.OPERATIONAL)
    write = PlannedWrite(0x1800, 1, b"\x93\x01\0\0", "cob id", pdo=("tpdo", 1), data_type=DataType.UNSIGNED32)
    plan = scripted(keep_alive=True, writes=(write,), tpdos=(PlannedPdo(1, 0x193, 255, ()),))
    with pytest.raises(BootError, match=r"but TPDO 1 differ from bus\.yml; set reset_communication: true"):
        device.run(boot(plan, reset=True))
    assert device.written == []


def test_a_node_to_be_kept_alive_that_is_not_operational_is_reset_and_configured():
    device = Device({(0x6083, 0): b"\x05\0\0\0"}, state=NmtState.STOPPED)
    write = PlannedWrite(0x6083, 0, b"\x01\0\0\0", "ramp")
    device.run(boot(scripted(keep_alive=True, writes=(write,)), reset=True))
    assert device.commands == [NmtCommand.RESET_COMMUNICATION, NmtCommand.START]
    assert device.written == [(0x6083, 0, b"\x01\0\0\0")]


@pytest.mark.parametrize(("guard", "letter"), [(None, "E"), ((50_000_000, 3), "F")])
def test_keep_alive_for_a_node_in_an_unknown_state_is_error_letter_e_or_f(guard, letter):
    device = Device(state=None)
    with pytest.raises(BootError) as caught:
        device.run(boot(scripted(keep_alive=True, guard=guard), reset=True))
    assert caught.value.letter == letter
    assert LETTERS[letter] in str(caught.value)
    assert device.commands == []


@pytest.mark.parametrize(
    ("held", "changes", "letter"),
    [(None, {}, "G"), (b"\x02\0\0\0", {}, "H"), (b"\x02\0\0\0", {"software_file": "firmware.bin"}, "I")],
)
def test_another_firmware_is_letter_g_h_or_i(held, changes, letter):
    device = Device({} if held is None else {(0x1F56, 1): held})
    with pytest.raises(BootError) as caught:
        device.run(boot(scripted(software_version=1, **changes), reset=True))
    assert caught.value.letter == letter
    assert "0x1F56:01" in str(caught.value)


def test_the_right_firmware_continues():
    device = Device({(0x1F56, 1): b"\x01\0\0\0"})
    device.run(boot(scripted(software_version=1), reset=True))
    assert device.commands[-1] is NmtCommand.START


@pytest.mark.parametrize(("subindex", "command"), [(1, NmtCommand.RESET_NODE), (2, NmtCommand.RESET_COMMUNICATION)])
def test_restoring_writes_load_and_resets_what_makes_it_effective(subindex, command):
    device = Device()
    write = PlannedWrite(0x6083, 0, b"\x01\0\0\0", "ramp")
    device.run(boot(scripted(restore=subindex, writes=(write,)), reset=False))
    assert device.written == [(0x1011, subindex, b"load"), (0x6083, 0, b"\x01\0\0\0")]
    assert device.commands == [command, NmtCommand.START]
    assert device.steps == ["identify", "restore", "reset", "configure", "heartbeat", "start"]


def test_a_node_that_does_not_return_from_restoring_is_letter_j():
    device = Device()
    device.boots = False
    with pytest.raises(BootError, match=r"boot error J.*no boot-up within 1 s after restoring"):
        device.run(boot(scripted(restore=1), reset=False))


def test_a_configuration_is_stored_only_when_the_boot_has_changed_it():
    writes = (PlannedWrite(0x6083, 0, b"\x01\0\0\0", "ramp"),)
    fresh, same = Device({(0x6083, 0): bytes(4)}), Device({(0x6083, 0): b"\x01\0\0\0"})
    assert fresh.run(boot(scripted(save=1, writes=writes), reset=True)).writes == 2
    assert fresh.written[-1] == (0x1010, 1, b"save")
    assert same.run(boot(scripted(save=1, writes=writes), reset=True)).writes == 0
    assert same.written == []


def test_a_node_that_cannot_store_boots_and_reports_this():
    device = Device(refuse={(0x1010, 1): 0x06060000})
    writes = (PlannedWrite(0x6083, 0, b"\x01\0\0\0", "ramp"),)
    result = device.run(boot(scripted(save=1, writes=writes), reset=True))
    assert "cannot store its configuration (0x1010:01)" in result.warnings[0]


@pytest.mark.parametrize("target", [(0x607A, 0), (0x60C1, 1)])
def test_process_data_begin_with_the_actual_position_and_an_old_target_velocity_is_cleared(target):
    layout = PlannedPdo(2, 0x303, 255, (MappedObject(*target, 32, DataType.INTEGER32),))
    device = Device({(0x6064, 0): (-5).to_bytes(4, "little", signed=True), (0x60FF, 0): b"\x09\0\0\0"})
    names = {(0x60FF, 0): "Target velocity"}
    result = device.run(boot(scripted(axes=(0,), rpdos=(layout,), entry_names=names), reset=True))
    assert result.presets == {target: -5, (0x6064, 0): -5}
    assert (0x60FF, 0, bytes(4)) in device.written


def test_a_mode_that_bus_yml_writes_is_what_the_rpdo_carries_at_first():
    layout = PlannedPdo(2, 0x303, 255, (MappedObject(0x6060, 0, 8, DataType.INTEGER8),))
    device = Device({(0x6061, 0): b"\x03", (0x6060, 0): b"\x03"})
    writes = (PlannedWrite(0x6060, 0, b"\x01", "mode"),)
    result = device.run(boot(scripted(axes=(0,), rpdos=(layout,), writes=writes), reset=True))
    assert result.presets == {(0x6060, 0): 1, (0x6061, 0): 3}


def test_an_unsupervised_silent_node_is_started_without_confirmation():
    device = Device(state=None)
    device.run(boot(scripted(heartbeat_timeout_ns=0), reset=False))
    assert device.commands == [NmtCommand.START]


def test_every_letter_of_the_standard_has_its_words():
    assert "".join(LETTERS) == "ABCDEFGHIJKLMNOT"
    assert all(LETTERS.values())


def test_the_reads_of_a_boot_are_counted():
    device = Device({(0x6083, 0): bytes(4)})
    result = device.run(boot(scripted(writes=(PlannedWrite(0x6083, 0, b"\x01\0\0\0", "ramp"),)), reset=True))
    assert result.reads == sum(isinstance(request, Read) for request in device.log) == 7
    assert result.writes == 1


class Axis:
    """A node that is asked to disable its axis: its statusword and what is written to its controlword."""

    def __init__(self, *statuswords):
        self.words, self.written, self.waits = list(statuswords), [], 0
        self.error = None

    def disable(self):
        asked = disable_axes(replace(PLAN, axes=(0,)), restarting=False)
        answer = None
        try:
            while True:
                request = asked.send(answer)
                answer = self.answer(request)
        except StopIteration:
            return self
        except BootError as error:
            self.error = error
            return self

    def answer(self, request):
        if isinstance(request, Read):
            word = self.words.pop(0) if len(self.words) > 1 else self.words[0]
            return word.to_bytes(2, "little")
        if isinstance(request, WriteObject):
            self.written.append((request.index, int.from_bytes(request.data, "little")))
        assert not isinstance(request, AwaitHeartbeat), "a heartbeat would end the wait"
        self.waits += request.timeout_ns if isinstance(request, AwaitBootUp) else 0
        return None


def test_an_axis_without_power_is_not_commanded_when_the_run_ends():
    assert Axis(0x0631).disable().written == []


def test_an_axis_that_is_enabled_is_disabled_and_watched_until_it_has_no_power():
    axis = Axis(0x0637, 0x0637, 0x0637, 0x0631).disable()
    assert axis.written == [(0x6040, 6)]
    assert axis.error is None


def test_an_axis_that_stays_in_its_quick_stop_gets_disable_voltage_after_the_time_for_its_ramp():
    axis = Axis(0x0617).disable()
    assert axis.written[:3] == [(0x6040, 6), (0x6040, 6), (0x6040, 0)]
    assert "its statusword 0x6041 is 0x0617" in str(axis.error)
    assert axis.waits == 5_000_000_000


def test_an_axis_that_does_not_obey_does_not_keep_the_other_axes_of_its_node_enabled():
    words, written = {0x6041: 0x0637, 0x6841: 0x0637}, []
    asked, answer, error = disable_axes(replace(PLAN, axes=(0, 0x800)), restarting=False), None, None
    try:
        while True:
            request = asked.send(answer)
            answer = words[request.index].to_bytes(2, "little") if isinstance(request, Read) else None
            if isinstance(request, WriteObject):
                written.append(request.index)
                words[0x6841] = 0x0631 if request.index == 0x6840 else words[0x6841]
    except BootError as end:
        error = end
    assert written[:2] == [0x6040, 0x6840]
    assert written.count(0x6840) == 1
    assert "its statusword 0x6041 is 0x0637" in str(error)
