"""Generate the pages of the sockets from the declarations of their methods."""

from __future__ import annotations

import inspect
import re
from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.rpc.messages.declare import Api

__all__ = ["drive_socket", "hub_socket", "robot_socket"]

_ROBOT = """# The socket of a robot

All other processes talk to the robot here: the command line, the ROS bridge, the page, your programs.
The socket is `$XDG_RUNTIME_DIR/canopen_control/robot-NAME.sock`, private to its user. Each message is a JSON object on
one line:

    {"id": 1, "method": "command", "params": {"controller": "robby_forward_controller", "values": [10, 10]}}
    {"id": 1, "result": {}}
    {"id": 2, "error": {"kind": "NotEnabled", "message": "left_drive is not enabled ..."}}

A request without an id is not answered. Unknown fields in a request are refused; ignore unknown fields in an answer.
A number that is not finite is null, bytes are base64. The robot sends a greeting first, with the protocol number. In
the table a question mark denotes an optional parameter. Answers may arrive in a different order than the requests.

In Python use `RobotClient`, which is fully typed; each method is a class of `canopen_control.rpc.messages.robot`:

```{literalinclude} ../examples/state_stream.py
```

Without this package ten lines of code are enough, in any language:

```{literalinclude} ../examples/bare_socket.py
```
"""
_DRIVE = """# The socket of a virtual drive

Independent of the bus and of any master: the state of a virtual drive and its motor, and its faults. Real drives do
not have this socket. It is `$XDG_RUNTIME_DIR/canopen_control/drive-BUS-NODE.sock`, private to its user, and works like
[the robot's](robot_socket.md): each message is a JSON object on one line, the drive sends a greeting with the
protocol number first, and unknown fields in a request are refused.

    {"id": 1, "method": "fault", "params": {"name": "heartbeat_lost", "on": true}}
    {"id": 1, "result": {"active": ["heartbeat_lost"]}}

On the command line `canopen-control fault` uses it. In Python use `DriveClient`, which is fully typed; each method is a
class of `canopen_control.rpc.messages.drive`:

    from canopen_control.client.drive_client import DriveClient
    from canopen_control.rpc.messages.drive import GetDriveState, SwitchFault

    with DriveClient.connect("local:robby", 3) as drive:
        drive.ask(SwitchFault(name="heartbeat_lost"))
        print(drive.ask(GetDriveState()).axes[0].plant.velocity)

The faults are described in [faults of virtual drives](faults.md).
"""
_HUB = """# The socket of a local bus

The members of a `local:` bus, and faults of its wires: cut cables, lost and late frames, bus-off, a bit rate. CAN
interfaces of the kernel do not have this socket. It is `$XDG_RUNTIME_DIR/canopen_control/busctl-NAME.sock`, private to
its user, and works like [the robot's](robot_socket.md): each message is a JSON object on one line, the hub sends a
greeting with the protocol number first, and unknown fields in a request are refused.

    {"id": 1, "method": "cut", "params": {"label": "drive 3"}}
    {"id": 1, "result": {}}

On the command line `canopen-control bus status` and `bus fault` use it. In Python each method is a class of
`canopen_control.rpc.messages.hub`:

    from canopen_control.bus.local import ask_hub
    from canopen_control.rpc.messages.hub import Cut, GetHubStatus

    ask_hub("robby", Cut("drive 3"))
    print([member.label for member in ask_hub("robby", GetHubStatus()).members])

The frames themselves are sent over a different socket, as records of 16 bytes.
"""


def robot_socket() -> str:
    """Return the page of a robot's socket."""
    from canopen_control.rpc.messages.robot import ROBOT

    return _page(ROBOT, _ROBOT, "After `subscribe`, under a separate key instead of an id.")


def drive_socket() -> str:
    """Return the page of a virtual drive's socket."""
    from canopen_control.rpc.messages.drive import DRIVE

    return _page(DRIVE, _DRIVE, "To every connected client, under a separate key instead of an id.")


