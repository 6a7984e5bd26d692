"""The access check over real sockets, with the toolkit behind it, in a process as it is started."""

import asyncio
import contextlib
import http.client
import os
import re
import socket
import subprocess
import sys

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

import websockets.asyncio.client as wsclient
import websockets.exceptions

from canopen_control.errors import ConfigError
from canopen_control.view.page_address import AccessRules
from canopen_control.view.page_server import access_problem, listen

SOCKET = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
TOKEN = "secret"
SERVE = """
import asyncio, sys
from canopen_control.view.page_address import AccessRules
from canopen_control.view import page_server as server
host, token, tamper = sys.argv[1:]
if tamper:
    server.AccessMiddleware = lambda app, rules: app
listener = server.listen(host, 0)
rules = AccessRules(host, listener.getsockname()[1], token)
def build():
    from nicegui import ui
    ui.label("the page")
stopped = []
def stop():
    stopped.append(1)
    return None if len(stopped) == 1 else "the robot is gone"
page = server.PageServer(listener, rules, "test", build, stop)
try:
    asyncio.run(page.serve(lambda: print("ready", rules.port, flush=True)))
except server.ControlError as error:
    print("refused", error, flush=True)
    sys.exit(1)
"""


@contextlib.contextmanager
def served(host="127.0.0.1", token=TOKEN, tamper=""):
    process = subprocess.Popen(
        [sys.executable, "-c", SERVE, host, token, tamper], stdout=subprocess.PIPE, text=True, env=dict(os.environ)
    )
    try:
        yield process, process.stdout.readline()
    finally:
        process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def port():
    with served() as (_, line):
        yield int(line.split()[1])


@pytest.fixture(scope="module")
def open_port():
    with served("0.0.0.0") as (_, line):
        yield int(line.split()[1])


def ask(port, path="/", method="GET", token=TOKEN, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request(method, f"/{token}{path}" if token else path, headers=headers)
    response = connection.getresponse()
    body = response.read()
    connection.close()
    return response, body


def knock(port, token=TOKEN, **options):
    """Open a WebSocket as the page does; True if it was let in."""

    root = f"/{token}" if token else ""

    async def attempt():
        try:
            async with wsclient.connect(f"ws://127.0.0.1:{port}{root}{SOCKET}", proxy=None, **options) as result:
                return (await asyncio.wait_for(result.recv(), 5)).startswith("0{")
        except websockets.exceptions.InvalidStatus as error:
            return error.response.status_code

    return asyncio.run(attempt())


def test_the_page_is_served_to_this_computer_alone_and_loads_from_no_other_origin(port):
    response, body = ask(port)
    assert response.status == 200
    assert b"the page" in body
    policy = response.headers["Content-Security-Policy"]
    assert "default-src 'self'" in policy
    assert "connect-src 'self' blob:;" in policy
    with pytest.raises(OSError, match=r".*"):
        socket.create_connection(("127.0.0.2", port), timeout=1).close()


def test_scripts_of_the_page_carry_a_nonce_of_its_own_and_no_other_runs(port):
    response, body = ask(port)
    policy = response.headers["Content-Security-Policy"]
    nonce = policy.split("'nonce-")[1].split("'")[0].encode()
    assert body.count(b"<script") == body.count(b'<script nonce="%s"' % nonce) > 3
    assert "'unsafe-inline'" not in policy.split("script-src")[1].split(";")[0]
    assert nonce not in ask(port)[1]


def test_stop_is_for_our_own_page_alone_and_reports_when_it_did_not_reach(port):
    assert ask(port, "/stop")[0].status != 200
    assert ask(port, "/stop", "POST")[0].status == 403
    assert ask(port, "/stop", "POST", Origin="http://evil.example")[0].status == 403
    own = {"Origin": f"http://127.0.0.1:{port}"}
    assert ask(port, "/stop", "POST", **own)[0].status == 200
    response, body = ask(port, "/stop", "POST", **own)
    assert (response.status, body) == (503, b"the robot is gone")


@pytest.mark.parametrize("which", [0, 1], ids=["loopback", "everywhere"])
def test_without_its_token_the_page_answers_no_client_even_on_loopback(which, port, open_port):
    result = (port, open_port)[which]
    own = f"http://127.0.0.1:{result}"
    assert (ask(result)[0].status, knock(result, origin=own)) == (200, True)
    files = ("/", f"/?token={TOKEN}", "/_nicegui/x/nicegui.js", "/_nicegui_ws/socket.io/?EIO=4&transport=polling")
    for token in ("", "wrong", f"{TOKEN}x"):
        for path in files:
            assert ask(result, path, token=token)[0].status == 403
            assert ask(result, path, token=token, Cookie=f"canopen_control_{result}={TOKEN}")[0].status == 403
        assert ask(result, "/stop", "POST", token, Origin=own)[0].status == 403
        assert knock(result, token, origin=own) == 403
    assert "Set-Cookie" not in ask(result)[0].headers
    assert knock(result, origin="http://evil.example") == 403


def test_every_address_in_the_page_begins_with_the_token(port):
    body = ask(port)[1].decode()
    written = re.findall(r'(?:src|href)="(/[^"]*)"|url\("(/[^"]*)"\)|"(/_nicegui[^"]*)"', body)
    assert len(written) > 5
    assert [item for item in map("".join, written) if not item.startswith(f"/{TOKEN}/")] == []


@pytest.mark.process
def test_a_server_without_its_door_does_not_serve():
    with served(tamper="yes") as (process, line):
        assert line.startswith(
            "refused the page's access check fails: a request without the token is answered with 200"
        )
        assert process.wait(60) == 1


def test_a_server_that_does_not_answer_is_a_problem_too():
    with socket.create_server(("127.0.0.1", 0)) as nobody:
        rules = AccessRules("127.0.0.1", nobody.getsockname()[1])
        nobody.close()
        assert "does not answer" in asyncio.run(access_problem(rules))


def test_a_port_that_is_taken_is_a_sentence_and_the_default_one_moves_on():
    with listen("127.0.0.1", 0) as first:
        port = first.getsockname()[1]
        with pytest.raises(ConfigError, match=f"127.0.0.1:{port}.*choose another"):
            listen("127.0.0.1", port)
    with listen("127.0.0.1", None) as first, listen("127.0.0.1", None) as second:
        assert first.getsockname()[1] != second.getsockname()[1]
    with listen("127.0.0.1", 0) as free:
        port = free.getsockname()[1]
    with listen("127.0.0.1", None, first=port) as expected, listen("127.0.0.1", None, first=port) as other:
        assert expected.getsockname()[1] == port != other.getsockname()[1]
