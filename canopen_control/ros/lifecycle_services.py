"""`/lifecycle_manager` and the lifecycle services of master and nodes, which start a ros2_canopen robot.

Rules (lifecycle_msgs; ros2_canopen's lifecycle_manager): the runtime boots the nodes by itself, so that
`configure` finds them, `activate` checks whether they are ready, and `deactivate` stops and disables them; a state
that is reached already is not an error. A transition fails without effect when the robot refuses it. The manager brings
the master and the nodes with lifecycle drivers up with itself, and down again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.ros.endpoint import COMMANDER, Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.rpc.messages.robot import AxisRequest, Stop

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.ros.endpoint import Reply, Ros, RosMessage
    from canopen_control.rpc.messages.state import NodeReading, StateSample

    Done = Callable[[str | None], object]  # a sentence, or None where it was done


class LifecycleTransition(NamedTuple):
    """Row of the table: from any of `sources` to `target`; in the states in `reached` it has already been done."""

    number: int
    label: str
    sources: tuple[str, ...]
    target: str
    reached: tuple[str, ...] = ()


#: lifecycle_msgs/msg/State
STATES: Final = {"unconfigured": 1, "inactive": 2, "active": 3, "finalized": 4}
#: lifecycle_msgs/msg/Transition
TRANSITIONS: Final = (
    LifecycleTransition(1, "configure", ("unconfigured",), "inactive", ("inactive", "active")),
    LifecycleTransition(2, "cleanup", ("inactive",), "unconfigured", ("unconfigured",)),
    LifecycleTransition(3, "activate", ("inactive",), "active", ("active",)),
    LifecycleTransition(4, "deactivate", ("active",), "inactive", ("inactive",)),
    LifecycleTransition(5, "shutdown", ("unconfigured", "inactive", "active"), "finalized", ("finalized",)),
)
#: a transition of the manager -> where the nodes are then (ros2_canopen brings them all the way up and down)
_OF_MEMBERS: Final = {"activate": "active", "deactivate": "unconfigured", "shutdown": "finalized"}
_SHUTDOWN: Final = {6: 5, 7: 5}  # upstream has a number for the shutdown of each state


class LifecycleServices(Endpoint):
    """Lifecycle services below `path` of `node` (None: of all nodes); `members` are the nodes they affect."""

    def __init__(self, ros: Ros, path: str, node: str | None = None, members: Sequence[LifecycleServices] = ()) -> None:
        self._ros, self._path, self._node, self._members = ros, path, node, members
        self._nodes: dict[str, NodeReading] = {}
        self.state = "unconfigured"
        self._state_class = interface("lifecycle_msgs/msg/State")
        table = (
            ("change_state", "ChangeState", self._change),
            ("get_state", "GetState", self._get),
            ("get_available_states", "GetAvailableStates", self._states),
            ("get_available_transitions", "GetAvailableTransitions", self._transitions),
        )
        self._services = [
            ros.serve(f"lifecycle_msgs/srv/{kind}", f"{path}/{name}", handler) for name, kind, handler in table
        ]
        self._actions = {"activate": self._activate, "deactivate": self._deactivate, "shutdown": self._deactivate}

    def on_state(self, state: StateSample) -> None:
        """Update which nodes are ready."""
        self._nodes = state.nodes

    def close(self) -> None:
        """Destroy the services."""
        for service in self._services:
            self._ros.unserve(service)

    def _change(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        wanted = request.transition
        number = _SHUTDOWN.get(wanted.id, wanted.id)
        transitions = [
            transition
            for transition in TRANSITIONS
            if transition.number == number or (not number and transition.label == wanted.label)
        ]

        def done(error: str | None) -> None:
            if error is None:
                self.state = transitions[0].target
                for member in self._members:
                    member.state = _OF_MEMBERS.get(transitions[0].label, member.state)
            else:
                self._ros.warn(self._path, f"{self._path}: {error}")
            response.success = error is None
            reply(response)

        if not transitions:
            done(f"no transition {wanted.id} {wanted.label!r}")
        elif self.state in transitions[0].reached:
            response.success = True
            reply(response)
        elif self.state not in transitions[0].sources:
            done(f"it is {self.state}, which knows no {transitions[0].label}")
        else:
            self._actions.get(transitions[0].label, lambda answer: answer(None))(done)

    def _activate(self, done: Done) -> None:
        wanted = list(self._nodes) if self._node is None else [self._node]
        nodes = {name: self._nodes.get(name) for name in wanted}
        late = [
            f"{name}: {(node and node.error) or 'not ready'}"
            for name, node in nodes.items()
            if node is None or not node.ready
        ]
        done("; ".join(late) or None)

    @property
    def _moves(self) -> bool:
        """Whether the node has an axis that could be disabled."""
        node = self._nodes.get(self._node or "")
        return node is not None and bool(node.axes)

    def _deactivate(self, done: Done) -> None:
        if self.state != "active" or (self._node is not None and not self._moves):
            done(None)
        elif self._node is None:
            self._ros.ask(Stop(), lambda _done, error: done(error))
        else:
            self._ros.ask(
                AxisRequest(action="disable", node=self._node, source=COMMANDER), lambda _done, error: done(error)
            )

    def _get(self, _request: RosMessage, response: RosMessage, reply: Reply) -> None:
        response.current_state = self._message(self.state)
        reply(response)

    def _states(self, _request: RosMessage, response: RosMessage, reply: Reply) -> None:
        response.available_states = [self._message(state) for state in STATES]
        reply(response)

    def _transitions(self, _request: RosMessage, response: RosMessage, reply: Reply) -> None:
        make = interface("lifecycle_msgs/msg/TransitionDescription")
        transition = interface("lifecycle_msgs/msg/Transition")
        response.available_transitions = [
            make(
                transition=transition(id=entry.number, label=entry.label),
                start_state=self._message(self.state),
                goal_state=self._message(entry.target),
            )
            for entry in TRANSITIONS
            if self.state in entry.sources
        ]
        reply(response)

    def _message(self, label: str) -> RosMessage:
        return self._state_class(id=STATES[label], label=label)
