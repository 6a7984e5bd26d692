"""A python-can adapter that does what a test says."""

from __future__ import annotations

import queue
import threading

import can


class ScriptedBus(can.BusABC):
    """An adapter whose receiving and sending do what a test says."""

    def __init__(self):
        self.incoming = queue.Queue()
        self.sent = queue.Queue()
        self.send_errors = queue.Queue()
        self.stopped = threading.Event()
        super().__init__(channel="scripted")

    def _recv_internal(self, timeout):
        try:
            item = self.incoming.get(timeout=min(timeout, 0.01))
        except queue.Empty:
            return None, False
        if isinstance(item, Exception):
            raise item
        return item, False

    def send(self, msg, timeout=None):
        if not self.send_errors.empty():
            raise self.send_errors.get()
        self.sent.put(msg)

    def shutdown(self):
        super().shutdown()
        self.stopped.set()
