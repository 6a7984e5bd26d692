"""Declaration of a socket's methods: a request is a structure with the type of its answer.

    STORE: Api[Hello, Changed] = Api("store", Hello, {"changed": Changed})

    @STORE.method("get", Effect.READS)
    class Get(Request[Value], frozen=True):
        '''What this method does.'''
        key: str

Server, clients, completion and the page of the protocol follow from these declarations. A field that a request does not
declare is refused, one that an answer does not declare is skipped, so that an older client can read a newer server's
answers. A number outside the range of its type (`NodeId`, `Index`, ...) is refused where a message is decoded.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Annotated, Any, Final, Generic, NamedTuple, TypeVar

import msgspec

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping


PROTOCOL: Final = 2
"""The version of all sockets; it goes up when what one side says may be misunderstood by the other."""

# numbers of messages, each with its range
_LAST_COUNT: Final = (1 << 63) - 1
_LAST_TIME: Final = 1e11  # the year 5138: a calendar has all before it

Index = Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)]
Subindex = Annotated[int, msgspec.Meta(ge=0, le=0xFF)]
NodeId = Annotated[int, msgspec.Meta(ge=1, le=127)]
Identifier = Annotated[int, msgspec.Meta(ge=0, le=0xFFFFFFFF)]  # of a frame, with the flags of its kind
Bits = Annotated[int, msgspec.Meta(ge=0, le=64)]
BitRate = Annotated[int, msgspec.Meta(gt=0, le=_LAST_COUNT)]  # bit/s
Count = Annotated[int, msgspec.Meta(ge=0, le=_LAST_COUNT)]
UnixTime = Annotated[float, msgspec.Meta(ge=0, lt=_LAST_TIME)]  # seconds

A = TypeVar("A")
H = TypeVar("H")
P = TypeVar("P")
R = TypeVar("R", bound="Request[Any]")


class Request(msgspec.Struct, Generic[A], frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Request of a method; `A` is the type of its answer."""


class Document(msgspec.Struct, frozen=True):
    """Content of a file, or output of `--json`: the fields are its keys."""


class Done(msgspec.Struct, frozen=True):
    """Empty answer of a method that was executed."""


class Refusal(msgspec.Struct, frozen=True):
    """Error of a request; `kind` is a class of errors.py."""

    kind: str = "RemoteError"
    message: str = "refused without a reason"


class Effect(enum.Enum):
    """Effect of a method; methods that move are refused while a stop is latched."""

    READS = "reads"
    CHANGES = "changes settings or states, moves nothing"
    MOVES = "may move"
    STOPS = "stops"


class Method(NamedTuple):
    """Method of a socket."""

    name: str
    request: type[Request[Any]]
    answer: Any
    effect: Effect

    @property
    def text(self) -> str:
        """Description: the first paragraph of its docstring on one line."""
        return " ".join((self.request.__doc__ or "").strip().split("\n\n")[0].split())


class Api(Generic[H, P]):
    """Methods of one socket by name, its greeting `H` and its pushed messages `P`, by key."""

    def __init__(self, name: str, hello: type[H], pushes: Mapping[str, type[P]]) -> None:
        self.name, self.hello, self.pushes = name, hello, pushes
        self.methods: dict[str, Method] = {}
        self._names: dict[type, str] = {}
        self._keys = {kind: key for key, kind in pushes.items()}

    def method(self, name: str, effect: Effect) -> Callable[[type[R]], type[R]]:
        """Declare the decorated request as that of a method."""

        def declare(request: type[R]) -> type[R]:
            (base,) = vars(request)["__orig_bases__"]
            self.methods[name] = Method(name, request, base.__args__[0], effect)
            self._names[request] = name
            return request

        return declare

    def declare(self, methods: Iterable[tuple[str, Effect, type[Request[Any]]]]) -> None:
        """Declare methods with requests of another module: name, effect, request."""
        for name, effect, request in methods:
            self.method(name, effect)(request)

    def of(self, request: type[Request[Any]]) -> Method:
        """Return the method of a request."""
        return self.methods[self._names[request]]

    def key_of(self, push: type[P]) -> str:
        """Return the key of a pushed message."""
        return self._keys[push]
