"""Request to a running robot without typed messages; the answer consists of dicts, lists, texts and numbers.

For short verbs: importing typing, msgspec and the messages takes longer than everything else that such a verb does.
"""

from __future__ import annotations

import json
import time
from types import SimpleNamespace

from canopen_control.errors import RemoteError
from canopen_control.host.lineclient import LineClient
from canopen_control.host.sockets import socket_path

TYPE_CHECKING = False  # the module typing takes longer to import than this one
if TYPE_CHECKING:
    from typing import Any

PROTOCOL = 2  # equal to that of `rpc.messages.declare`, without its import; a test compares them


def request_plain(robot: str, method: str, timeout: float = 10.0) -> SimpleNamespace | None:
    """Call a method without parameters, and return the fields of the result; RemoteError if no answer arrives.

    None for another protocol version, a refusal or invalid JSON: the typed client reports the cause of these.
    """
    label = f"robot {robot}"
    with LineClient(socket_path("robot", robot), timeout, label=label) as stream:
        greeting = _object_in(stream.receive(timeout), f"{label} does not answer; does it hang?")
        hello = greeting.get("hello")
        if not isinstance(hello, dict) or hello.get("protocol") != PROTOCOL:
            return None
        stream.send(json.dumps({"id": 1, "method": method, "params": {}}).encode() + b"\n", timeout)
        late = f"{label} did not answer {method!r} within {timeout:g} s"
        deadline = time.monotonic() + timeout
        while True:
            answer = _object_in(stream.receive(max(0.0, deadline - time.monotonic())), late)
            if answer.get("id") == 1 or "error" in answer or not answer:
                result = answer.get("result")
                return SimpleNamespace(**result) if isinstance(result, dict) else None


def _object_in(line: bytes | None, late: str) -> dict[str, Any]:
    """Return the JSON object in a line, {} if there is none; RemoteError with the text `late` if `line` is None."""
    if line is None:
        raise RemoteError("Timeout", late)
    try:
        fields = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return fields if isinstance(fields, dict) else {}
