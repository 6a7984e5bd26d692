"""The page's server: viser's, behind our own door.

The law of this file: viser by itself listens on every address, takes WebSockets from any origin and opens a public
relay when any client asks for one. So it is given a socket that is bound already, every request passes `door.Door`, and
sharing is refused. The cure depends on how viser is built: its version is pinned, and a test asks from outside.
"""

from __future__ import annotations

import contextlib
import http
import logging
import socket
import warnings
from typing import TYPE_CHECKING, Any, Final
from unittest import mock

import rich
import viser
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Response

from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable

    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request

    from canopen_control.view.door import Door

__all__ = ["DEFAULT_PORT", "PageServer", "listen"]

DEFAULT_PORT: Final = 8080
_OTHER_PORTS: Final = 20  # tried after the default one, which many programs like
_MAX_MESSAGE: Final = 1 << 20  # bytes; a browser sends clicks and camera poses


def listen(host: str, port: int | None) -> socket.socket:
    """Bind a listening socket; without a port the default one, or the next that is free. ConfigError if it cannot."""
    ports = range(DEFAULT_PORT, DEFAULT_PORT + _OTHER_PORTS) if port is None else [port]
    problem = OSError("no port is free")
    for each in ports:
        try:
            family, _, _, _, address = socket.getaddrinfo(host or "0.0.0.0", each, type=socket.SOCK_STREAM)[0]
            return socket.create_server(address[:2], family=family)
        except OSError as error:
            problem = error
    where = f"{host}:{port}" if port is not None else f"{host}, ports {ports[0]} to {ports[-1]}"
    reason = problem.strerror or str(problem)
    raise ConfigError(f"the page cannot listen on {where}: {reason}; choose another --host or --port")


class PageServer(viser.ViserServer):
    """A viser server that listens on `listener` and lets in whom `door` does; `label` is the title."""

    def __init__(self, listener: socket.socket, door: Door, label: str) -> None:
        self.door = door
        rich.get_console().quiet = True  # viser's own banner would tell another address
        _quiet_handshakes()
        real = websockets.asyncio.server.serve

        def serve(handler: object, _host: object, _port: object, **options: Any) -> Any:  # noqa: ANN401 - not ours
            options |= {
                "process_request": _guarded(door, options["process_request"]),
                "max_size": _MAX_MESSAGE,
                "sock": listener,
            }
            return real(handler, **options)  # type: ignore[arg-type] # viser's handler, as it was

        with mock.patch.object(websockets.asyncio.server, "serve", serve), warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            super().__init__(host=door.host, port=door.port, label=label, verbose=False)
        self.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=False, brand_color=(38, 70, 120))

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: nothing of this page leaves the computer through a relay."""
        del verbose
        return None


def _guarded(
    door: Door, serve_file: Callable[[ServerConnection, Request], Response | None]
) -> Callable[[ServerConnection, Request], Response | None]:
    def process(connection: ServerConnection, request: Request) -> Response | None:
        with contextlib.suppress(KeyError):
            del request.headers["Accept-Encoding"]  # nothing is compressed for a network that is a cable long
        refused = door.refusal(request.path, request.headers)
        if refused is not None:
            return _answer(http.HTTPStatus.FORBIDDEN, f"403: {refused}\n")
        response = serve_file(connection, request)
        if response is not None:
            for name, value in door.response_headers(request.path).items():
                response.headers[name] = value
        return response

    return process


def _answer(status: http.HTTPStatus, text: str) -> Response:
    body = text.encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status.value, status.phrase, headers, body)


def _quiet_handshakes() -> None:
    """Keep refused and broken handshakes out of the log: a port scanner must not fill it."""
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
