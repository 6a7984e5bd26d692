"""HTTP server of the page: runs NiceGUI behind an access check, on a socket that is already bound.

The access check is the outermost ASGI application, so that no request reaches NiceGUI unchecked. Before the address is
printed, `access_problem` sends requests as a foreign page would; if the server answers one of them, the server ends
with an error.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import socket
from typing import TYPE_CHECKING, Any, Final

import uvicorn
from fastapi import FastAPI
from nicegui import app as toolkit
from nicegui import ui
from starlette.responses import PlainTextResponse

from canopen_control.errors import ConfigError, ControlError
from canopen_control.view.page_address import is_loopback

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, MutableMapping, Sequence

    from starlette.requests import Request
    from starlette.types import ASGIApp

    from canopen_control.view.page_address import AccessRules

    Message = MutableMapping[str, Any]
    Receive = Callable[[], Awaitable[Message]]
    Send = Callable[[Message], Awaitable[None]]
    App = Callable[[Message, Receive, Send], Awaitable[None]]


# Access check of the page as ASGI middleware in front of all routes of the server, WebSockets included.
#
# Requests refused by `AccessRules` are answered here and go no further. The token in the path is the `root_path` of the
# inner application (ASGI), so that NiceGUI writes the token into every address of the page. The HTML of the page gets a
# nonce for the scripts in it, and every response gets the headers of `AccessRules`.


#: headers that only a proxy of ours could set truthfully; NiceGUI would write the prefix into the page
_NOT_BELIEVED: Final = (b"x-forwarded-prefix", b"x-forwarded-for", b"x-forwarded-proto", b"x-forwarded-host")


class AccessMiddleware:
    """ASGI middleware that passes only requests allowed by `rules` to `app`."""

    def __init__(self, app: App, rules: AccessRules) -> None:
        self.app, self._rules = app, rules  # NiceGUI looks for `app` to find its server

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        rules, path = self._rules, str(scope.get("path", "/"))
        refused = rules.refusal(path, _headers_of(scope), scope.get("method", "GET"))
        if refused is not None:
            await _refuse(scope["type"], refused, receive, send, rules)
            return
        if path == rules.root and scope["type"] == "http":  # relative addresses on the page need the trailing slash
            await _answer(307, {"Location": f"{rules.root}/", **rules.response_headers()}, "", send)
            return
        scope["root_path"] = rules.root
        scope["headers"] = [header for header in scope["headers"] if header[0] not in _NOT_BELIEVED]
        if scope["type"] == "websocket":
            await self.app(scope, receive, send)
        else:
            await self.app(scope, receive, _Answer(rules, send))


class _Answer:
    """Sender of a response with the security headers; HTML is buffered because its scripts need a nonce."""

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
        # The page contains only NiceGUI's template and our own scripts at this time; all other text is escaped.
        html = html.replace(b"<script", b'<script nonce="%s"' % nonce.encode())
        extra = self._rules.response_headers(nonce)
        await self._send(_with(start, {**extra, "Cache-Control": "no-store", "Content-Length": str(len(html))}))
        await self._send({"type": "http.response.body", "body": html})


async def _refuse(kind: str, reason: str, receive: Receive, send: Send, rules: AccessRules) -> None:
    if kind == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": reason[:120]})  # not open yet: 403
        return
    await _answer(403, rules.response_headers(), f"403: {reason}\n", send)


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
    names = {name.lower().encode() for name in extra}
    headers = [header for header in start["headers"] if header[0].lower() not in names]
    return {**start, "headers": headers + [(name.lower().encode(), text.encode()) for name, text in extra.items()]}


def _is_html(start: Message) -> bool:
    return any(name.lower() == b"content-type" and value.startswith(b"text/html") for name, value in start["headers"])


def _headers_of(scope: Message) -> dict[str, str]:
    """Return the headers by canonical name; repeated headers are joined, so that they match no allowed value."""
    headers: dict[str, str] = {}
    for name, value in scope["headers"]:
        key = name.decode("latin-1").title()
        text = value.decode("latin-1")
        headers[key] = f"{headers[key]}, {text}" if key in headers else text
    return headers


os.environ.setdefault("NICEGUI_STORAGE_PATH", os.devnull)  # the page stores nothing on disk


DEFAULT_PORT: Final = 8080
_OTHER_PORTS: Final = 20  # tried after the default port, which other programs often use
_MAX_MESSAGE: Final = 1 << 20  # bytes; a browser sends only clicks and short texts
_STRANGER: Final = "canopen-control-probe.invalid"
_WEBSOCKET: Final = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
_UPGRADE: Final = (
    "Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13",
    "Sec-WebSocket-Key: Y2Fub3BlbiBjb250cm9sIQ==",
)  # fmt: skip
_PROBE_S: Final = 5.0


def listen(host: str, port: int | None, first: int | None = None) -> socket.socket:
    """Bind a listening socket to `port`; if `port` is None, try the port `first`, then the default ports.

    Raise ConfigError if no port is free.
    """
    ports = list(range(DEFAULT_PORT, DEFAULT_PORT + _OTHER_PORTS)) if port is None else [port]
    if port is None and first is not None:
        ports.insert(0, first)
    problem = OSError("no port is free")
    for candidate in ports:
        try:
            family, _, _, _, address = socket.getaddrinfo(host or "0.0.0.0", candidate, type=socket.SOCK_STREAM)[0]
            return socket.create_server(address[:2], family=family)
        except OSError as error:
            problem = error
    place = f"{host}:{port}" if port is not None else f"{host}, ports {DEFAULT_PORT} to {ports[-1]}"
    reason = problem.strerror or str(problem)
    raise ConfigError(f"the page cannot listen on {place}: {reason}; choose another --host or --port")


class PageServer:
    """HTTP server: `build` creates the page at /, and `stop`, for POST /stop, returns an error or None."""

    def __init__(
        self,
        listener: socket.socket,
        rules: AccessRules,
        title: str,
        build: Callable[[], None],
        stop: Callable[[], str | None],
    ) -> None:
        self.rules, self._listener = rules, listener
        self._outer = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
        self._outer.add_route("/stop", _stop_route(stop), methods=["POST"])
        self._add_page(title, build)
        self._server = _Server(
            uvicorn.Config(
                self._guarded(self._outer, rules),
                log_config=None,
                access_log=False,
                ws="websockets-sansio",
                ws_max_size=_MAX_MESSAGE,
                ws_per_message_deflate=False,  # local networks need no compression
                proxy_headers=False,
                server_header=False,
                timeout_graceful_shutdown=1,
            )
        )

    def _add_page(self, title: str, build: Callable[[], None]) -> None:
        ui.page(
            "/", title=title, viewport="width=device-width, initial-scale=1, viewport-fit=cover", response_timeout=10
        )(build)
        ui.run_with(
            self._outer,
            title=title,
            tailwind=False,  # a compiler of styles in the browser: slow to start
            binding_refresh_interval=None,
            reconnect_timeout=10.0,  # in s; a page loads again if its server was busy for longer
            message_history_length=0,  # after a reconnection a client gets the current state only
            gzip_middleware_factory=None,
            show_welcome_message=False,
        )

    def _guarded(self, app: ASGIApp, rules: AccessRules) -> ASGIApp:
        return AccessMiddleware(app, rules)

    async def serve(self, ready: Callable[[], object]) -> None:
        """Check the access rules, call `ready`, and serve until `stop`; raise ControlError if the check fails."""
        serving = asyncio.ensure_future(self._server.serve(sockets=[self._listener]))
        try:
            while not self._server.started and not serving.done():
                await asyncio.sleep(0.01)
            if not serving.done():
                problem = await access_problem(self.rules)
                if problem is not None:
                    raise ControlError(f"{problem}; the page is not served; install another version of NiceGUI")
                ready()
            await serving
        finally:
            self._server.should_exit = True
            await serving

    def add_file(self, path: str, content: bytes, media_type: str) -> None:
        """Serve a file of the robot's description, such as a mesh, behind the same access check."""

        async def answer(_request: Request) -> Any:  # noqa: ANN401 - a response of starlette
            from starlette.responses import Response

            return Response(content, media_type=media_type)

        self._outer.router.routes[:] = [
            route for route in self._outer.router.routes if getattr(route, "path", "") != path
        ]
        self._outer.add_route(path, answer, methods=["GET"])
        # before NiceGUI's route, which matches all paths
        self._outer.router.routes.insert(0, self._outer.router.routes.pop())

    def stop(self) -> None:
        """End `serve`."""
        self._server.should_exit = True


