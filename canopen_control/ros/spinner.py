"""The only thread for rclpy's callbacks.

An EventsExecutor where there is one, else a single-threaded one; every wait is finite, because the
endless one of EventsExecutor.spin() is broken in the wheels (a busy loop without callbacks); never a multi-threaded
executor, which loses messages.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Final

from canopen_control.ros.rcl import ExternalShutdownException, Future, make_executor

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.ros.rcl import Context, Node


_WAIT_S: Final = 1.0


class Spinner:
    """Executor thread of nodes, `node` first; `on_error` receives exceptions of callbacks on that thread."""

    def __init__(self, node: Node, context: Context, on_error: Callable[[Exception], object]) -> None:
        self._executor = make_executor(context)
        self._executor.add_node(node)
        self._nodes, self._on_error = [node], on_error
        self._ending = threading.Event()
        self._end = Future()
        self._thread = threading.Thread(target=self._run, name="ros", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self, timeout: float) -> bool:
        """Stop; False if a callback has blocked the thread for `timeout` seconds."""
        self._ending.set()
        self._end.set_result(None)
        self._executor.wake()
        if self._thread.ident is not None:
            self._thread.join(timeout)
        if self._thread.is_alive():
            return False
        for node in self._nodes:
            self._executor.remove_node(node)
        self._executor.shutdown(timeout)
        return True

    def add(self, node: Node) -> None:
        """Add another node; from the thread that calls `stop`."""
        self._nodes.append(node)
        self._executor.add_node(node)

    def remove(self, node: Node) -> None:
        """Remove and destroy a node between two callbacks, or at once after the end."""
        self._nodes.remove(node)

        def end() -> None:
            self._executor.remove_node(node)
            node.destroy_node()

        if self._ending.is_set():
            node.destroy_node()
        else:
            self.call(end)

    def call(self, function: Callable[[], object]) -> None:
        """Run a function in the spinning thread, between callbacks; from any thread."""
        self._executor.create_task(function)

    def _run(self) -> None:
        while not self._ending.is_set():
            try:
                self._executor.spin_until_future_complete(self._end, timeout_sec=_WAIT_S)
            except ExternalShutdownException:
                return
            except Exception as error:  # noqa: BLE001 - the error of a callback is reported, and the next one is called
                self._on_error(error)
