"""Invariants of clients: one that hangs holds up neither the robot nor other clients, and is not kept for ever.

That a command ends with its client, and with its time-out, is judged by what the shafts do (`motion_rules`). Times in
ns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.simulation.simulated_clients import SimulatedClient, SimulatedClients
    from canopen_control.simulation.simulated_robot import SimulatedRobot

__all__ = ["ClientRules"]

_MS: Final = 1_000_000
_ANSWER_NS: Final = 1000 * _MS  # in which an answer comes, though others hang: newcomers may stay idle for half of it
_DEAF_NS: Final = 5000 * _MS  # after which who reads nothing has got more than is kept for anybody


class ClientRules:
    """Judges how a robot serves its clients; `tell(rule, text)` takes breaches. `sampled` is called as time passes."""

    def __init__(self, robot: SimulatedRobot, clients: SimulatedClients, tell: Callable[[str, str], None]) -> None:
        self._robot, self._clients, self._tell = robot, clients, tell
        self._blocked = 0
        self._told: set[SimulatedClient] = set()

    def sampled(self, now: int) -> None:
        """Judge how clients fare now."""
        if self._clients.blocked > self._blocked:
            self._blocked = self._clients.blocked
            self._tell("client_blocks", "the robot waits for a client that does not read")
        host = self._robot.host
        if not self._robot.up or now < host.stalled_until:
            return
        for client in self._clients.all:
            if client.here and client not in self._told:
                self._judge(client, now, max(host.stalled_until, self._robot.started_ns))

    def _judge(self, client: SimulatedClient, now: int, since: int) -> None:
        if client.reads and client.waits_since is not None and now - max(client.waits_since, since) > _ANSWER_NS:
            self._say(client, "client_waits", f"a client has waited for an answer for {_ANSWER_NS // _MS} ms")
        elif not client.reads and client.asks and not client.dropped and now - max(client.came_ns, since) > _DEAF_NS:
            self._say(client, "client_kept", f"a client that reads nothing is kept for {_DEAF_NS // _MS} ms")

    def _say(self, client: SimulatedClient, rule: str, text: str) -> None:
        self._told.add(client)
        self._tell(rule, text)
