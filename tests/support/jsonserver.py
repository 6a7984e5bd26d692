"""Servers of lines whose answers a test makes by hand, as JSON says them."""

import json

from canopen_control.host.lineserver import LineServer
from canopen_control.rpc import wire


def line_of(message):
    """Return a message as its line; a number that is not finite becomes null."""
    return wire.text_of(message) + b"\n"


def say(connection, message):
    """Send a message, as the answer that it is where it has an id."""
    (connection.answer if "id" in message else connection.send)(line_of(message))


def error_line(kind, message):
    return line_of({"error": {"kind": kind, "message": message}})


def json_server(reactor, path, on_connect, on_message, on_close=lambda _connection: None, **options):
    """Return a server whose `on_message` gets a connection and what its line says."""

    def on_line(connection, line):
        message = json.loads(line)
        if "id" in message:
            connection.expect_answer()
        on_message(connection, message)

    return LineServer(reactor, path, on_connect, on_line, on_close, error_line=error_line, **options)
