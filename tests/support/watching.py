"""A controller and a component that do nothing but write down how they are called; compiled subpackages take both."""

from canopen_control.controllers.base import Controller
from canopen_control.controllers.types import TYPES
from canopen_control.hardware.interfaces import LifecycleState, ReturnType


class Watching(Controller):
    """Keeps (time, period) of each update, and when it really was by `clock`."""

    def __init__(self, name, type_name=""):
        super().__init__(name, type_name)
        self.seen, self.clock = [], lambda: 0

    def update(self, now, period):
        self.seen.append((now, period, self.clock()))
        return ReturnType.OK


class Witness:
    """A component without interfaces that calls `on_read(now, period)` and `on_write`."""

    name, state, simulated_ns = "witness", LifecycleState.ACTIVE, None
    state_interfaces = command_interfaces = ()
    changeable = False

    def __init__(self, on_read=lambda now, period: None, on_write=lambda now, period: None):
        self._on_read, self._on_write = on_read, on_write

    def configure(self):
        pass

    activate = deactivate = cleanup = shutdown = configure

    def prepare_command_mode_switch(self, start, stop):
        pass

    perform_command_mode_switch = prepare_command_mode_switch

    def read(self, now, period):
        self._on_read(now, period)
        return ReturnType.OK

    def write(self, now, period):
        self._on_write(now, period)
        return ReturnType.OK


def watch(bench):
    """Return a list that gets (time, period) of each update of the controllers, and when it really was."""
    TYPES["test/Watching"] = "support.watching:Watching"
    try:
        controller = bench.robot.manager.load("watching", "test/Watching")
    finally:
        del TYPES["test/Watching"]
    controller.clock = bench.reactor.now
    bench.robot.manager.configure("watching")
    bench.robot.manager.switch(["watching"])
    return controller.seen
