"""Interfaces that the installed ROS lacks (tf2_msgs, controller_manager_msgs, ...), created at run time.

An installed package is used and never replaced. The created types have upstream's type hashes, so that they are
compatible with upstream's own types; before first use, a message that ROS has also as compiled code is serialised by
both (`provide`), and any difference is an error. A class is created on its first use.
"""

from __future__ import annotations

import importlib
import importlib.machinery
import importlib.util
import json
import os
import sys
import types
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import CanopenError
from canopen_control.ros.interfaces.cdr import Codecs
from canopen_control.ros.interfaces.classes import action_class, message_class, service_class
from canopen_control.ros.interfaces.definition import DEFINITIONS, Registry, hash_text, owner_of, parts_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.ros.interfaces.support import Supports

__all__ = ["PACKAGES", "MissingInterface", "interface", "new_message", "provide"]

PACKAGES: Final = tuple(dict.fromkeys(parts_of(name)[0] for name in DEFINITIONS))
"""Packages that can be created."""
_PROBE: Final = "canopen_control_probe/msg/Header"  # std_msgs/msg/Header under another name
_PROBED: Final = "std_msgs/msg/Header"


def provide(packages: Iterable[str] = PACKAGES) -> list[str]:
    """Create the missing interface packages for import by any program with rclpy; return their names.

    Call this function before the packages are imported. Raise CanopenError, before anything is created, if a package
    is neither installed nor in `PACKAGES`, or if the self-test fails with this ROS.
    """
    names = [packages] if isinstance(packages, str) else list(packages)
    missing = [name for name in names if name not in sys.modules and importlib.util.find_spec(name) is None]
    unknown = [name for name in missing if name not in PACKAGES]
    if unknown:
        choices = f"packages that can be created: {', '.join(PACKAGES)}"
        raise CanopenError(f"{', '.join(unknown)} cannot be created; install the package ({choices})")
    if missing:
        factory = _factory()
        for package in missing:
            factory.install(package)
    return missing


class MissingInterface(CanopenError):
    """Interface `name` is missing in this ROS installation: its package is missing or of another version."""

    def __init__(self, name: str) -> None:
        super().__init__(f"this ROS installation lacks {name}")
        self.name = name


def interface(name: str) -> Any:  # noqa: ANN401 - a generated class, or one of ours
    """Return the class of "package/msg/Name", created if necessary.

    Raise MissingInterface if this ROS does not have the interface; raise another CanopenError if no interfaces can be
    created for this ROS.
    """
    package, kind, short = parts_of(name)
    if package in PACKAGES:
        provide([package])
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), short)
    except (ImportError, AttributeError) as error:
        raise MissingInterface(name) from error


def new_message(kind: Any, **values: object) -> Any:  # noqa: ANN401 - as above
    """Create a message with those values for which the installed version of the message has a field."""
    field_types = kind.get_fields_and_field_types()
    return kind(**{name: value for name, value in values.items() if name in field_types})


