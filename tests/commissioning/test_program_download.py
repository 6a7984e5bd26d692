import contextlib
import datetime
import zlib
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.foreign_loaders import CONFIRM, ProgramAbort, WaitingLoader, ZephyrDevice
from support.parameter_node import session_with
from support.programs import program_od
from support.properties import examples

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.commissioning.identity import DeviceIdentity
from canopen_control.commissioning.jobs import ProgramDate, ProgramOptions
from canopen_control.commissioning.node_session import NodeSession
from canopen_control.commissioning.program_download import (
    DownloadAct,
    DownloadAnswer,
    DownloadProgress,
    DownloadStep,
    boot_check,
    download,
    flash_text,
    is_loader,
    program_download,
    refuse_other_product,
)
from canopen_control.errors import BusClosed, ConfigError, DriveError, SdoAbort, SdoTimeout
from canopen_control.virtual.communication_objects import whole_program
from canopen_control.virtual.device import make_device

MS = 1_000_000
NEW_OF_PROGRAM_SESSION = whole_program(bytes(range(256)) * 208)  # 60 blocks
SEGMENTS = 127


class Killed(Exception):
    """The process of the client is gone, without a word."""


class Frames:
    """SDO by frames in virtual time; after `cut` segments of 0x1F50 `what` happens: "kill" or "power"."""

    def __init__(self, device):
        self.device, self.now = device, 1_000 * MS
        self.client, self.cut, self.what = SdoClient(5), None, ""
        device.tick(self.now)

    def read(self, index, subindex, *, block=False):
        return self._run(self.client.read(index, subindex, now=self.now))

    def write(self, index, subindex, data):
        return self._run(self.client.write(index, subindex, data, now=self.now), counts=index == 0x1F50)

    def set_timeout(self, seconds):
        self.client.timeout_ns = round((seconds or 0.5) * 1e9)

    def _run(self, request, *, counts=False):
        sent = 0
        while not request.done:
            frames = self.client.frames()
            for frame in frames:
                sent += counts
                if self.cut is not None and sent > self.cut:
                    self._lose()
                self.device.receive(frame, self.now)
            answers = [frame for frame in self.device.frames() if frame.can_id == 0x585]
            for answer in answers:
                self.client.receive(answer, self.now)
            if not frames and not answers:
                self.advance(50 * MS)
        if request.error is not None:
            raise request.error
        assert not self.device.program.runs or self.device.program.is_whole
        return request.data

    def _lose(self):
        self.cut = None
        if self.what == "kill":
            raise Killed
        self.device.power_on(self.now)

    def advance(self, ns):
        end = self.now + ns
        while (due := self.device.next_deadline()) is not None and due <= end:
            self.now = max(due, self.now)
            self.device.tick(self.now)
            self.device.frames()
        self.now = end
        self.client.tick(end)

    def command(self, command):
        self.device.command(command, self.now)

    def nmt_state(self):
        return self.device.nmt.state

    def pause(self, seconds):
        self.advance(round(seconds * 1e9))


@pytest.fixture
def frames():
    return Frames(make_device(program_od(), 5))


def load(frames, **how):
    progress = DownloadProgress()
    session = NodeSession(frames, 5, frames.device.od)
    download(session, NEW_OF_PROGRAM_SESSION, ProgramOptions(**how), progress)
    return progress


@pytest.mark.parametrize("block", range(0, 60, 10))
def test_after_a_kill_at_every_tenth_block_the_next_attempt_succeeds(frames, block):
    frames.cut, frames.what = 1 + block * SEGMENTS, "kill"
    with pytest.raises(Killed):
        load(frames)
    assert not frames.device.program.runs
    frames.client = SdoClient(5)  # another process
    load(frames)
    assert (frames.device.program.runs, frames.device.program.image) == (True, NEW_OF_PROGRAM_SESSION)


def test_with_one_try_the_loss_is_reported_and_the_loader_waits(frames):
    frames.cut, frames.what = 500, "power"
    with pytest.raises(DriveError, match=r"not accepted: .*stays in its boot-loader"):
        load(frames, tries=1)
    session = NodeSession(frames, 5, frames.device.od)
    assert is_loader(session.identity())
    load(frames)
    assert not is_loader(session.identity())


