"""Observers that hand what they are called with to functions."""

from __future__ import annotations

from typing import Any

from canopen_control.runtime.observer import RobotObserver
from canopen_control.simulation.robot_under_test import SimulationObserver


class _Calls:
    """Calls the functions that it was given by the names of an observer's methods."""

    def __init__(self, **calls: Any) -> None:
        self._calls = calls

    def _call(self, name: str, *args: Any) -> None:
        if name in self._calls:
            self._calls[name](*args)


class Observer(_Calls, RobotObserver):
    """An observer of a robot, such as `Observer(after_cycle=times.append)`."""

    def event(self, event):
        self._call("event", event)

    def booted(self):
        self._call("booted")

    def running(self):
        self._call("running")

    def stopped(self):
        self._call("stopped")

    def after_cycle(self, now):
        self._call("after_cycle", now)


class Watch(_Calls, SimulationObserver):
    """An observer of a simulated robot, such as `Watch(event=events.append)`."""

    def event(self, event):
        self._call("event", event)

    def played(self, now, act):
        self._call("played", now, act)

    def requested(self, now, act):
        self._call("requested", now, act)

    def applied(self, now, act):
        self._call("applied", now, act)

    def goal(self, now, act, goal):
        self._call("goal", now, act, goal)
