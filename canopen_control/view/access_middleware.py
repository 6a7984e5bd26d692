"""Access check of the page as ASGI middleware, in front of everything its server has, WebSockets included.

What `AccessRules` refuse is answered here and reaches nothing behind it. The token in the path is the `root_path` of
what lies behind (ASGI), so that the toolkit writes it into every address of the page. HTML of the page gets a nonce of
its own for the scripts that are in it, and every answer the headers of `AccessRules`.
"""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, MutableMapping

    from canopen_control.view.access_rules import AccessRules

__all__ = ["AccessMiddleware"]

if TYPE_CHECKING:
    Message = MutableMapping[str, Any]
    Receive = Callable[[], Awaitable[Message]]
    Send = Callable[[Message], Awaitable[None]]
    App = Callable[[Message, Receive, Send], Awaitable[None]]

#: a proxy's word that no proxy of ours has given: the toolkit would write it into the page
_NOT_BELIEVED: Final = (b"x-forwarded-prefix", b"x-forwarded-for", b"x-forwarded-proto", b"x-forwarded-host")


class AccessMiddleware:
    """Wraps `app`; what is let through is up to `rules`."""

    def __init__(self, app: App, rules: AccessRules) -> None:
        self.app, self._rules = app, rules  # the toolkit looks for `app` to find its server

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        """Answer a request, or hand it on."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        rules, path = self._rules, str(scope.get("path", "/"))
        refused = rules.refusal(path, _headers_of(scope), scope.get("method", "GET"))
        if refused is not None:
            await _refuse(scope["type"], refused, receive, send, rules)
            return
        if path == rules.root and scope["type"] == "http":  # the page's own addresses are relative to a folder
            await _answer(307, {"Location": f"{rules.root}/", **rules.response_headers()}, "", send)
            return
        scope["root_path"] = rules.root
        scope["headers"] = [each for each in scope["headers"] if each[0] not in _NOT_BELIEVED]
        if scope["type"] == "websocket":
            await self.app(scope, receive, send)
        else:
            await self.app(scope, receive, _Answer(rules, send))


class _Answer:
    """Sends an answer on, with the headers of the rules; HTML is held back until it is whole."""

    def __init__(self, rules: AccessRules, send: Send) -> None:
        self._rules, self._send = rules, send
        self._start: Message | None = None
        self._html = bytearray()

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            if _is_html(message):
                self._start = message
            else:
                await self._send(_with(message, self._rules.response_headers()))
        elif self._start is None:
            await self._send(message)
        else:
            self._html += message.get("body", b"")
            if not message.get("more_body", False):
                await self._send_html(self._start, bytes(self._html))

    async def _send_html(self, start: Message, html: bytes) -> None:
        nonce = secrets.token_urlsafe(16)
        # What is in the page at this time is the toolkit's template and our own: all else came in escaped.
        html = html.replace(b"<script", b'<script nonce="%s"' % nonce.encode())
        extra = self._rules.response_headers(nonce)
        await self._send(_with(start, {**extra, "Cache-Control": "no-store", "Content-Length": str(len(html))}))
        await self._send({"type": "http.response.body", "body": html})


async def _refuse(kind: str, why: str, receive: Receive, send: Send, rules: AccessRules) -> None:
    if kind == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": why[:120]})  # before it is open: 403
        return
    await _answer(403, rules.response_headers(), f"403: {why}\n", send)


async def _answer(status: int, headers: dict[str, str], text: str, send: Send) -> None:
    body = text.encode(errors="replace")
    extra = {
        **headers,
        "Content-Type": "text/plain; charset=utf-8",
        "Content-Length": str(len(body)),
        "Cache-Control": "no-store",
    }
    await send(_with({"type": "http.response.start", "status": status, "headers": []}, extra))
    await send({"type": "http.response.body", "body": body})


def _with(start: Message, extra: dict[str, str]) -> Message:
    given = {name.lower().encode() for name in extra}
    headers = [each for each in start["headers"] if each[0].lower() not in given]
    return {**start, "headers": headers + [(name.lower().encode(), text.encode()) for name, text in extra.items()]}


def _is_html(start: Message) -> bool:
    return any(name.lower() == b"content-type" and value.startswith(b"text/html") for name, value in start["headers"])


def _headers_of(scope: Message) -> dict[str, str]:
    """Return the headers by their canonical names; one that comes twice is joined, and then fits nothing."""
    found: dict[str, str] = {}
    for name, value in scope["headers"]:
        key = name.decode("latin-1").title()
        text = value.decode("latin-1")
        found[key] = f"{found[key]}, {text}" if key in found else text
    return found
