"""ROS messages made from YAML, and written as text, for people without ros2cli: this file imports no ROS.

The law of the file: data is what YAML gives, fields by name, what is not named keeps its default; an unknown field or a
value of another type is one sentence with the way to it. Text is YAML as `ros2 topic echo` prints it; plain data is
what JSON holds, null for a number that is not finite.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    ClassOf = Callable[[str], type]

__all__ = ["fill", "full_name", "lines", "plain"]

_INTEGERS: Final = re.compile(r"u?int(8|16|32|64)")
_SEQUENCE: Final = re.compile(r"sequence<(.+?)(?:, *(\d+))?>|(.+)\[(\d+)\]")
_EXPONENT: Final = re.compile(r"[-+]?\d+[eE][-+]?\d+")
_SHORT: Final = re.compile(r"([a-z][a-z0-9_]*)/(?:(msg|srv)/)?([A-Za-z][A-Za-z0-9]*)")


def full_name(text: str, kind: str) -> str:
    """Return "std_msgs/msg/String" of that or of "std_msgs/String"; ConfigError when it is the name of no interface."""
    match = _SHORT.fullmatch(text)
    if match is None or match[2] not in (None, kind):
        raise ConfigError(
            f"{text!r} is no interface; write PACKAGE/{kind}/NAME, such as std_msgs/msg/Float64MultiArray"
        )
    return f"{match[1]}/{kind}/{match[3]}"


def fill(message: Any, data: object, class_of: ClassOf, where: str = "") -> Any:  # noqa: ANN401 - somebody's generator's
    """Put data into a message and return it; `class_of` gives the class of a nested one. Raises ConfigError."""
    types = message.get_fields_and_field_types()
    if not isinstance(data, dict):
        raise ConfigError(f"{where or 'the message'} has fields ({', '.join(types)}), not {data!r}")
    for name, value in data.items():
        path = f"{where}.{name}" if where else str(name)
        if name not in types:
            raise ConfigError(f"{path}: there is no such field; there are: {', '.join(types)}")
        setattr(message, name, _made(value, types[name], class_of, path))
    return message


def _made(value: object, kind: str, class_of: ClassOf, path: str) -> Any:  # noqa: ANN401 - what the field holds
    match = _SEQUENCE.fullmatch(kind)
    if match is None:
        return _scalar(value, kind, class_of, path)
    if not isinstance(value, list):
        raise ConfigError(f"{path} is a list of {match[1] or match[3]}, not {value!r}")
    wanted = int(match[4] or len(value))
    if len(value) != wanted or len(value) > int(match[2] or len(value)):
        raise ConfigError(f"{path} has {match[4] or f'at most {match[2]}'} elements, not {len(value)}")
    return [_scalar(each, match[1] or match[3], class_of, f"{path}[{at}]") for at, each in enumerate(value)]


def _scalar(value: object, kind: str, class_of: ClassOf, path: str) -> Any:  # noqa: ANN401 - what the field holds
    if "/" in kind:
        package, _, short = kind.partition("/")
        return fill(class_of(f"{package}/msg/{short}")(), value, class_of, path)
    for fits, make in _SCALARS:
        made = make(value) if fits(kind) else None
        if made is not None:
            return made
    raise ConfigError(f"{path} is a {kind}, not {value!r}")


def _integer(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _number(value: object) -> float | None:
    if isinstance(value, str) and _EXPONENT.fullmatch(value):
        return float(value)  # YAML 1.1 takes 1e-06 for text
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _octet(value: object) -> bytes | None:
    return bytes([value]) if isinstance(value, int) and 0 <= value < 256 else None


_SCALARS: Final[tuple[tuple[Callable[[str], object], Callable[[object], object]], ...]] = (
    (lambda kind: kind in ("double", "float", "float32", "float64"), _number),
    (_INTEGERS.fullmatch, _integer),
    (lambda kind: kind == "boolean", lambda value: value if isinstance(value, bool) else None),
    (lambda kind: kind == "octet", _octet),
    (lambda kind: kind.startswith(("string", "wstring")), lambda value: value if isinstance(value, str) else None),
)


def plain(value: Any) -> Any:  # noqa: ANN401 - a message, or what one of its fields holds
    """Return a message as dicts, lists, numbers, booleans and text."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return int.from_bytes(value, "little")
    if isinstance(value, bool | int | str):
        return value
    if hasattr(value, "__len__"):
        return [plain(each) for each in value]
    number = value.item() if hasattr(value, "item") else value  # numpy's
    return None if isinstance(number, float) and not math.isfinite(number) else number


def lines(message: Any, indent: str = "") -> Iterator[str]:  # noqa: ANN401 - somebody's generator's class
    """Yield a message as lines of YAML."""
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            yield f"{indent}{name}:"
            yield from lines(value, indent + "  ")
        elif isinstance(value, str | bytes) or not hasattr(value, "__len__"):
            yield f"{indent}{name}: {_text(value)}"
        elif not len(value):
            yield f"{indent}{name}: []"
        else:
            yield f"{indent}{name}:"
            yield from _elements(value, indent)


def _elements(values: Any, indent: str) -> Iterator[str]:  # noqa: ANN401 - list, tuple, array or numpy's
    for each in values:
        if hasattr(each, "get_fields_and_field_types"):
            first, *others = list(lines(each, indent + "  ")) or [f"{indent}  {{}}"]
            yield f"{indent}- {first.lstrip()}"
            yield from others
        else:
            yield f"{indent}- {_text(each)}"


def _text(value: Any) -> str:  # noqa: ANN401 - what a field holds
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, bytes):
        return str(int.from_bytes(value, "little"))
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'" if "\n" not in value else repr(value)
    number = float(value) if type(value).__module__ == "numpy" and "float" in type(value).__name__ else value
    return {"nan": ".nan", "inf": ".inf", "-inf": "-.inf"}.get(str(number), str(number))
