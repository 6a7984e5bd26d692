"""ROS bridge process: `python -m canopen_control.ros.bridge --name ROBOT [--namespace NS] [--ros-args ...]`.

The process has one context and one node of its own. An unusable ROS environment is reported in one sentence with exit
code 1, before rclpy is imported. A bridge started by `run`, before the robot exists, waits at its gate; it ends with
its lifeline or with the robot, and is killed when one of its threads hangs. A bridge started manually waits for the
robot to return; SIGTERM and SIGINT end it within two seconds, even if rclpy blocks.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import threading
from typing import TYPE_CHECKING, Final

from canopen_control.client import RobotClient, select_robot
from canopen_control.errors import CanopenError
from canopen_control.host.lifeline import LivenessReport, gate_fd, lifeline_fd
from canopen_control.host.quick_start import quick_start
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import SocketInUse, claim, runtime_dir
from canopen_control.ros.bridge_options import BridgeOptions, with_parameters
from canopen_control.ros.installation import describe, from_wheels, prepare, require_ros

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.ros.session import RosSession


NODE_NAME: Final = "canopen_control_bridge"
_RETRY_NS: Final = 500_000_000
_ANSWER_NS: Final = 500_000_000
_SIM_TIME: Final = (
    "use_sim_time: stamps are the time on /clock, and 0 until a program publishes /clock; timeouts use the robot's own "
    "clock. A simulated robot publishes /clock itself."
)
_TIMEOUT_S: Final = 2.0  # for the robot's answers
_ENDING_S: Final = 3.0  # a bridge ends within two seconds of its robot
_RCLPY_END_S: Final = 1.5  # for rclpy's shutdown


def main(argv: Sequence[str] | None = None) -> int:
    """Run the bridge until it is stopped; return the exit code: 0, or 1 if the bridge could not start."""
    arguments, ros_arguments = _parse(list(sys.argv[1:] if argv is None else argv))
    try:
        require_ros()
        prepare(os.environ, wheels=from_wheels(), prefix=sys.prefix)
        bridge = Bridge(arguments, ros_arguments)
    except CanopenError as error:
        _print(str(error))
        return 1
    return bridge.run()


def _parse(argv: list[str]) -> tuple[argparse.Namespace, list[str]]:
    """Parse the arguments before `--ros-args`; return the result and the remaining arguments, which are for ROS."""
    split = argv.index("--ros-args") if "--ros-args" in argv else len(argv)
    parser = argparse.ArgumentParser(
        prog="python -m canopen_control.ros.bridge", description="Connect a robot to ROS 2."
    )
    parser.add_argument("--name", help="name of the robot (default: the only running robot)")
    parser.add_argument(
        "--namespace", default="", help="ROS namespace of all relative names, for several robots in one graph"
    )
    parser.add_argument(
        "--rate",
        type=float,
        default=0.0,
        metavar="HZ",
        help="maximum publishing rate in Hz (default: the rates of the controllers)",
    )
    parser.add_argument(
        "--tf", action=argparse.BooleanOptionalAction, default=True, help="publish /tf and /tf_static (default: on)"
    )
    parser.add_argument("--frame-prefix", metavar="PREFIX", help="prefix of every frame name (default: the namespace)")
    return parser.parse_args(argv[:split]), argv[split:]


def _print(text: str) -> None:
    sys.stderr.write(f"canopen-control: {text}\n")
    sys.stderr.flush()


def _claim(robot: str, timeout: float) -> int:
    """Lock the robot for this bridge and return the file descriptor; raise CanopenError if another bridge has the lock.

    Two bridges would send each command twice. `timeout` in s is the time that a bridge of a previous run gets to end.
    """
    domain = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    safe = domain if domain.isdecimal() else "x"
    try:
        return claim(runtime_dir() / f"bridge-{robot}-{safe}.lock", timeout)
    except SocketInUse as error:
        raise CanopenError(
            f"{robot} already has a ROS bridge in domain {domain}, process {error.pid or 'unknown'}; end that bridge "
            f"first, or set another ROS_DOMAIN_ID for this one"
        ) from None


def _session_type() -> type[RosSession]:
    """Import and return RosSession; the import also loads the message types of all endpoints."""
    with quick_start():
        from canopen_control.ros.session import RosSession
    return RosSession


class Bridge:
    """Bridge process with its own ROS node, and a session while the robot is running."""

    def __init__(self, arguments: argparse.Namespace, ros_arguments: list[str]) -> None:
        self._arguments = arguments
        self._lifeline, self._gate = lifeline_fd(), gate_fd()
        self._name, self._claim, self._code, self._last_reason = "", -1, 0, ""
        if self._gate is None:
            self._take_robot()
        self._session: RosSession | None = None
        self._liveness, self._has_answered = LivenessReport(), True
        self._reactor = Reactor()
        self._reactor.handle_signals({signal.SIGTERM: self._reactor.stop, signal.SIGINT: self._reactor.stop})
        if self._lifeline is not None:
            self._reactor.add_reader(self._lifeline, self._reactor.stop)
        with quick_start():
            self._start_ros(arguments.namespace, ros_arguments)

    def _take_robot(self) -> None:
        """Select and lock the robot; raise CanopenError if it is not running or another bridge has the lock."""
        self._name = select_robot(self._arguments.name)
        self._claim = _claim(self._name, _ENDING_S if self._lifeline is not None else 0.0)

    def _start_ros(self, namespace: str, ros_arguments: list[str]) -> None:
        try:
            from canopen_control.ros.rcl import error_text, start
        except Exception as error:
            raise CanopenError(f"ROS 2 could not be started: {error}") from error
        try:
            self._context, self._node = start(NODE_NAME, namespace, ros_arguments)
        except Exception as error:
            raise CanopenError(f"ROS 2 could not be started: {error_text(error)}") from error
        options = BridgeOptions(self._arguments.rate, self._arguments.tf, self._frame_prefix())
        self._options = with_parameters(self._node, options)
        if self._node.get_parameter("use_sim_time").value:
            _print(_SIM_TIME)

    def run(self) -> int:
        """Run until the bridge is stopped, then leave the graph; return 0, or 1 if the robot is missing or locked."""
        if self._gate is None:
            self._begin()
        else:
            _session_type()
            self._reactor.add_reader(self._gate, self._pass_gate)
        self._reactor.run()
        self._close()
        return self._code

    def _pass_gate(self) -> None:
        """Start the session once the parent has written to the gate; stop if the parent has closed it."""
        gate, self._gate = self._gate, None
        if gate is None:
            return
        self._reactor.remove_reader(gate)
        is_open = bool(os.read(gate, 1))
        os.close(gate)
        try:
            if is_open:
                self._take_robot()
                self._begin()
            else:
                self._reactor.stop()
        except CanopenError as error:
            _print(str(error))
            self._code = 1
            self._reactor.stop()

    def _begin(self) -> None:
        _print(f"ROS bridge of {self._name}: {describe(os.environ)}")
        self._reactor.call_soon(self._connect)
        if self._liveness.is_asked_for:
            self._reactor.call_soon(self._ask_ros)

    def _ask_ros(self) -> None:
        """Report to `run` periodically that the reactor's thread and the callback thread are running."""
        if self._session is not None and self._has_answered:
            self._has_answered = False
            self._session.call(self._answer)
        self._reactor.call_later(_ANSWER_NS, self._ask_ros)

    def _answer(self) -> None:
        self._liveness.beat()
        self._has_answered = True

    def _connect(self) -> None:
        """Connect to the robot; on failure, a bridge started manually retries, and a child of `run` stops."""
        client: RobotClient | None = None
        try:
            client = RobotClient.connect(self._name, _TIMEOUT_S)
            session = _session_type()(self._node, self._context, self._reactor, client, self._options, self._on_end)
            self._session = session
            session.open()
            self._last_reason = ""
        except CanopenError as error:
            if client is not None:
                client.close()
            self._on_end(str(error))

    def _frame_prefix(self) -> str:
        prefix = self._arguments.frame_prefix
        namespace = str(self._node.get_namespace()).strip("/")
        return str(prefix) if prefix is not None else f"{namespace}/" if namespace else ""

    def _on_end(self, reason: str) -> None:
        if reason != self._last_reason:  # a bridge that waits for its robot retries twice a second
            self._last_reason = reason
            _print(reason)
        if self._lifeline is not None:
            self._reactor.stop()
            return
        self._end_session()
        self._reactor.call_later(_RETRY_NS, self._connect)

    def _end_session(self) -> bool:
        """Close the session, if any; return False if an rclpy thread does not return."""
        session, self._session = self._session, None
        return session is None or session.close()

    def _close(self) -> None:
        """Leave the ROS graph; end the process if a thread does not return from rclpy."""
        kill_timer = threading.Timer(_RCLPY_END_S, os._exit, (0,))
        kill_timer.daemon = True
        kill_timer.start()
        if not self._end_session():
            os._exit(0)  # rclpy aborts when its executor is torn down under a callback
        with contextlib.suppress(Exception):
            self._node.destroy_node()
            self._context.try_shutdown()
        self._reactor.close()
        if self._claim >= 0:
            os.close(self._claim)
        kill_timer.cancel()


if __name__ == "__main__":
    sys.exit(main())
