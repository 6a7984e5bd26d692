"""The real xacro in the process of the test: what the package runs in a process of its own, within limits."""

import functools
from pathlib import Path

from canopen_control.errors import RobotConfigError
from canopen_control.urdf import xacro_child


@functools.cache
def expanded(path, mappings, _beside):
    """Return what xacro makes of a file, once for as long as nothing in its folder changes."""
    return xacro_child._run(path, dict(mappings))


class XacroHere:
    """In place of `XacroRun`."""

    def __init__(self, path, mappings, limits=None):
        self._path, self._mappings = path, mappings

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def close(self):
        """Nothing runs."""

    def result(self):
        path = Path(self._path)
        beside = sorted(
            (sibling.name, sibling.stat().st_mtime_ns) for sibling in path.parent.glob("*")
        )  # which may include them
        kind, text = expanded(str(path), tuple(sorted(dict(self._mappings).items())), tuple(beside))
        if kind == xacro_child.URDF:
            return text
        raise RobotConfigError(f"{self._path}: xacro: {text}")
