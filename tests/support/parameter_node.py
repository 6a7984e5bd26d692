"""A service session with a virtual device, with no bus in between: its object dictionary answers at once."""

from __future__ import annotations

from canopen_control.cia301.abort import abort_text
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cli.support.job_verb import job_options, print_restored, verb_run
from canopen_control.cli.support.open_session import reached
from canopen_control.commissioning.jobs import RESTORE
from canopen_control.commissioning.node_session import NodeSession
from canopen_control.commissioning.parameter_jobs import run_restore
from canopen_control.errors import SdoAbort, SdoTimeout
from canopen_control.virtual.device import make_device

BOOTED = 1_000_000_000


class DeviceTransfers:
    """`written` lists the addresses of downloads, after `silent_from` of them it is silent; `lacking` it has not."""

    def __init__(self, device):
        self.device, self.written, self.commands = device, [], []
        self.silent_from, self.lacking, self.robot_leaves_it = None, set(), True
        device.tick(BOOTED)
        device.frames()

    def read(self, index, subindex, *, block=False):
        self._answer(index, subindex)
        try:
            return self.device.store.upload(index, subindex)
        except SdoServerAbort as refusal:
            raise SdoAbort(self.device.node_id, index, subindex, refusal.code, abort_text(refusal.code)) from None

    def write(self, index, subindex, data):
        self._answer(index, subindex)
        try:
            self.device.store.download(index, subindex, data)
        except SdoServerAbort as refusal:
            raise SdoAbort(self.device.node_id, index, subindex, refusal.code, abort_text(refusal.code)) from None
        self.written.append((index, subindex))

    def _answer(self, index, subindex):
        if self.silent_from is not None and len(self.written) >= self.silent_from:
            raise SdoTimeout(self.device.node_id, index, subindex, 0.5)
        if (index, subindex) in self.lacking:
            raise SdoAbort(self.device.node_id, index, subindex, 0x06020000, "object does not exist")

    def command(self, command):
        self.commands.append(command)
        self.device.command(command, BOOTED)

    def nmt_state(self):
        return self.device.nmt.state

    def taken_out(self):
        return self.robot_leaves_it

    def set_timeout(self, seconds):
        pass

    def pause(self, seconds):
        pass

    def progress(self):
        return 0, None


def session_with(od, node_id=5, *, robot="", serial=None):
    """Return a session with a virtual device of a dictionary."""
    device = make_device(od, node_id, serial=serial)
    return NodeSession(DeviceTransfers(device), node_id, device.od, robot=robot)


def restored(session, file, args):
    """Restore a file into a node as the verb does with these arguments; return the exit code."""
    options = job_options(args, RESTORE, reached=reached(args))
    with verb_run(RESTORE) as run:
        sentence = run_restore(session, run, file, options)
    return print_restored(args, run, sentence)
