"""The pages of the sockets, made of the declarations of their methods."""

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

Every process that is not the robot itself asks it here: the command line, the ROS bridge, the page, your programs.
The socket is `$XDG_RUNTIME_DIR/canopen_control/robot-NAME.sock`, private to its user. A message is a JSON object on a
line:

    {"id": 1, "method": "command", "params": {"controller": "robby_forward_controller", "values": [10, 10]}}
    {"id": 1, "result": {}}
    {"id": 2, "error": {"kind": "NotEnabled", "message": "left_drive is not enabled ..."}}

A request without an id is not answered. A field that a request does not have is refused; skip those that you do not
know in an answer. A number that is not finite is null, bytes are base64. The robot greets first, with the number of
this protocol. In the table a question mark is at a parameter that may be left out. Answers may come in another order
than the requests.

In Python `RobotClient` has all of it with types; each method is a class of `canopen_control.rpc.messages.robot`:

```{literalinclude} ../examples/state_stream.py
```

Without this package ten lines of the standard library do, in any language:

```{literalinclude} ../examples/bare_socket.py
```
"""
_DRIVE = """# The socket of a virtual drive

Past the bus and past any master: what a virtual drive is doing, what its motor does, and its faults. A real drive has
no such socket. It is `$XDG_RUNTIME_DIR/canopen_control/drive-BUS-NODE.sock`, private to its user, and speaks as
[the robot's](robot_socket.md) does: a message is a JSON object on a line, the drive greets first with the number of
this protocol, a field that a request does not have is refused.

    {"id": 1, "method": "fault", "params": {"name": "heartbeat_lost", "on": true}}
    {"id": 1, "result": {"active": ["heartbeat_lost"]}}

On the command line `canopen-control fault` uses it. In Python `DriveClient` has all of it with types; each method is a
class of `canopen_control.rpc.messages.drive`:

    from canopen_control.client.drive_client import DriveClient
    from canopen_control.rpc.messages.drive import GetDriveState, SwitchFault

    with DriveClient.connect("local:robby", 3) as drive:
        drive.ask(SwitchFault(name="heartbeat_lost"))
        print(drive.ask(GetDriveState()).axes[0].plant.velocity)

What each fault is: [the faults of virtual drives](faults.md).
"""
_HUB = """# The socket of a local bus

Who is on a `local:` bus, and the faults of its wires: cut cables, lost and late frames, bus-off, a bit rate. A CAN
interface of the kernel has no such socket. It is `$XDG_RUNTIME_DIR/canopen_control/busctl-NAME.sock`, private to its
user, and speaks as [the robot's](robot_socket.md) does: a message is a JSON object on a line, the hub greets first with
the number of this protocol, a field that a request does not have is refused.

    {"id": 1, "method": "cut", "params": {"label": "drive 3"}}
    {"id": 1, "result": {}}

On the command line `canopen-control bus status` and `bus fault` use it. In Python each method is a class of
`canopen_control.rpc.messages.hub`:

    from canopen_control.bus.local import ask_hub
    from canopen_control.rpc.messages.hub import Cut, GetHubStatus

    ask_hub("robby", Cut("drive 3"))
    print([member.label for member in ask_hub("robby", GetHubStatus()).members])

The frames themselves go through another socket, as records of 16 bytes.
"""


def robot_socket() -> str:
    """Return the page of a robot's socket."""
    from canopen_control.rpc.messages.robot import ROBOT

    return _page(ROBOT, _ROBOT, "After `subscribe`, under a key of its own instead of an id.")


def drive_socket() -> str:
    """Return the page of a virtual drive's socket."""
    from canopen_control.rpc.messages.drive import DRIVE

    return _page(DRIVE, _DRIVE, "To everybody who is connected, under a key of its own instead of an id.")


def hub_socket() -> str:
    """Return the page of a local bus' control socket."""
    from canopen_control.rpc.messages.hub import HUB

    return _page(HUB, _HUB, "Nothing but its greeting.")


def _page(api: Api[Any, Any], head: str, unasked: str) -> str:
    """Return the methods of a socket, what it sends unasked, and their structures."""
    from canopen_control.rpc.messages.declare import PROTOCOL

    text = [head, f"## Methods, protocol {PROTOCOL}\n", "| method | | parameters | answer |\n|---|---|---|---|"]
    told: dict[str, type[Any]] = {}
    for name, method in api.methods.items():
        does = f"{method.text} *{method.effect.value.capitalize()}.*"
        text.append(f"| `{name}` | {does} | {_fields(method.request)} | {_shown(method.answer)} |")
        told.update(_structures(method.answer))
        for field in msgspec.structs.fields(method.request):
            told.update(_structures(field.type))
    text.append(f"\n## What it sends unasked\n\n{unasked}\n")
    for key, push in api.pushes.items():
        text.append(f"- `{key}`: {_shown(push)}")
        told.update(_structures(push))
    text.append(f"- `hello`, first of all: {_shown(api.hello)}")
    told.update(_structures(api.hello))
    text.append("\n## Structures\n")
    told.pop("Done", None)
    for name, each in sorted(told.items()):
        rows = [f"| `{field.encode_name}` | {_shown(field.type)} |" for field in msgspec.structs.fields(each)]
        text += [f"### {name}\n", inspect.cleandoc(each.__doc__ or ""), "", "| field | |\n|---|---|", *rows, ""]
    return "\n".join(text) + "\n"


def _fields(request: type[Any]) -> str:
    """Return the parameters of a request; a question mark is at one that may be left out."""
    told = [(each.encode_name, "" if each.required else "?", each.type) for each in msgspec.structs.fields(request)]
    return ", ".join(f"`{name}`{mark} {_shown(kind)}" for name, mark, kind in told) or "-"


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
    """Return a type in words, with a link where it is a structure."""
    if getattr(kind, "__name__", "") == "Done":
        return "-"
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return f"[{kind.__name__}](#{kind.__name__.lower()})"
    text = str(kind)
    for pattern, word in _WORDS.items():
        text = re.sub(pattern, word, text)
    names = _structures(kind)
    return re.sub(r"\w+", lambda found: _link(found[0], names), text)


def _link(word: str, names: dict[str, type[Any]]) -> str:
    return f"[{word}](#{word.lower()})" if word in names else word


def _structures(kind: object) -> dict[str, type[Any]]:
    """Return the structures that a type holds, by name, and those that they hold."""
    return {each.__name__: each for each in _walk(kind, set())}


def _walk(kind: object, seen: set[object]) -> Iterator[type[Any]]:
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct) and kind not in seen:
        seen.add(kind)
        yield kind
        for field in msgspec.structs.fields(kind):
            yield from _walk(field.type, seen)
    for each in getattr(kind, "__args__", ()):
        yield from _walk(each, seen)
