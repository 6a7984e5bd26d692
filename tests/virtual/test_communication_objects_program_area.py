import zlib

import pytest
from support.programs import program_od
from support.virtualbench import Aborted, Bench

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.virtual.communication_objects import ProgramState, whole_program
from canopen_control.virtual.device import make_device

NEW = whole_program(b"a new program" * 5)
WRONG_STATE, FAILED = 0x08000022, 0x06060000


@pytest.fixture
def bench():
    return Bench(make_device(program_od(), 5))


def control(bench, value):
    bench.write(0x1F51, value, 1, size=1)


def flash(bench):
    return int.from_bytes(bench.read(0x1F57, 1), "little")


def loader(bench):
    control(bench, 0)
    bench.on(0.5)
    return bench


def cleared(bench):
    control(loader(bench), 3)
    assert flash(bench) == 1
    bench.on(0.5)
    assert flash(bench) == 0
    return bench


def send(bench, data):
    bench.node.store.download(0x1F50, 1, data)
    bench.on(0.2)


def test_a_running_program_shows_itself(bench):
    assert bench.read(0x1F51, 1) == b"\1"
    assert int.from_bytes(bench.read(0x1F56, 1), "little") == bench.node.program.identification != 0
    assert int.from_bytes(bench.read(0x1000), "little") & 0xFFFF == 402


def test_the_boot_loader_is_another_device_after_a_reset(bench):
    control(bench, 0)
    assert bench.node.program.runs  # the answer leaves first
    bench.on(0.5)
    assert [frame.data for _, frame in bench.seen if frame.can_id == 0x705].count(b"\0") == 2
    assert (bench.read(0x1F51, 1), bench.read(0x1000)) == (b"\0", bytes(4))
    assert bench.read(0x1018, 2) != program_od()[0x1018, 2].default
    with pytest.raises(Aborted):
        bench.read(0x6041)
    bench.start()
    assert not [frame for frame in bench.put(0x205, b"\6\0") if frame.can_id == 0x185]


def test_a_whole_program_is_taken_and_started(bench):
    send(cleared(bench), NEW)
    assert (flash(bench), int.from_bytes(bench.read(0x1F56, 1), "little")) == (0, zlib.crc32(NEW[:-4]))
    control(bench, 1)
    bench.on(0.5)
    assert bench.read(0x1F51, 1) == b"\1"
    assert bench.node.program.image == NEW
    assert int.from_bytes(bench.read(0x1000), "little") & 0xFFFF == 402


def test_data_without_a_fresh_clear_are_refused(bench):
    for _ in range(2):
        with pytest.raises(Exception, match="08000022"):
            send(loader(bench), NEW)
        assert flash(bench) == 8
    send(cleared(bench), NEW)
    with pytest.raises(Exception, match="08000022"):
        send(bench, NEW)


@pytest.mark.parametrize("value", [2, 4, 0x80])
def test_other_commands_are_refused(bench, value):
    with pytest.raises(Aborted) as refusal:
        control(bench, value)
    assert refusal.value.code == 0x06090030


def test_the_program_is_commanded_in_pre_operational_alone(bench):
    bench.start()
    with pytest.raises(Aborted) as refusal:
        control(bench, 0)
    assert refusal.value.code == WRONG_STATE
    assert bench.node.nmt.state is NmtState.OPERATIONAL
    assert bench.node.program.state is ProgramState.RUNNING


def test_a_running_program_cannot_be_cleared_and_nothing_cannot_be_started(bench):
    with pytest.raises(Aborted):
        control(bench, 3)
    cleared(bench)
    with pytest.raises(Aborted):
        control(bench, 1)


def test_a_damaged_program_never_runs(bench):
    send(cleared(bench), NEW[:-1] + b"?")
    assert flash(bench) == 3 << 1
    with pytest.raises(Aborted):
        control(bench, 1)
    bench.node.power_on(bench.now)
    bench.on(0.5)
    assert bench.read(0x1F51, 1) == b"\0"
    assert bench.read(0x1F56, 1) == bytes(4)


@pytest.mark.parametrize("at", [0, 1, 20, len(NEW) - 1])
def test_a_flash_that_fails_leaves_no_program(bench, at):
    cleared(bench)
    bench.node.program.fails_at.inject(at)
    with pytest.raises(Exception, match="06060000"):
        send(bench, NEW)
    assert flash(bench) == 5 << 1
    bench.node.program.fails_at.clear()
    bench.nmt(NmtCommand.RESET_NODE)
    bench.on(0.5)
    assert not bench.node.program.runs
    send(cleared(bench), NEW)
    assert flash(bench) == 0


def test_a_power_cut_in_the_loader_brings_the_old_program_back_as_long_as_it_is_whole(bench):
    loader(bench).node.power_on(bench.now)
    bench.on(0.5)
    assert bench.node.program.runs
    cleared(bench).node.power_on(bench.now)
    bench.on(0.5)
    assert not bench.node.program.runs


def test_a_program_may_report_its_date_and_the_boot_loader_stores_it(bench):
    dated = whole_program(b"a program", days=15_000, milliseconds=43_200_000)
    assert (bench.read(0x1F52, 1), bench.read(0x1F52, 2)) == (bytes(4), bytes(4))
    send(cleared(bench), dated)
    assert int.from_bytes(bench.read(0x1F52, 1), "little") == 15_000
    control(bench, 1)
    bench.on(0.5)
    assert int.from_bytes(bench.read(0x1F52, 2), "little") == 43_200_000


def test_data_without_a_clear_are_refused_with_their_first_frame(bench):
    loader(bench)
    for initiate in (b"\x21\x50\x1f\x01\x00\x04\x00\x00", b"\xc2\x50\x1f\x01\x00\x04\x00\x00"):
        (answer,) = [frame for frame in bench.put(0x605, initiate) if frame.can_id == 0x585]
        assert answer.data == b"\x80\x50\x1f\x01" + WRONG_STATE.to_bytes(4, "little")
    assert flash(bench) >> 1 == 4  # not cleared
    cleared(bench)
    (answer,) = [frame for frame in bench.put(0x605, b"\x21\x50\x1f\x01\x00\x04\x00\x00") if frame.can_id == 0x585]
    assert answer.data[0] == 0x60


def test_the_factory_program_has_the_version_of_the_dictionary_until_another_is_loaded():
    bench = Bench(make_device(program_od(), 5, objects={(0x1F56, 1): 0x10002}))
    assert bench.read(0x1F56, 1) == bytes.fromhex("02000100")
    assert bench.read(0x1F56, 1) == bytes.fromhex("02000100")
    assert cleared(bench).read(0x1F56, 1) == bytes(4)
