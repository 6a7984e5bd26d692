"""Which requests the page's server answers: token, Host and Origin checks, and the security headers. No socket.

A page that can move motors is for the user who started it. Every user of a computer can connect to its loopback
address, so every request needs a token there too: pages, files, STOP, uploads and WebSockets. The token is the first
part of the path. It is not in a cookie: a browser sends the cookies of a host to all its ports (RFC 6265, 8.5), and any
user may serve another port of this computer.

A browser names in Origin the page that made a request, so that pages from elsewhere are refused (RFC 6455, 10.2). On
loopback a foreign Host is refused too: a foreign name that resolves to this computer would share our origin.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["AccessRules", "is_loopback"]

_HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",  # nobody lays an invisible frame of our buttons over his own page
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
    """The rules for one page on `host` and `port`; without a `token` it gets a new one."""

    def __init__(self, host: str, port: int, token: str | None = None) -> None:
        self.host, self.port = host, port
        self.token = token or secrets.token_urlsafe(24)

    @property
    def root(self) -> str:
        """The path that every request begins with: the token."""
        return f"/{self.token}"

    @property
    def url(self) -> str:
        """Where a user of this computer, or of another one that reaches it, finds the page; whoever has it may use it.

        It is for the terminal of the user who started the page, and for nothing that others read.
        """
        return f"{self.place}{self.token}/"

    @property
    def place(self) -> str:
        """The same without the token: where the server is."""
        name = socket.gethostname() if self.host in _EVERY_ADDRESS else self.host
        return f"http://{f'[{name}]' if ':' in name else name}:{self.port}/"

    def refusal(self, path: str, headers: Mapping[str, str], method: str = "GET") -> str | None:
        """Return why a request is refused, None if it may pass; `headers` by their canonical names."""
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if is_loopback(self.host) and host not in self._own_names():
            return f"this page is not {host!r}"
        if origin is None and headers.get("Upgrade", "").lower() == "websocket":
            return "a WebSocket without Origin: this server is for the browser that shows the page"
        if origin is None and method not in ("GET", "HEAD"):
            return f"{method} without Origin: this server is for the browser that shows the page"
        if origin is not None and origin != f"http://{host}":
            return f"pages of {origin!r} may not use this one"
        if headers.get("Sec-Fetch-Site", "none") in _FOREIGN and headers.get("Sec-Fetch-Mode") != "navigate":
            return "another page may lead here, but not use what is here"
        if not self._has_token(path):
            return (
                "this address has no token or an old one; open the address that the view has printed last "
                "(canopen-control view --address prints it again)"
            )
        return None

    def response_headers(self, nonce: str = "") -> dict[str, str]:
        """Return what every answer is sent with: the page may ask nobody but us.

        Scripts are our own files and those that carry `nonce`: text that came over a bus runs no script, however it
        got into the page. The toolkit compiles its templates in the browser, which needs 'unsafe-eval', and sets styles
        in place.
        """
        headers = dict(_HEADERS)
        scripts = f"'self' 'nonce-{nonce}' 'unsafe-eval'" if nonce else "'none'"
        headers["Content-Security-Policy"] = f"script-src {scripts}; {_POLICY}"
        return headers

    def _own_names(self) -> tuple[str, ...]:
        names = ("127.0.0.1", "localhost", "[::1]", f"[{self.host}]" if ":" in self.host else self.host)
        return tuple(f"{name}:{self.port}" for name in names)

    def _has_token(self, path: str) -> bool:
        given = path.removeprefix("/").split("/", 1)[0]
        return path.startswith("/") and hmac.compare_digest(given.encode(errors="replace"), self.token.encode())


def is_loopback(host: str) -> bool:
    """Whether an address can be reached from this computer alone; any name but localhost is taken as not."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
