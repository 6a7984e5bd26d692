"""A bus without controllers in simulated time: bus.yml and EDS files alone, CiA 402 drives and others."""

from __future__ import annotations

from support.faultbench import FaultBench
from support.generic import write_generic, write_two_axes
from support.iomodule import io_eds

from canopen_control.errors import CanopenError
from canopen_control.hardware.axis_statechart import Action

IO = 5
_IO_NODE = """
  io_module:
    node_id: 5
    dcf: io.eds
    driver: "ros2_canopen::ProxyDriver"
    package: canopen_proxy_driver
    {extra}
"""


def write_drives(folder, *, io=None, **how):
    """Write two drives, drive_one and drive_two, that have all modes; `io` adds an I/O module with these keys."""
    config = _alone(write_generic(folder, **how))
    if io is not None:
        (config / "io.eds").write_text(io_eds())
        bus = config / "bus.yml"
        head, rest = bus.read_text().split("defaults:\n")
        defaults, nodes = rest.split("nodes:\n")
        nodes = nodes.replace("node_id:", "<<: *drive\n    node_id:")
        bus.write_text(f"{head}.drive: &drive\n{defaults}nodes:\n{nodes}{_IO_NODE.format(extra=io)}")
    return config


def write_two_axis_drive(folder):
    """Write one drive of two axes."""
    return _alone(write_two_axes(folder))


def write_io(folder, *, nested=True):
    """Write an I/O module alone, in either shape of bus.yml."""
    config = folder / "terminals"
    config.mkdir()
    (config / "io.eds").write_text(io_eds())
    node = "io_module: {node_id: 5, dcf: io.eds, driver: 'ros2_canopen::ProxyDriver', package: canopen_proxy_driver}\n"
    (config / "bus.yml").write_text("master: {node_id: 1}\n" + (f"nodes:\n  {node}" if nested else node))
    return config


def _alone(config):
    for name in ("ros2_controllers.yaml", "generic.urdf"):
        (config / name).unlink()
    return config


class AloneBench(FaultBench):
    """The nodes of such a bus; `enable` and `mode` wait for what they ask for."""

    def enable(self, node="all"):
        assert self.axis(Action.ENABLE, node) is None

    def mode(self, name, node="drive_one"):
        assert self.axis(Action.MODE, node, mode=name) is None

    def target(self, value, node="drive_one", holder=None):
        """Give a target; the refusal in words, None where it is taken."""
        try:
            self.robot.command(node, [value], "test", holder=holder)
        except CanopenError as error:
            return str(error)
        return None

    def at(self, interface, node=2):
        return self.joint(node).states[interface].value
