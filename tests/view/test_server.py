"""The door as the world finds it: over real sockets, with the real viser behind it."""

import asyncio
import http.client
import io
import socket
from contextlib import redirect_stdout

import pytest
import websockets.asyncio.client as wsclient
import websockets.exceptions
from websockets.typing import Subprotocol

from canopen_control.errors import ConfigError
from canopen_control.view.door import Door
from canopen_control.view.server import PageServer, listen


def get(server, path="/", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.door.port, timeout=5)
    connection.request("GET", path, headers=headers)
    response = connection.getresponse()
    body = response.read()
    connection.close()
    return response, body


def knock(server, **options):
    """Open a WebSocket as the page does; True if it was let in."""

    async def attempt():
        uri = f"ws://127.0.0.1:{server.door.port}/"
        try:
            async with wsclient.connect(
                uri, subprotocols=[Subprotocol("viser-v1.1.1")], proxy=None, **options
            ) as socket:
                await asyncio.wait_for(socket.recv(), 5)
                return True
        except websockets.exceptions.InvalidStatus as error:
            return error.response.status_code

    return asyncio.run(attempt())


def test_the_page_is_served_to_this_computer_alone_and_asks_nobody_else(server):
    response, body = get(server)
    assert response.status == 200
    assert b"<html" in body[:2000]
    assert "default-src 'self'" in response.headers["Content-Security-Policy"]
    assert server._websock_server._port == server.door.port
    with pytest.raises(OSError, match=r".*"):
        socket.create_connection(("127.0.0.2", server.door.port), timeout=1).close()


def test_a_foreign_origin_is_refused_and_our_own_is_not(server):
    own = f"http://127.0.0.1:{server.door.port}"
    assert knock(server, origin=own) is True
    assert knock(server, origin="http://evil.example") == 403
    assert knock(server) == 403
    response, body = get(server, Origin="http://evil.example")
    assert response.status == 403
    assert b"evil.example" in body
    assert get(server, Host="evil.example")[0].status == 403


def test_no_path_leads_out_of_the_page(server):
    assert get(server, "/../../../../etc/passwd")[0].status == 404
    assert get(server, "/%2e%2e/%2e%2e/setup.py")[0].status == 404


def test_nothing_is_shared_through_a_relay(server, monkeypatch):
    monkeypatch.setattr("viser._viser.ViserTunnel", None)
    assert server.request_share_url() is None
    assert server._share_tunnel is None


def test_bound_elsewhere_the_page_wants_its_token():
    listener = listen("0.0.0.0", 0)
    door = Door("0.0.0.0", listener.getsockname()[1])
    server = PageServer(listener, door, "test")
    try:
        assert get(server)[0].status == 403
        response, _ = get(server, f"/?token={door.token}")
        assert response.status == 200
        cookie = response.headers["Set-Cookie"].split(";")[0]
        own = f"http://127.0.0.1:{door.port}"
        assert knock(server, origin=own) == 403
        assert knock(server, origin=own, additional_headers={"Cookie": cookie}) is True
    finally:
        server.stop()


def test_viser_says_nothing_of_another_address():
    listener = listen("127.0.0.1", 0)
    with redirect_stdout(io.StringIO()) as said:
        PageServer(listener, Door("127.0.0.1", listener.getsockname()[1]), "test").stop()
    assert said.getvalue() == ""


def test_a_port_that_is_taken_is_a_sentence_and_the_default_one_moves_on():
    with listen("127.0.0.1", 0) as first:
        port = first.getsockname()[1]
        with pytest.raises(ConfigError, match=f"127.0.0.1:{port}.*choose another"):
            listen("127.0.0.1", port)
    with listen("127.0.0.1", None) as first, listen("127.0.0.1", None) as second:
        assert first.getsockname()[1] != second.getsockname()[1]


def test_an_address_that_is_not_ours_is_a_sentence():
    with pytest.raises(ConfigError, match=r"cannot listen on 192\.0\.2\.1"):
        listen("192.0.2.1", 0)
