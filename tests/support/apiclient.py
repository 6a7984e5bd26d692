"""A raw client of the API, for tests in simulated time."""

import contextlib
import json
import socket
from base64 import b64encode

from canopen_control.host.sockets import socket_path


def base64_of(text):
    """Return bytes, given in hexadecimal, as the API has them."""
    return b64encode(bytes.fromhex(text)).decode()


class Client:
    """A raw client: what it sends is bytes, what it gets are messages."""

    def __init__(self, bench):
        self._bench, self._buffer = bench, b""
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.setblocking(False)
        self.socket.connect(str(socket_path("robot", bench.setup.name)))
        self.hello = self.next()

    def send(self, **message):
        self.socket.send(json.dumps(message).encode() + b"\n")

    def messages(self):
        with contextlib.suppress(BlockingIOError):
            self._buffer += self.socket.recv(1 << 20)
        *lines, self._buffer = self._buffer.split(b"\n")
        return [json.loads(line) for line in lines]

    def next(self, ms=2000):
        results = []
        self._bench.until(lambda: results.extend(self.messages()) or results, ms=ms)
        assert len(results) == 1, results
        return results[0]

    def ask(self, method, **params):
        self.send(id=1, method=method, params=params)
        answer = self.next(ms=20_000)
        assert answer["id"] == 1
        return answer

    def close(self):
        self.socket.close()
