"""Address and token of a page, in a file with mode 0600 in the private folder of the sockets.

The view that serves a page holds a lock on its file. A view that was killed leaves the file, and the next view on the
same host and port uses its token again, so that an open tab survives the restart. A normal exit removes the file: an
open tab sends its token to the next server on that port, where the token must not be valid. For the same reason a token
belongs to one port.

The token appears in no command line, event, recording or log of the robot, because other users may read those.
"""

from __future__ import annotations

import contextlib
import fcntl
import hmac
import ipaddress
import json
import os
import re
import secrets
import socket
from typing import TYPE_CHECKING, Final

from canopen_control.host.sockets import SocketInUse, claim, runtime_dir

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


# Access rules of the page's server: token, Host and Origin checks, and security headers. No socket.
#
# A page that can move motors is for the user who started it. Every user of a computer can connect to its loopback
# address, so every request needs a token there too: pages, files, STOP, uploads and WebSockets. The token is the first
# part of the path. It is not in a cookie, because a browser sends the cookies of a host to all its ports (RFC 6265,
# 8.5), and any user may serve another port of this computer.
#
# A browser names in Origin the page that made a request, so that pages from elsewhere are refused (RFC 6455, 10.2). On
# loopback a foreign Host is refused too, because a foreign name that resolves to this computer would share our origin.


_HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",  # no other site can show the buttons in an invisible frame (clickjacking)
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}
_POLICY: Final = (
    "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self' blob:; object-src 'none'; frame-src 'none'; "
    "frame-ancestors 'none'; form-action 'none'; base-uri 'none'"
)
_FOREIGN: Final = ("cross-site", "same-site")
_EVERY_ADDRESS: Final = ("", "0.0.0.0", "::")


class AccessRules:
    """Access rules of the page on `host` and `port`; a random token is created if `token` is None."""

    def __init__(self, host: str, port: int, token: str | None = None) -> None:
        self.host, self.port = host, port
        self.token = token or secrets.token_urlsafe(24)

    @property
    def root(self) -> str:
        """Common prefix of all paths of the page: a slash and the token."""
        return f"/{self.token}"

    @property
    def url(self) -> str:
        """Address of the page with its token; whoever knows it can use the page.

        The address must appear only in the terminal of the user who started the page.
        """
        return f"{self.place}{self.token}/"

    @property
    def place(self) -> str:
        """Address of the server without the token."""
        name = socket.gethostname() if self.host in _EVERY_ADDRESS else self.host
        return f"http://{f'[{name}]' if ':' in name else name}:{self.port}/"

    def refusal(self, path: str, headers: Mapping[str, str], method: str = "GET") -> str | None:
        """Return why a request is refused, or None if it is allowed; `headers` maps canonical names to values."""
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if is_loopback(self.host) and host not in self._own_names():
            return f"{host!r} is not an address of this page"
        if origin is None and headers.get("Upgrade", "").lower() == "websocket":
            return "WebSocket without Origin header; only the browser that shows the page may connect"
        if origin is None and method not in ("GET", "HEAD"):
            return f"{method} without Origin header; only the browser that shows the page may send requests"
        if origin is not None and origin != f"http://{host}":
            return f"pages of {origin!r} may not access this page"
        if headers.get("Sec-Fetch-Site", "none") in _FOREIGN and headers.get("Sec-Fetch-Mode") != "navigate":
            return "another site may link to this page, but not load its parts"
        if not self._has_token(path):
            return (
                "this address has no valid token; open the address that the view has printed last "
                "(canopen-control view --address prints it again)"
            )
        return None

    def response_headers(self, nonce: str = "") -> dict[str, str]:
        """Return the security headers for all responses; they let the page connect only to this server.

        Allowed scripts are our own files and those with `nonce`, so that text from a bus can never run as a script.
        NiceGUI compiles its templates in the browser, which needs 'unsafe-eval', and sets inline
        styles.
        """
        headers = dict(_HEADERS)
        scripts = f"'self' 'nonce-{nonce}' 'unsafe-eval'" if nonce else "'none'"
        headers["Content-Security-Policy"] = f"script-src {scripts}; {_POLICY}"
        return headers

    def _own_names(self) -> tuple[str, ...]:
        names = ("127.0.0.1", "localhost", "[::1]", f"[{self.host}]" if ":" in self.host else self.host)
        return tuple(f"{name}:{self.port}" for name in names)

    def _has_token(self, path: str) -> bool:
        token = path.removeprefix("/").split("/", 1)[0]
        return path.startswith("/") and hmac.compare_digest(token.encode(errors="replace"), self.token.encode())


def is_loopback(host: str) -> bool:
    """Whether an address is reachable only from this computer; False for host names other than localhost."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


_TOKEN: Final = re.compile(r"[A-Za-z0-9_-]{32}")
_OTHER: Final = re.compile(r"[^A-Za-z0-9.]")
_LONGEST: Final = 4096  # bytes of a page file
_WAIT_S: Final = 0.5  # in which another process may hold the lock to read the file


class PageAddress:
    """Locked file with the address and token of the page of `robot` on `host` and `port`.

    `token` is the token of a killed view on the same host and port, or None. The port must already be bound. If two
    views have the same host and port (in two network namespaces), only the first has a file.
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
        """Write the page's address and token to the file, for `page_addresses` and for the next view."""
        if self._fd >= 0:
            text = json.dumps({"robot": self._robot, "place": rules.place, "url": rules.url, "token": rules.token})
            os.ftruncate(self._fd, 0)
            os.pwrite(self._fd, text.encode(), 0)

    def end(self) -> None:
        """Remove the file, so that no later view uses the token again."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            self._path.unlink(missing_ok=True)
            os.close(fd)


def page_addresses(robot: str | None = None) -> dict[str, str]:
    """Return the addresses of this user's running pages with the token, keyed by the address without the token."""
    addresses: dict[str, str] = {}
    for path in sorted(runtime_dir().glob("page-*.json")):
        content = _read(path)
        if "url" in content and robot in (None, content.get("robot")) and _is_held(path):
            addresses[content.get("place", "")] = content["url"]
    return addresses


def killed_port(robot: str, host: str) -> int | None:
    """Return the port that a killed view of this robot used on `host`, for reuse by the next view, or None."""
    for path in sorted(runtime_dir().glob(f"page-{robot}-{_OTHER.sub('_', host)}-*.json")):
        port = path.stem.rpartition("-")[2]
        if port.isdecimal() and _read(path).get("robot") == robot and not _is_held(path):
            return int(port)
    return None


def _remove_dead(robot: str, but: Path) -> None:
    """Remove the files of killed views of this robot, except the file `but`."""
    for path in runtime_dir().glob("page-*.json"):
        if path != but and _read(path).get("robot") == robot and not _is_held(path):
            path.unlink(missing_ok=True)


def _read(path: Path) -> dict[str, str]:
    """Return the text values in a file; an empty dictionary if the file is missing or invalid."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return {}
    try:
        text = os.read(fd, _LONGEST)
        content = json.loads(text)
    except (OSError, ValueError):
        return {}
    finally:
        os.close(fd)
    return (
        {str(key): value for key, value in content.items() if isinstance(value, str)}
        if isinstance(content, dict)
        else {}
    )


def _is_held(path: Path) -> bool:
    """Whether the view that wrote the file is still running, and thus holds the lock on the file."""
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
