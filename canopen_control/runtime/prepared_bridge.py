"""Early start of the ROS bridge process, which imports rclpy while the robot's files are read.

The process waits, without a robot, until the robot's API is available; see `Supervisor.start_client`.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Final

from canopen_control.host.environment import MODULE
from canopen_control.host.files import state_dir
from canopen_control.host.spawn import spawn

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.host.spawn import Child


BRIDGE: Final = "ros"
"""Process name of the ROS bridge."""
_MODULE: Final = "canopen_control.ros.bridge"


def bridge_command(name: str, arguments: Sequence[str]) -> list[str]:
    """Return the module and arguments that run the ROS bridge of a robot."""
    return [_MODULE, "--name", name, *arguments]


@contextlib.contextmanager
def prepared_bridge(name: str, arguments: Sequence[str]) -> Iterator[Child]:
    """Start the ROS bridge process before the robot, and end it with the context; raise CanopenError on failure."""
    command = bridge_command(name, arguments)
    child = spawn(
        [*MODULE, *command],
        name=BRIDGE,
        log_dir=state_dir(name),
        ros=True,
        reports=True,
        gated=True,
        main=(command[0], command[1:]),
    )
    try:
        yield child
    finally:
        child.discard()
