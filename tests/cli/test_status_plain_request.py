import json
import threading
from types import SimpleNamespace

import pytest

from canopen_control.cli import status
from canopen_control.cli.status import request_plain
from canopen_control.errors import RemoteError
from canopen_control.host.sockets import close_listener, listen, socket_path
from canopen_control.rpc.messages.declare import PROTOCOL

HELLO = {"hello": {"protocol": PROTOCOL, "robot": "fake"}}


@pytest.fixture
def answer():
    """Make a robot that greets with the first line and answers a request with the others; None closes."""
    listener = listen(socket_path("robot", "fake"))
    listener.setblocking(True)
    requests, threads = [], []

    def serve(greeting, answers):
        connection, _ = listener.accept()
        with connection, connection.makefile("rwb") as stream:
            stream.write(greeting)
            stream.flush()
            if line := stream.readline():
                requests.append(json.loads(line))
                stream.write(b"".join(answers))
                stream.flush()
                if answers:
                    stream.read()  # until the client has closed

    def start(greeting, *answers):
        lines = [
            part if isinstance(part, bytes) else json.dumps(part).encode() + b"\n" for part in (greeting, *answers)
        ]
        threads.append(threading.Thread(target=serve, args=(lines[0], lines[1:]), daemon=True))
        threads[-1].start()
        return requests

    yield start
    for thread in threads:
        thread.join(60)
    close_listener(listener)


def test_the_answer_is_what_json_holds_and_what_was_pushed_before_is_skipped(answer):
    requests = answer(HELLO, {"event": {"kind": "note"}}, {"id": 1, "result": {"state": "running", "load": 0.5}})
    assert request_plain("fake", "status") == SimpleNamespace(state="running", load=0.5)
    assert requests == [{"id": 1, "method": "status", "params": {}}]


@pytest.mark.parametrize(
    "lines",
    [
        [{"hello": {"protocol": PROTOCOL + 1}}],
        [{"error": {"kind": "RemoteError", "message": "too many clients"}}],
        [b"[1, 2]\n"],
        [b"{nonsense\n"],
        [HELLO, {"id": 1, "error": {"kind": "ControlError", "message": "no"}}],
        [HELLO, {"id": 1, "result": 7}],
        [HELLO, b"{nonsense\n"],
    ],
)
def test_what_is_not_as_expected_is_left_to_the_typed_client(answer, lines):
    answer(*lines)
    assert request_plain("fake", "status") is None


def test_a_robot_that_is_not_there_or_has_gone_is_an_error(answer):
    with pytest.raises(RemoteError, match="robot other is not running"):
        request_plain("other", "status")
    answer(HELLO)
    with pytest.raises(RemoteError, match="robot fake has closed the connection") as caught:
        request_plain("fake", "status")
    assert caught.value.kind == "BusClosed"


@pytest.mark.parametrize(
    ("lines", "sentence"), [([b""], "does not answer"), ([HELLO, b"\n"], "did not answer 'status'")]
)
def test_a_robot_that_hangs_is_an_error(answer, lines, sentence):
    answer(*lines)
    with pytest.raises(RemoteError, match=sentence) as caught:
        request_plain("fake", "status", timeout=0.02)
    assert caught.value.kind == "Timeout"


def test_the_protocol_is_that_of_the_messages():
    assert status._PROTOCOL == PROTOCOL
