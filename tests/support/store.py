"""A small declared socket, for the tests of server and clients."""

import msgspec

from canopen_control.rpc.messages.declare import PROTOCOL, Api, Done, Effect, Request


class Hello(msgspec.Struct, frozen=True):
    store: str
    protocol: int = PROTOCOL


class Value(msgspec.Struct, frozen=True):
    number: float


class Changed(msgspec.Struct, frozen=True):
    key: str


STORE: Api[Hello, Changed] = Api("store", Hello, {"changed": Changed})


@STORE.method("get", Effect.READS)
class Get(Request[Value], frozen=True):
    """The value of a key.

    More of it.
    """

    key: str


@STORE.method("put", Effect.CHANGES)
class Put(Request[Done], frozen=True, kw_only=True):
    """Set the value of a key."""

    key: str
    number: float = 0.0