def test_the_loader_needs_no_eds(frames):
    frames.command(NmtCommand.ENTER_PRE_OPERATIONAL)
    frames.write(0x1F51, 1, b"\0")
    frames.advance(500 * MS)
    session = NodeSession(frames, 5, None)
    assert is_loader(session.identity())
    assert session.powered_axes() == []
    progress = DownloadProgress()
    download(session, NEW_OF_PROGRAM_SESSION, ProgramOptions(), progress)
    assert progress.new == zlib.crc32(NEW_OF_PROGRAM_SESSION[:-4])


def test_a_stranger_is_refused_but_its_loader_is_not(frames):
    session = NodeSession(frames, 5, frames.device.od)
    refuse_other_product(session, session.identity())
    session.od = replace(
        session.od, entries={**session.od.entries, (0x1018, 2): replace(session.od[0x1018, 2], default=7)}
    )
    with pytest.raises(ConfigError, match="node 5 does not match its EDS: product"):
        refuse_other_product(session, session.identity())
    refuse_other_product(session, DeviceIdentity(device_type=0))
    session.od = replace(
        session.od, entries={**session.od.entries, (0x1018, 1): replace(session.od[0x1018, 1], default=8)}
    )
    with pytest.raises(ConfigError, match="does not match its EDS: vendor"):
        refuse_other_product(session, DeviceIdentity(device_type=0))


def test_the_boot_check_detects_the_boot_loader_and_another_product(frames):
    session = NodeSession(frames, 5, frames.device.od)
    before = session.identity()
    assert boot_check(session, before) == before
    with pytest.raises(DriveError, match="is another product with the new program"):
        boot_check(session, replace(before, product_code=9))
    frames.write(0x1F51, 1, b"\0")
    frames.advance(500 * MS)
    with pytest.raises(DriveError, match="is in its boot-loader"):
        boot_check(session, before)


def test_errors_of_the_bus_are_not_answers():
    session = session_with(program_od())
    session.transfers.device.store.on_read(0x1F51, 1, lambda: 0)

    def gone(*_, **__):
        raise BusClosed("can0", "gone")

    session.transfers.write = gone
    with pytest.raises(BusClosed):
        download(session, NEW_OF_PROGRAM_SESSION, ProgramOptions(), DownloadProgress())
    session.transfers.silent_from = 0
    with pytest.raises(SdoTimeout):
        download(session, NEW_OF_PROGRAM_SESSION, ProgramOptions(), DownloadProgress())


NEW = whole_program(b"program" * 300)


class Bench:
    """A virtual device and a download, in virtual time; `disturb(number, order)` may return an Outcome of its own."""

    def __init__(self, od=None):
        self.device, self.now, self.orders = make_device(od or program_od(), 5), 1_000 * MS, []
        self.device.tick(self.now)

    def advance(self, ns):
        end = self.now + ns
        while (due := self.device.next_deadline()) is not None and due <= end:
            self.now = max(self.now, due)
            self.device.tick(self.now)
            self.device.frames()
        self.now = end
        self.device.tick(end)

    def run(self, image=NEW, options=None, disturb=lambda number, order: None):
        progress = DownloadProgress()
        sequence, outcome = program_download(image, options or ProgramOptions(), progress), None
        for number in range(2_000):
            try:
                order = next(sequence) if outcome is None else sequence.send(outcome)
            except StopIteration:
                return progress
            self.orders.append(order)
            outcome = disturb(number, order) or self.answer(order)
            self.advance(MS)
            program = self.device.program
            assert not program.runs or program.is_whole  # half a program never runs
        raise AssertionError("it never ends")

    def answer(self, order):
        store = self.device.store
        try:
            if order.act is DownloadAct.READ:
                return DownloadAnswer(store.upload(order.index, order.subindex))
            if order.act is DownloadAct.WRITE:
                store.download(order.index, order.subindex, order.data)
            elif order.act is DownloadAct.PAUSE:
                self.advance(round(order.seconds * 1e9))
            else:
                self.device.command(NmtCommand.ENTER_PRE_OPERATIONAL, self.now)
        except SdoServerAbort as refusal:
            return DownloadAnswer(error=SdoAbort(5, order.index, order.subindex, refusal.code, "refused"))
        return DownloadAnswer()

    def power_cut(self):
        self.device.power_on(self.now)
        self.advance(500 * MS)


def silent(order):
    return DownloadAnswer(error=SdoTimeout(5, order.index, order.subindex, 1.0))


def writes(bench):
    return [(order.index, order.data[:1]) for order in bench.orders if order.act is DownloadAct.WRITE]


