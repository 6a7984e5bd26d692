"""Asking a hub: one request on the control socket of a ``local:`` bus, for the command line and for scripts."""

from __future__ import annotations

from typing import Any

from canopen_control.errors import BusError, ConfigError, RemoteError
from canopen_control.host.lineclient import LineClient
from canopen_control.host.sockets import socket_path

__all__ = ["ask_hub"]

_TIMEOUT_S = 5.0


def ask_hub(name: str, method: str, **params: object) -> dict[str, Any]:
    """Return the result of a request, empty where there is none to speak of (`hubcontrol` has the methods).

    Raise `BusError` if nobody has the bus open or its hub does not answer, `ConfigError` if it refuses the request.
    """
    try:
        client = LineClient(socket_path("busctl", name), _TIMEOUT_S, label=f"bus local:{name}")
    except RemoteError:
        raise BusError(f"bus local:{name}: nobody has it open; canopen-control bus list shows those in use") from None
    try:
        client.send({"id": 1, "method": method, "params": params})
        answer = _answer(client)
    except RemoteError as error:
        raise BusError(f"bus local:{name}: {error}") from error
    finally:
        client.close()
    if answer is None:
        raise BusError(f"bus local:{name}: its hub has not answered for {_TIMEOUT_S:g} s")
    if "error" in answer:
        raise ConfigError(answer["error"]["message"])
    return answer["result"] or {}


def _answer(client: LineClient) -> dict[str, Any] | None:
    while (message := client.receive(_TIMEOUT_S)) is not None:
        if message.get("id") == 1 or "error" in message:
            return message
    return None
