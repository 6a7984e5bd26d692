"""A scripted node for the boot's generator: it answers requests from a dictionary and keeps what is written."""

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.errors import SdoAbort, SdoTimeout
from canopen_control.master.plan import NodePlan
from canopen_control.master.requests import (
    AwaitBootUp,
    AwaitHeartbeat,
    AwaitState,
    NextStep,
    Read,
    SendNmt,
    WriteObject,
)
from canopen_control.rpc.messages.robot import NodeIdentity

IDENTITY = {
    (0x1000, 0): (0x192).to_bytes(4, "little"),
    (0x1018, 1): (0x286).to_bytes(4, "little"),
    (0x1018, 2): (0x4F6).to_bytes(4, "little"),
    (0x1018, 3): (0x3001A).to_bytes(4, "little"),
    (0x1018, 4): (7).to_bytes(4, "little"),
}
READ_ONLY, NO_OBJECT, WRONG_STATE = 0x06010002, 0x06020000, 0x08000022


def plan(**changes):
    values = {
        "name": "left_drive",
        "node_id": 3,
        "source": "test.eds",
        "identity": NodeIdentity(device_type=0x192, vendor_id=0x286, product_code=0x4F6),
        "writes": (),
        "rpdos": (),
        "tpdos": (),
        "axes": (),
        "heartbeat_timeout_ns": 300_000_000,
    }
    return NodePlan(**{**values, **changes})


class Device:
    """What a node holds, and how it behaves: `refuse` (index, subindex) -> abort code, or a function of the write.

    `log` is every request; `written` the downloads it took. `clamp` (index, subindex) -> what it holds instead. It is
    OPERATIONAL after so many START commands.
    """

    def __init__(
        self,
        objects=(),
        *,
        refuse=(),
        clamp=(),
        state=NmtState.PRE_OPERATIONAL,
        silent=False,
        heartbeats=True,
        starts_after=1,
    ):
        self.objects = {**IDENTITY, **dict(objects)}
        self.refuse, self.clamp, self.state, self.silent = dict(refuse), dict(clamp), state, silent
        self.heartbeats, self.starts_after = heartbeats, starts_after
        self.log, self.written, self.boots = [], [], True

    def answer(self, request):
        self.log.append(request)
        match request:
            case Read(index, subindex):
                return self._read(index, subindex)
            case WriteObject(index, subindex, data):
                return self._write(index, subindex, data)
            case SendNmt(NmtCommand.START):
                if self.commands.count(NmtCommand.START) >= self.starts_after:
                    self.state = NmtState.OPERATIONAL
            case SendNmt():
                self.state = NmtState.PRE_OPERATIONAL
            case AwaitBootUp():
                return self.boots
            case AwaitHeartbeat():
                return self.state
            case AwaitState(_, state):
                return self.heartbeats and self.state is not None and state in (None, self.state)
        return None

    def _read(self, index, subindex):
        if self.silent:
            raise SdoTimeout(3, index, subindex, 1.0)
        if (index, subindex) not in self.objects:
            raise SdoAbort(3, index, subindex, NO_OBJECT, "object does not exist")
        return self.objects[index, subindex]

    def _write(self, index, subindex, data):
        refusal = self.refuse.get((index, subindex))
        if callable(refusal):
            refusal = refusal(self, data)
        if refusal:
            raise SdoAbort(3, index, subindex, refusal, "refused")
        self.written.append((index, subindex, data))
        self.objects[index, subindex] = self.clamp.get((index, subindex), data)

    def run(self, generator):
        """Let the generator ask until it ends; return its result, or raise what it raises."""
        answer, error = None, None
        while True:
            try:
                request = generator.throw(error) if error is not None else generator.send(answer)
            except StopIteration as end:
                return end.value
            answer, error = None, None
            try:
                answer = self.answer(request)
            except (SdoAbort, SdoTimeout) as refusal:
                error = refusal

    @property
    def steps(self):
        return [request.name for request in self.log if isinstance(request, NextStep)]

    @property
    def commands(self):
        return [request.command for request in self.log if isinstance(request, SendNmt)]
