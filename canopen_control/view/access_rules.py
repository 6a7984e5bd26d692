"""Which requests the page's server answers: Host, Origin and token checks, and the security headers. No socket.

The law of this file: a page that can move motors is for the user who opened it. A browser sends the Origin of whoever
made it ask, so that a foreign page in another tab is refused (RFC 6455, 10.2), and a Host that is not ours is refused
too, or a foreign name that resolves to this computer would be our own origin. On any other address than loopback a
token is needed: once in the address, from then on in a cookie that no other site's request carries.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Final
from urllib.parse import parse_qs, urlsplit

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["AccessRules", "is_loopback"]

_HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",  # nobody lays an invisible frame of our buttons over his own page
    "Referrer-Policy": "no-referrer",  # the address may hold the token
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
    """The rules for one page on `host` and `port`; without a token only loopback may be served."""

    def __init__(self, host: str, port: int, token: str | None = None) -> None:
        self.host, self.port = host, port
        self.token = token or (None if is_loopback(host) else secrets.token_urlsafe(24))
        self.cookie = f"canopen_control_{port}"

    @property
    def url(self) -> str:
        """Where a user of this computer, or of another one that reaches it, finds the page."""
        name = socket.gethostname() if self.host in _EVERY_ADDRESS else self.host
        address = f"http://{f'[{name}]' if ':' in name else name}:{self.port}/"
        return address if self.token is None else f"{address}?token={self.token}"

    def refusal(self, path: str, headers: Mapping[str, str], method: str = "GET") -> str | None:
        """Return why a request is refused, None if it may pass; `headers` by their canonical names."""
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if self.token is None and host not in self._own_names():
            return f"this page is not {host!r}"
        if origin is None and headers.get("Upgrade", "").lower() == "websocket":
            return "a WebSocket without Origin: this server is for the browser that shows the page"
        if origin is None and method not in ("GET", "HEAD"):
            return f"{method} without Origin: this server is for the browser that shows the page"
        if origin is not None and origin != f"http://{host}":
            return f"pages of {origin!r} may not use this one"
        if headers.get("Sec-Fetch-Site", "none") in _FOREIGN and headers.get("Sec-Fetch-Mode") != "navigate":
            return "another page may lead here, but not use what is here"
        if self.token is not None and not self._knows_token(path, headers):
            return "the token is missing or wrong; open the address that canopen-control view has printed"
        return None

    def response_headers(self, path: str, nonce: str = "") -> dict[str, str]:
        """Return what every answer is sent with: the page may ask nobody but us, and a right token becomes a cookie.

        Scripts are our own files and those that carry `nonce`: text that came over a bus runs no script, however it
        got into the page. The toolkit compiles its templates in the browser, which needs 'unsafe-eval', and sets styles
        in place.
        """
        headers = dict(_HEADERS)
        scripts = f"'self' 'nonce-{nonce}' 'unsafe-eval'" if nonce else "'none'"
        headers["Content-Security-Policy"] = f"script-src {scripts}; {_POLICY}"
        if self.token is not None and self._fits(_token_of(path)):
            headers["Set-Cookie"] = f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
        return headers

    def _own_names(self) -> tuple[str, ...]:
        names = ("127.0.0.1", "localhost", "[::1]", f"[{self.host}]" if ":" in self.host else self.host)
        return tuple(f"{name}:{self.port}" for name in names)

    def _knows_token(self, path: str, headers: Mapping[str, str]) -> bool:
        return self._fits(_token_of(path)) or self._fits(self._cookie_of(headers.get("Cookie", "")))

    def _fits(self, given: str) -> bool:
        return self.token is not None and hmac.compare_digest(given.encode(), self.token.encode())

    def _cookie_of(self, text: str) -> str:
        try:
            found = SimpleCookie(text).get(self.cookie)
        except CookieError:
            return ""
        return "" if found is None else found.value


def is_loopback(host: str) -> bool:
    """Whether an address can be reached from this computer alone; any name but localhost is taken as not."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _token_of(path: str) -> str:
    try:
        return parse_qs(urlsplit(path).query).get("token", [""])[0]
    except ValueError:
        return ""