class _Factory:
    """Factory of classes from definitions; one per process, since C code keeps pointers to their type supports."""

    def __init__(self) -> None:
        self.registry = Registry(_shares())
        self.registry.add({**DEFINITIONS, _PROBE: ["builtin_interfaces/Time stamp", "string frame_id"]})
        self.codecs = Codecs(self.registry.get, self.class_of)
        self._classes: dict[str, type] = {}
        self._supports: Supports | None = None

    def supports(self) -> Supports:
        """Return the factory of type supports; the first call loads ROS's libraries."""
        if self._supports is None:
            from canopen_control.ros.interfaces.support import Libraries, Supports

            self._supports = Supports(Libraries(), self.registry, self.codecs)
        return self._supports

    def class_of(self, name: str) -> type:
        """Return the class of a message, created here or imported from the installed package."""
        package, kind, short = parts_of(name)
        if name not in self._classes and (owner_of(name) in DEFINITIONS or name == _PROBE):
            self._classes[name] = message_class(self.registry.get(name), self.class_of, self.supports)
        if name in self._classes:
            return self._classes[name]
        interface_class: type = getattr(importlib.import_module(f"{package}.{kind}"), short)
        return interface_class

    def service_of(self, name: str) -> type:
        """Return the class of a service, created on first use, including the two services of an action."""
        if name not in self._classes:
            parts = {part: self.class_of(f"{name}_{part}") for part in ("Request", "Response", "Event")}
            self._classes[name] = service_class(name, parts, self.supports)
        return self._classes[name]

    def action_of(self, name: str) -> type:
        """Return the class of an action, created on first use."""
        if name not in self._classes:
            self._classes[name] = action_class(name, self.class_of, self.service_of, self.supports)
        return self._classes[name]

    def install(self, package: str) -> None:
        """Add the modules of a package to `sys.modules`; their classes are created on first access."""
        top = _module(package)
        for kind, make in (("msg", self.class_of), ("srv", self.service_of), ("action", self.action_of)):
            module = _module(f"{package}.{kind}")
            names = [name for name in DEFINITIONS if name.startswith(f"{package}/{kind}/")]
            module.__dict__["__getattr__"] = self._maker(f"{package}/{kind}", make)
            module.__dict__["__all__"] = [parts_of(name)[2] for name in names]
            setattr(top, kind, module)
            sys.modules[module.__name__] = module
        sys.modules[package] = top

    def _maker(self, prefix: str, make: Callable[[str], type]) -> Callable[[str], type]:
        """Return a module's `__getattr__`, which creates the class of a name or raises AttributeError."""

        def create(short: str) -> type:
            name = f"{prefix}/{short}"
            if owner_of(name) not in DEFINITIONS or short.startswith("_"):
                raise AttributeError(f"{name} does not exist")
            return make(name) if name in DEFINITIONS else self.class_of(name)

        return create


@cache
def _factory() -> _Factory:
    factory = _Factory()
    try:
        _check(factory)
    except Exception as error:
        raise CanopenError(f"no interfaces can be created for this ROS: {type(error).__name__}: {error}") from error
    return factory


def _check(factory: _Factory) -> None:
    """Compare the type hash and the serialised form of a message with ROS's own; raise RuntimeError if they differ."""
    serialization = importlib.import_module("rclpy.serialization")
    theirs_of, ours_of = factory.class_of(_PROBED), factory.class_of(_PROBE)
    stamp = factory.class_of("builtin_interfaces/msg/Time")(sec=-12345, nanosec=67890)
    ours, theirs = ours_of(stamp=stamp, frame_id="base_link"), theirs_of(stamp=stamp, frame_id="base_link")
    type_hash = json.loads(_description_file(_PROBED).read_text(encoding="utf-8"))["type_hashes"][0]["hash_string"]
    checks = {
        "hash": hash_text(factory.registry.describe(_PROBED)) == type_hash,
        "sending": serialization.deserialize_message(serialization.serialize_message(ours), theirs_of) == theirs,
        "receiving": serialization.deserialize_message(serialization.serialize_message(theirs), ours_of) == ours,
    }
    failed = [name for name, good in checks.items() if not good]
    if failed:
        raise RuntimeError(f"the self-test differs in {', '.join(failed)}")


def _shares() -> list[Path]:
    """Return the `share` folders in which installed packages have their type descriptions."""
    prefixes = [field for field in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if field]
    return [Path(prefix, "share") for prefix in (*prefixes, sys.prefix)]


def _description_file(name: str) -> Path:
    package, kind, short = parts_of(name)
    paths = [share / package / kind / f"{short}.json" for share in _shares()]
    return next(path for path in paths if path.exists())


def _module(name: str) -> types.ModuleType:
    module = types.ModuleType(name, "Created at run time, because this package is not installed.")
    module.__spec__ = importlib.machinery.ModuleSpec(name, None, is_package="." not in name)
    module.__path__ = []
    return module
