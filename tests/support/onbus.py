"""Who is at the other end of a bus while a test waits on its own: devices or single cores, on their own thread."""

from __future__ import annotations

import contextlib
import threading
from typing import TYPE_CHECKING

from support.lockstep import lockstep

from canopen_control.bus.channel import open_port
from canopen_control.data_files import data_path
from canopen_control.frame import CanFrame, frames_of, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.version import PURE, build
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeHost

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

TMCM, GENERIC = "TMCM-1270.eds", "generic_cia402.eds"


class OnBus:
    """`devices` (EDS names by node-ID) and `cores` (sans-IO) on `channel`, as long as the `with` block lasts.

    `plant` makes the plant of an axis. `seen` holds every frame that reached the cores. The constructor has opened the
    port: whoever joins afterwards is heard. `nodes` are the virtual devices by node-ID. The memory bus is in
    virtual time, with all that the test itself waits for, unless `real_time` is set or the package is compiled.
    """

    def __init__(
        self,
        channel: str,
        devices: Mapping[int, str] | None = None,
        cores: tuple[Any, ...] = (),
        plant: Any = None,
        *,
        real_time: bool = False,
    ) -> None:
        self.channel = channel
        self._time = contextlib.ExitStack()
        if channel.startswith("memory:") and not real_time and build() == PURE:  # a compiled reactor waits by itself
            self._time.enter_context(lockstep())
        self.reactor = Reactor()
        self.errors: list[BaseException] = []
        self.reactor.on_error = self.errors.append
        self.cores, self.seen = cores, list[CanFrame]()
        more = {} if plant is None else {"plant": plant}
        self.nodes = {
            node_id: make_device(data_path("eds", eds), node_id, **more) for node_id, eds in (devices or {}).items()
        }
        self._ports = []
        if self.nodes:
            self._ports.append(open_port(channel, label="devices"))
            self._host = NodeHost(self.reactor, self._ports[0], list(self.nodes.values()))
        if cores:
            self._port = open_port(channel, label="cores")
            self._ports.append(self._port)
            self.reactor.add_reader(self._port, self._receive)
        self._thread = threading.Thread(target=self.reactor.run, name="on the bus")

    def __enter__(self) -> OnBus:
        self._thread.start()
        self.call(lambda: None)  # the devices are powered on
        return self

    def __exit__(self, *_: object) -> None:
        self.reactor.call_threadsafe(self.reactor.stop)
        self._thread.join(60)
        assert not self._thread.is_alive()
        for port in self._ports:
            port.close()
        self.reactor.close()
        self._time.close()
        assert self.errors == []

    def call(self, work: Any) -> Any:
        """Run `work` on the thread of the devices and return its result."""
        done, results = threading.Event(), []

        def run() -> None:
            results.append(work())
            done.set()

        self.reactor.call_threadsafe(run)
        assert done.wait(60)
        return results[0]

    def send(self, *frames: CanFrame) -> None:
        """Send frames from the cores' port."""
        self.call(lambda: self._port.send(pack_records(frames)))

    def _receive(self) -> None:
        now = self.reactor.now()
        for frame in frames_of(self._port.receive()):
            self.seen.append(frame)
            for core in self.cores:
                core.receive(frame, now)
                answers = core.frames()
                if answers:
                    self._port.send(pack_records(answers))
