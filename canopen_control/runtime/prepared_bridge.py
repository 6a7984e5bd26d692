"""Process of the ROS bridge that a run starts first: it imports rclpy while the files of the robot are read.

It waits at its gate, without a robot, until the run serves the robot's API; see `Supervisor.start_client`.
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
"""The name of its process."""
_MODULE: Final = "canopen_control.ros.bridge"


def bridge_command(name: str, arguments: Sequence[str]) -> list[str]:
    """Return the module of the bridge of a robot, with its arguments."""
    return [_MODULE, "--name", name, *arguments]


@contextlib.contextmanager
def prepared_bridge(name: str, arguments: Sequence[str]) -> Iterator[Child]:
    """Start the bridge of a robot that does not run yet; it has ended after the block. CanopenError."""
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
