"""Program download with every frame of it: block transfer to a virtual device, with losses at any block."""

import zlib
from dataclasses import replace

import pytest
from support.parameter_node import session_with
from support.programs import program_od

from canopen_control.bus.arbitration import frame_bits
from canopen_control.cia301.nmt import NmtCommand
from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.errors import BusClosed, ConfigError, DriveError, SdoTimeout
from canopen_control.service.node_session import NodeSession
from canopen_control.service.parameter_set import DeviceIdentity, device_identity
from canopen_control.service.program_download import (
    DownloadProgress,
    ProgramOptions,
    boot_check,
    download,
    is_loader,
    refuse_stranger,
)
from canopen_control.virtual.device import make_device
from canopen_control.virtual.program_area import whole_program

MS = 1_000_000
BLOCK = 889  # bytes: 127 segments of 7
NEW = whole_program(bytes(range(256)) * 208)  # 60 blocks
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

    def be_patient(self, seconds):
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


@pytest.fixture
def frames():
    return Frames(make_device(program_od(), 5))


def load(frames, **how):
    progress = DownloadProgress()
    session = NodeSession(frames, 5, frames.device.od)
    download(session, NEW, ProgramOptions(**how), progress, pause=lambda s: frames.advance(round(s * 1e9)))
    return progress


@pytest.mark.parametrize("block", range(0, 60, 10))
def test_after_a_kill_at_every_tenth_block_the_next_attempt_succeeds(frames, block):
    frames.cut, frames.what = 1 + block * SEGMENTS, "kill"
    with pytest.raises(Killed):
        load(frames)
    assert not frames.device.program.runs
    frames.client = SdoClient(5)  # another process
    load(frames)
    assert (frames.device.program.runs, frames.device.program.image) == (True, NEW)


@pytest.mark.parametrize("block", range(0, 60, 20))
def test_after_a_power_cut_at_every_twentieth_block_it_begins_anew(frames, block):
    frames.cut, frames.what = 1 + block * SEGMENTS, "power"
    progress = load(frames)
    assert progress.tries == 2
    assert (frames.device.program.runs, frames.device.program.image) == (True, NEW)


def test_with_one_try_the_loss_is_told_and_the_loader_waits(frames):
    frames.cut, frames.what = 500, "power"
    with pytest.raises(DriveError, match=r"not taken: .*waits in its boot-loader"):
        load(frames, tries=1)
    session = NodeSession(frames, 5, frames.device.od)
    assert is_loader(device_identity(session))
    load(frames)
    assert not is_loader(device_identity(session))


def test_the_loader_needs_no_eds(frames):
    frames.command(NmtCommand.ENTER_PRE_OPERATIONAL)
    frames.write(0x1F51, 1, b"\0")
    frames.advance(500 * MS)
    session = NodeSession(frames, 5, None)
    assert is_loader(device_identity(session))
    assert session.powered_axes() == []
    progress = DownloadProgress()
    download(session, NEW, ProgramOptions(), progress, pause=lambda s: frames.advance(round(s * 1e9)))
    assert progress.new == zlib.crc32(NEW[:-4])


def test_a_stranger_is_refused_but_its_loader_is_not(frames):
    session = NodeSession(frames, 5, frames.device.od)
    refuse_stranger(session, device_identity(session))
    session.od = replace(
        session.od, entries={**session.od.entries, (0x1018, 2): replace(session.od[0x1018, 2], default=7)}
    )
    with pytest.raises(ConfigError, match="node 5 is no device of that EDS: product"):
        refuse_stranger(session, device_identity(session))
    refuse_stranger(session, DeviceIdentity(device_type=0))
    session.od = replace(
        session.od, entries={**session.od.entries, (0x1018, 1): replace(session.od[0x1018, 1], default=8)}
    )
    with pytest.raises(ConfigError, match="no device of that EDS: vendor"):
        refuse_stranger(session, DeviceIdentity(device_type=0))


def test_the_boot_check_knows_the_loader_and_another_product(frames):
    session = NodeSession(frames, 5, frames.device.od)
    before = device_identity(session)
    assert boot_check(session, before) == before
    with pytest.raises(DriveError, match="is another product with the new program"):
        boot_check(session, replace(before, product=9))
    frames.write(0x1F51, 1, b"\0")
    frames.advance(500 * MS)
    with pytest.raises(DriveError, match="shows its boot-loader"):
        boot_check(session, before)


def test_errors_of_the_bus_are_no_answers():
    session = session_with(program_od())
    session.transfers.device.store.on_read(0x1F51, 1, lambda: 0)

    def gone(*_, **__):
        raise BusClosed("can0", "gone")

    session.transfers.write = gone
    with pytest.raises(BusClosed):
        download(session, NEW, ProgramOptions(), DownloadProgress(), pause=lambda _: None)
    session.transfers.silent_from = 0
    with pytest.raises(SdoTimeout):
        download(session, NEW, ProgramOptions(), DownloadProgress(), pause=lambda _: None)


def test_block_transfer_has_80_percent_of_what_the_bit_rate_allows(frames):
    """At 1 Mbit/s block transfer can carry some 51 kB/s: 127 segments of 7 bytes for each acknowledge."""
    bits = []
    receive, send = frames.device.receive, frames.device.frames

    def heard(frame, now):
        bits.append(frame_bits(frame.can_id, frame.data))
        receive(frame, now)

    def said():
        out = send()
        bits.extend(frame_bits(frame.can_id, frame.data) for frame in out)
        return out

    frames.device.receive, frames.device.frames = heard, said
    load(frames)
    assert len(NEW) / (sum(bits) / 1_000_000) > 0.8 * 51_000