def test_stop_clear_send_start_in_this_order():
    bench = Bench()
    progress = bench.run()
    assert writes(bench) == [(0x1F51, b"\0"), (0x1F51, b"\3"), (0x1F50, b"p"), (0x1F51, b"\1")]
    assert (progress.step, progress.tries) == (DownloadStep.DONE, 1)
    assert (bench.device.program.runs, bench.device.program.image) == (True, NEW)
    assert progress.old != progress.new == bench.device.program.identification
    assert progress.notes == []


def test_a_node_without_program_download_is_reported_and_left_alone():
    bench = Bench()
    bench.device.store.rebase(make_device("eds/TMCM-1270.eds", 5).od)
    with pytest.raises(ConfigError, match="cannot be loaded over CANopen: 0x1F51:01: abort 0x06"):
        bench.run()
    assert writes(bench) == []


def test_a_device_without_identification_and_flash_status_is_borne():
    od = program_od()
    for index in (0x1F56, 0x1F57):
        for sub in (0, 1):
            del od.entries[index, sub]
    progress = Bench(od).run(disturb=lambda _, order: None)
    assert (progress.old, progress.new, progress.step) == (None, None, DownloadStep.DONE)


def test_a_damaged_file_is_refused_with_the_word_of_the_flash():
    bench = Bench()
    with pytest.raises(DriveError, match="not accepted: format or CRC error; the node has no program now"):
        bench.run(NEW[:-1] + b"?")
    assert not bench.device.program.runs
    assert bench.run().tries == 1


def test_a_transfer_that_breaks_off_is_begun_again_with_a_fresh_clear():
    bench, broken = Bench(), []

    def disturb(_number, order):
        if order.index == 0x1F50 and not broken:
            broken.append(order)
            return silent(order)
        return None

    progress = bench.run(disturb=disturb)
    assert progress.tries == 2
    assert writes(bench).count((0x1F51, b"\3")) == 2
    assert bench.device.program.image == NEW


def test_another_identification_than_expected_is_not_started():
    bench = Bench()
    with pytest.raises(DriveError, match="0x00000001 was expected; it was not started"):
        bench.run(options=ProgramOptions(expected=1))
    assert not bench.device.program.runs


def test_an_empty_file_and_a_dead_node_end_it():
    with pytest.raises(ConfigError, match="is empty"):
        Bench().run(b"")
    with pytest.raises(SdoTimeout):
        Bench().run(disturb=lambda _, order: silent(order))
    with pytest.raises(DriveError, match="does not stop"):
        Bench().run(disturb=lambda number, order: silent(order) if number > 4 else None)


@pytest.mark.rest
@settings(max_examples=examples(60))
@given(st.integers(0, 40), st.sampled_from(["power", "silence", "flash"]), st.integers(0, len(NEW)))
def test_after_any_loss_the_next_attempt_succeeds(at, kind, fails_at):
    bench = Bench()
    area = bench.device.program

    def disturb(number, order):
        if number == at and kind == "power":
            bench.power_cut()
            return silent(order)
        if number >= at and kind == "silence":
            return silent(order)
        if number == at and kind == "flash":
            area.fails_at.inject(fails_at)
        return None

    with contextlib.suppress(DriveError, SdoTimeout):
        bench.run(disturb=disturb)
    area.fails_at.clear()
    bench.power_cut()
    bench.run()
    assert (area.runs, area.image) == (True, NEW)


@pytest.mark.parametrize(
    ("status", "text"),
    [
        (0, ""),
        (1, "busy"),
        (6, "format or CRC error"),
        (0xE, "the flash is secured"),
        (0x7E, "unspecified error"),
        (0x1234_0080, "error 64 of the manufacturer (0x1234)"),
        (40, "error 20"),
    ],
)
def test_the_flash_status_is_reported_in_words(status, text):
    assert flash_text(status) == text


def test_a_date_is_compared_as_far_as_commanded():
    day = datetime.date(2025, 1, 25)
    noon = ProgramDate(day, 43_200_000)
    assert (str(noon), str(ProgramDate(day))) == ("2025-01-25 12:00:00", "2025-01-25")
    assert ProgramDate(day).fits(noon)
    assert noon.fits(noon)
    for expected in (ProgramDate(day, 0), ProgramDate(day.replace(day=26))):
        assert not expected.fits(noon)
    assert not noon.fits(None)


