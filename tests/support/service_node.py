"""The transfers of a service session with a node that is a dictionary of bytes."""

from __future__ import annotations

from canopen_control.errors import SdoAbort


class NodeStub:
    """Holds `objects` by address and keeps a list of what was `written`; `error` is raised instead of any answer."""

    def __init__(self, objects, *, nmt=None):
        self.objects, self.written, self.nmt = dict(objects), [], nmt
        self.reads = []
        self.refused = {}  # address -> abort code of a write
        self.error = None

    def read(self, index, subindex, *, block=False):
        self.reads.append((index, subindex))
        if self.error is not None:
            raise self.error
        if (index, subindex) not in self.objects:
            raise SdoAbort(5, index, subindex, 0x06020000)
        return self.objects[index, subindex]

    def write(self, index, subindex, data):
        if self.error is not None:
            raise self.error
        if (code := self.refused.get((index, subindex))) is not None:
            raise SdoAbort(5, index, subindex, code)
        self.written.append((index, subindex, bytes(data)))
        self.objects[index, subindex] = bytes(data)

    def nmt_state(self):
        return self.nmt

    def set_timeout(self, seconds):
        pass

    def pause(self, seconds):
        pass

    def progress(self):
        return 0, None