class _Server(uvicorn.Server):
    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals to the main program."""
        yield


def _stop_route(stop: Callable[[], str | None]) -> Callable[[Request], Any]:
    async def answer(_request: Request) -> PlainTextResponse:
        refused = stop()
        return PlainTextResponse(refused or "STOP was sent.", 503 if refused else 200)

    return answer


async def access_problem(rules: AccessRules) -> str | None:
    """Send requests that the access check must refuse; return the problem if one is not refused with 403, else None."""
    host = f"127.0.0.1:{rules.port}"
    host_header, foreign = f"Host: {host}", f"Origin: http://{_STRANGER}"
    root = rules.root
    requests: list[tuple[str, str, Sequence[str]]] = [
        ("a request without the token", "/", (host_header,)),
        ("a file without the token", "/_nicegui/", (host_header,)),
        ("a WebSocket without the token", _WEBSOCKET, (host_header, f"Origin: http://{host}", *_UPGRADE)),
        ("a request with a foreign Origin", f"{root}/", (host_header, foreign)),
        ("a WebSocket with a foreign Origin", f"{root}{_WEBSOCKET}", (host_header, foreign, *_UPGRADE)),
        ("a WebSocket without Origin", f"{root}{_WEBSOCKET}", (host_header, *_UPGRADE)),
    ]
    if is_loopback(rules.host):
        requests.append(("a request with a foreign Host", f"{root}/", (f"Host: {_STRANGER}",)))
    for title, path, headers in requests:
        try:
            status = await asyncio.wait_for(_status(rules, path, headers), _PROBE_S)
        except (TimeoutError, OSError, ValueError):
            return f"the page's own server does not answer {title}"
        if status != 403:
            return f"the page's access check fails: {title} is answered with {status} instead of 403"
    return None


async def _status(rules: AccessRules, path: str, headers: Sequence[str]) -> int:
    host = {"0.0.0.0": "127.0.0.1", "": "127.0.0.1", "::": "::1"}.get(rules.host, rules.host)
    reader, writer = await asyncio.open_connection(host, rules.port)
    try:
        writer.write("\r\n".join([f"GET {path} HTTP/1.1", *headers, "", ""]).encode())
        return int((await reader.readline()).split()[1])
    except IndexError:
        raise ValueError("no status line") from None
    finally:
        writer.close()


def silence(report: Callable[[str], None]) -> None:
    """Pass NiceGUI's exceptions to `report`, and suppress the log output of the server."""
    import logging
    import traceback

    for name in ("nicegui", "uvicorn", "uvicorn.error", "asyncio", "engineio", "socketio", "websockets"):
        logging.getLogger(name).addHandler(logging.NullHandler())
        logging.getLogger(name).setLevel(logging.CRITICAL)
    toolkit.on_exception(lambda error: report("".join(traceback.format_exception(error)).rstrip()))