@given(days=st.integers(0, 2**32 - 1), milliseconds=st.integers(0, 2**32 - 1))
@settings(max_examples=examples(20))
def test_any_number_is_a_date_or_none(days, milliseconds):
    parts = {1: days, 2: milliseconds}

    def disturb(_number, order):
        if (order.act, order.index) == (DownloadAct.READ, 0x1F52):
            return DownloadAnswer(parts[order.subindex].to_bytes(4, "little"))
        return None

    reported = Bench().run(disturb=disturb).new_date
    assert (reported is None) == (days == 0 or days > 0xFFFF)
    if reported is not None:
        assert (reported.day - datetime.date(1984, 1, 1)).days == days
        assert reported.milliseconds == (milliseconds if milliseconds < 86_400_000 else None)


def test_a_node_that_loses_its_power_while_it_clears_is_given_up_within_a_minute():
    waited = 0.0

    def without_power(_number, order):
        nonlocal waited
        if not waited and order.data != b"\3":
            return None
        waited += 2.0 * (order.seconds or 1.0)  # of two tries
        return silent(order)

    with pytest.raises(DriveError, match=r"the program is not cleared .*, and the node does not answer"):
        Bench().run(disturb=without_power)
    assert 30.0 <= waited <= 70.0


def test_an_erasing_node_is_awaited_and_a_resetting_one_is_polled_again_soon():
    bench = Bench()
    bench.run()
    patience = {}
    for order in bench.orders:
        if order.act is DownloadAct.WRITE:
            patience[order.index, order.data[:1]] = order.seconds
    assert patience[0x1F51, b"\3"] >= 10.0
    assert patience[0x1F50, NEW[:1]] >= 10.0
    assert 0.0 < patience[0x1F51, b"\0"] < 0.25
    assert 0.0 < patience[0x1F51, b"\1"] < 0.25


# -- devices of others


def load_into(device, image=NEW, lost=(), **how):
    """Download into a device of another maker; the transfers numbered `lost` break off half-way."""
    progress, transfers = DownloadProgress(), []
    sequence, outcome = program_download(image, ProgramOptions(**how), progress), None
    for _ in range(2_000):
        try:
            order = next(sequence) if outcome is None else sequence.send(outcome)
        except StopIteration:
            return progress
        outcome = DownloadAnswer()
        device.wait(MS)
        if order.act is DownloadAct.PAUSE:
            device.wait(round(order.seconds * 1e9))
        elif order.act is DownloadAct.PRE_OPERATIONAL:
            device.enter_pre_operational()
        else:
            if order.index == 0x1F50:
                transfers.append(order)
            breaks = order.index == 0x1F50 and len(transfers) in lost
            outcome = answered(device, order, order.data[: len(order.data) // 2] if breaks else order.data)
            outcome = silent(order) if breaks else outcome
    raise AssertionError("it never ends")


def answered(device, order, data):
    try:
        answer = device.read(order.index) if order.act is DownloadAct.READ else device.write(order.index, data)
    except ProgramAbort as abort:
        return DownloadAnswer(error=SdoAbort(5, order.index, order.subindex, abort.code, "refused"))
    if answer is None:
        device.wait(2 * round((order.seconds or 1.0) * 1e9))  # of two tries
        return silent(order)
    return DownloadAnswer(answer)


def test_zephyrs_device_takes_a_program_on_trial():
    device = ZephyrDevice()
    progress = load_into(device)
    assert (device.running, device.status, device.boots) == (NEW, CONFIRM, 1)
    assert "0x1F56 is the CRC-32 of the file" in progress.notes
    device.boot()
    assert device.running == b"old"  # the program was not confirmed


def test_half_a_transfer_to_zephyrs_device_is_cleared_and_begun_again():
    device = ZephyrDevice()
    assert load_into(device, lost=(1,), confirm=True).tries == 2
    assert device.permanent == NEW


def test_a_program_on_trial_is_commanded_to_be_confirmed_first():
    device = ZephyrDevice()
    load_into(device)
    with pytest.raises(DriveError, match=r"on trial.*reset the node"):
        load_into(device)
    assert device.running == NEW


@pytest.mark.parametrize("program", [b"old", b""])
def test_a_loader_that_waits_for_an_sdo_after_a_reset_is_caught(program):
    device = WaitingLoader(program)
    device.boot()
    device.wait(WaitingLoader.boot_ns + WaitingLoader.waits_ns + MS)
    assert device.loading == (not program)
    progress = load_into(device)
    assert (device.program, device.loading, progress.new) == (NEW, False, None)
