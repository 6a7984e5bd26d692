"""The address of a page with its token, kept for its user alone: a file of mode 0600 in the private folder of sockets.

The view that serves a page holds the lock of its file. A view that was killed leaves the file, and the next one on the
same host and port goes on with its token, so that an open tab survives the restart. A view that ends in order removes
the file: a tab that stays open sends its token to whatever serves the port next, and that token must open nothing then.
For the same reason a token belongs to one port.

The token stands in no command line, no event, no recording and no log of the robot: other users may read those.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
from typing import TYPE_CHECKING, Final

from canopen_control.host.sockets import SocketInUse, claim, runtime_dir

if TYPE_CHECKING:
    from pathlib import Path

    from canopen_control.view.access_rules import AccessRules

__all__ = ["PageAddress", "killed_port", "page_addresses"]

_TOKEN: Final = re.compile(r"[A-Za-z0-9_-]{32}")
_OTHER: Final = re.compile(r"[^A-Za-z0-9.]")
_LONGEST: Final = 4096  # bytes of such a file
_WAIT_S: Final = 0.5  # for somebody who reads it just now


class PageAddress:
    """The file of the page of `robot` on `host` and `port`, held from now on.

    `token` is that of a view which served it before and was killed, None where there was none. It is made when the port
    is bound already. Of two views with one host and port (in two network namespaces) the second one keeps no file.
    """

    def __init__(self, robot: str, host: str, port: int) -> None:
        self._robot = robot
        self._path = runtime_dir() / f"page-{robot}-{_OTHER.sub('_', host)}-{port}.json"
        before = _read(self._path)
        self._fd = -1
        self.token: str | None = None
        with contextlib.suppress(SocketInUse):
            self._fd = claim(self._path, _WAIT_S)
            self.token = before.get("token") if _TOKEN.fullmatch(before.get("token", "")) else None
        _remove_dead(robot, but=self._path)

    def keep(self, rules: AccessRules) -> None:
        """Write the address down for `page_addresses`, and the token for the next view."""
        if self._fd >= 0:
            text = json.dumps({"robot": self._robot, "place": rules.place, "url": rules.url, "token": rules.token})
            os.ftruncate(self._fd, 0)
            os.pwrite(self._fd, text.encode(), 0)

    def end(self) -> None:
        """Remove the file; the token is not used again."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            self._path.unlink(missing_ok=True)
            os.close(fd)


def page_addresses(robot: str | None = None) -> dict[str, str]:
    """Return {address without token: address with it} of the pages that this user's views serve now."""
    found: dict[str, str] = {}
    for path in sorted(runtime_dir().glob("page-*.json")):
        kept = _read(path)
        if "url" in kept and robot in (None, kept.get("robot")) and _is_held(path):
            found[kept.get("place", "")] = kept["url"]
    return found


def killed_port(robot: str, host: str) -> int | None:
    """Return the port of a view of this robot that was killed, for the next one to go on there; None without one."""
    for path in sorted(runtime_dir().glob(f"page-{robot}-{_OTHER.sub('_', host)}-*.json")):
        port = path.stem.rpartition("-")[2]
        if port.isdecimal() and _read(path).get("robot") == robot and not _is_held(path):
            return int(port)
    return None


def _remove_dead(robot: str, but: Path) -> None:
    """Remove what views of this robot have left that were killed on other ports."""
    for path in runtime_dir().glob("page-*.json"):
        if path != but and _read(path).get("robot") == robot and not _is_held(path):
            path.unlink(missing_ok=True)


def _read(path: Path) -> dict[str, str]:
    """Return what a file of ours says; {} where there is none, or none that can be read."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return {}
    try:
        text = os.read(fd, _LONGEST)
        kept = json.loads(text)
    except (OSError, ValueError):
        return {}
    finally:
        os.close(fd)
    return {str(key): value for key, value in kept.items() if isinstance(value, str)} if isinstance(kept, dict) else {}


def _is_held(path: Path) -> bool:
    """Whether the view that wrote a file still runs."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(fd)
    return False