def hub_socket() -> str:
    """Return the page of a local bus's control socket."""
    from canopen_control.rpc.messages.hub import HUB

    return _page(HUB, _HUB, "Only its greeting.")


def _page(api: Api[Any, Any], head: str, unasked: str) -> str:
    """Return the page of a socket: methods, unsolicited messages and structures."""
    from canopen_control.rpc.messages.declare import PROTOCOL

    text = [head, f"## Methods, protocol {PROTOCOL}\n", "| method | | parameters | answer |\n|---|---|---|---|"]
    structures: dict[str, type[Any]] = {}
    for name, method in api.methods.items():
        does = f"{method.text} *{method.effect.value.capitalize()}.*"
        text.append(f"| `{name}` | {does} | {_fields(method.request)} | {_shown(method.answer)} |")
        structures.update(_structures(method.answer))
        for field in msgspec.structs.fields(method.request):
            structures.update(_structures(field.type))
    text.append(f"\n## Unsolicited messages\n\n{unasked}\n")
    for key, push in api.pushes.items():
        text.append(f"- `{key}`: {_shown(push)}")
        structures.update(_structures(push))
    text.append(f"- `hello`, the greeting: {_shown(api.hello)}")
    structures.update(_structures(api.hello))
    text.append("\n## Structures\n")
    structures.pop("Done", None)
    for name, each in sorted(structures.items()):
        rows = [f"| `{field.encode_name}` | {_shown(field.type)} |" for field in msgspec.structs.fields(each)]
        text += [f"### {name}\n", inspect.cleandoc(each.__doc__ or ""), "", "| field | |\n|---|---|", *rows, ""]
    return "\n".join(text) + "\n"


def _fields(request: type[Any]) -> str:
    """Return the parameters of a request; optional ones are marked by a question mark."""
    fields = [(each.encode_name, "" if each.required else "?", each.type) for each in msgspec.structs.fields(request)]
    return ", ".join(f"`{name}`{mark} {_shown(kind)}" for name, mark, kind in fields) or "-"


_WORDS = {
    r"typing\.Annotated\[(\w+), .*?\)\]": r"\1",
    r"<class '(?:\w+\.)*(\w+)'>": r"\1",
    r"(?:\w+\.)+(\w+)": r"\1",
    r"\bLiteral\[(.*?)\]": r"one of \1",
    r"\bOptional\[(.*)\]": r"\1 | None",
    r"\bNoneType\b|\bNone\b": "null",
    r"\bstr\b": "text",
    r"\bfloat\b": "number",
    r"\bint\b": "integer",
    r"\bbytes\b": "base64",
    r"\bbool\b": "true, false",
    r"tuple\[(\w+), \.\.\.\]": r"list[\1]",
    r"tuple\[\]": "list",
    r" \| ": " or ",
}


def _shown(kind: object) -> str:
    """Return a type in words, with links to structures."""
    if getattr(kind, "__name__", "") == "Done":
        return "-"
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return f"[{kind.__name__}](#{kind.__name__.lower()})"
    text = str(kind)
    for pattern, word in _WORDS.items():
        text = re.sub(pattern, word, text)
    names = _structures(kind)
    return re.sub(r"\w+", lambda match: _link(match[0], names), text)


def _link(word: str, names: dict[str, type[Any]]) -> str:
    return f"[{word}](#{word.lower()})" if word in names else word


def _structures(kind: object) -> dict[str, type[Any]]:
    """Return the structures used by a type, directly or indirectly, by name."""
    return {each.__name__: each for each in _walk(kind, set())}


def _walk(kind: object, seen: set[object]) -> Iterator[type[Any]]:
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct) and kind not in seen:
        seen.add(kind)
        yield kind
        for field in msgspec.structs.fields(kind):
            yield from _walk(field.type, seen)
    for each in getattr(kind, "__args__", ()):
        yield from _walk(each, seen)
