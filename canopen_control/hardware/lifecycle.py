"""The lifecycle verbs of a component: a verb that does not fit the state does nothing."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from mypy_extensions import mypyc_attr

from canopen_control.hardware.interfaces import LifecycleState

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.rpc.messages.drive import WorldAct
    from canopen_control.rpc.messages.simulation import LaserScanReading

__all__ = ["Lifecycle"]


@mypyc_attr(allow_interpreted_subclasses=True)
class Lifecycle(ABC):
    """`state`, and the verbs between the states; what a component does on the way are its `_begin` and `_rest`."""

    def __init__(self) -> None:
        self.state = LifecycleState.UNCONFIGURED

    @property
    def simulated_ns(self) -> int | None:
        """None: it runs in real time."""
        return None

    @property
    def changeable(self) -> bool:
        """False: no physics moves it."""
        return False

    def configure(self) -> None:
        """Let the states become known."""
        if self.state is LifecycleState.UNCONFIGURED:
            self._begin()
            self.state = LifecycleState.INACTIVE

    def activate(self) -> None:
        """Allow commands."""
        if self.state is LifecycleState.INACTIVE:
            self.state = LifecycleState.ACTIVE

    def deactivate(self) -> None:
        """Come to rest."""
        if self.state is LifecycleState.ACTIVE:
            self._rest()
            self.state = LifecycleState.INACTIVE

    def cleanup(self) -> None:
        """Go back to the start."""
        self.deactivate()
        if self.state is LifecycleState.INACTIVE:
            self.state = LifecycleState.UNCONFIGURED

    def shutdown(self) -> None:
        """End for good."""
        self.deactivate()
        self.state = LifecycleState.FINALIZED

    def reset(self, keyframe: str) -> None:  # noqa: B027 - most have nothing to do
        """Do nothing: nothing is simulated."""

    def act(self, what: WorldAct) -> None:  # noqa: B027 - as above
        """Do nothing: it is in no world."""

    def scan(self) -> Sequence[LaserScanReading]:
        """Return nothing: it has no lidars."""
        return ()

    @abstractmethod
    def _begin(self) -> None:
        """Make the states known."""

    @abstractmethod
    def _rest(self) -> None:
        """Stop what moves."""
