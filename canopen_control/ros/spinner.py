"""Thread that runs all callbacks of rclpy.

The executor is an EventsExecutor if available, else single-threaded; every wait is finite, because the endless wait of
EventsExecutor.spin() is broken in the wheels (a busy loop without callbacks). A multi-threaded executor is never used,
because it loses messages.
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
    """Thread that runs the callbacks of `node` and of added nodes; `on_error` receives their exceptions there."""

    def __init__(self, node: Node, context: Context, on_error: Callable[[Exception], object]) -> None:
        self._executor = make_executor(context)
        self._executor.add_node(node)
        self._nodes, self._on_error = [node], on_error
        self._ending = threading.Event()
        self._end = Future()
        self._thread = threading.Thread(target=self._run, name="ros", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout: float) -> bool:
        """Stop the thread and remove all nodes; return False if a callback blocks it for `timeout` s."""
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
        """Add a node; call only from the thread that calls `stop`."""
        self._nodes.append(node)
        self._executor.add_node(node)

    def remove(self, node: Node) -> None:
        """Remove and destroy a node between two callbacks, or at once after `stop`."""
        self._nodes.remove(node)

        def end() -> None:
            self._executor.remove_node(node)
            node.destroy_node()

        if self._ending.is_set():
            node.destroy_node()
        else:
            self.call(end)

    def call(self, function: Callable[[], object]) -> None:
        """Run a function on the spinning thread, between callbacks; from any thread."""
        self._executor.create_task(function)

    def _run(self) -> None:
        while not self._ending.is_set():
            try:
                self._executor.spin_until_future_complete(self._end, timeout_sec=_WAIT_S)
            except ExternalShutdownException:
                return
            except Exception as error:  # noqa: BLE001 - an error in a callback is reported, and spinning continues
                self._on_error(error)
