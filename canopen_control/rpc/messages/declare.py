"""Declaration of a socket's methods: a request is a structure with the type of its reply.

    STORE: Api[Hello, Changed] = Api("store", Hello, {"changed": Changed})

    @STORE.method("get", Effect.READS)
    class Get(Request[Value], frozen=True):
        '''What this method does.'''
        key: str

Servers, clients, completion and the documentation of the protocol use these declarations. A request with an undeclared
field is refused; an undeclared field in an answer is skipped, so that an older client can read the answers of a newer
server. A number outside the range of its type (`NodeId`, `Index`, ...) is refused when a message is decoded.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Annotated, Any, Final, Generic, NamedTuple, TypeVar

import msgspec

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping


PROTOCOL: Final = 2
"""Protocol version of all sockets; increased when an older peer could misunderstand a message."""

# number types in messages, with their ranges
_LAST_COUNT: Final = (1 << 63) - 1
_LAST_TIME: Final = 1e11  # the year 5138, which the datetime module still supports

Index = Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)]
Subindex = Annotated[int, msgspec.Meta(ge=0, le=0xFF)]
NodeId = Annotated[int, msgspec.Meta(ge=1, le=127)]
# identifier of a CAN frame, with the flags of its format
Identifier = Annotated[int, msgspec.Meta(ge=0, le=0xFFFFFFFF)]
Bits = Annotated[int, msgspec.Meta(ge=0, le=64)]
BitRate = Annotated[int, msgspec.Meta(gt=0, le=_LAST_COUNT)]  # bit/s
Count = Annotated[int, msgspec.Meta(ge=0, le=_LAST_COUNT)]
UnixTime = Annotated[float, msgspec.Meta(ge=0, lt=_LAST_TIME)]  # seconds

A = TypeVar("A")
H = TypeVar("H")
P = TypeVar("P")
R = TypeVar("R", bound="Request[Any]")


class Request(msgspec.Struct, Generic[A], frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base class of requests; the type parameter `A` is the type of the reply."""


class Document(msgspec.Struct, frozen=True):
    """Base class of file contents and `--json` outputs; the field names are the JSON keys."""


class Done(msgspec.Struct, frozen=True):
    """Empty reply to a request that was executed."""


class Refusal(msgspec.Struct, frozen=True):
    """Error reply to a request; `kind` is the name of a class in errors.py."""

    kind: str = "RemoteError"
    message: str = "refused without a reason"


class Effect(enum.Enum):
    """Effect of a method on the robot; MOVES methods are refused while a stop is latched."""

    READS = "reads"
    CHANGES = "changes settings or states, moves nothing"
    MOVES = "may move"
    STOPS = "stops"


class Method(NamedTuple):
    """Method of a socket API, with its request and reply types."""

    name: str
    request: type[Request[Any]]
    answer: Any
    effect: Effect

    @property
    def text(self) -> str:
        """Description of the method: the first paragraph of the request's docstring, in one line."""
        return " ".join((self.request.__doc__ or "").strip().split("\n\n")[0].split())


class Api(Generic[H, P]):
    """Declared methods of one socket; `H` is the type of the greeting, `P` the types of pushed messages by key."""

    def __init__(self, name: str, hello: type[H], pushes: Mapping[str, type[P]]) -> None:
        self.name, self.hello, self.pushes = name, hello, pushes
        self.methods: dict[str, Method] = {}
        self._names: dict[type, str] = {}
        self._keys = {kind: key for key, kind in pushes.items()}

    def method(self, name: str, effect: Effect) -> Callable[[type[R]], type[R]]:
        """Return a decorator that declares a request as the method `name`."""

        def declare(request: type[R]) -> type[R]:
            (base,) = vars(request)["__orig_bases__"]
            self.methods[name] = Method(name, request, base.__args__[0], effect)
            self._names[request] = name
            return request

        return declare

    def declare(self, methods: Iterable[tuple[str, Effect, type[Request[Any]]]]) -> None:
        """Declare methods from another module's (name, effect, request) tuples."""
        for name, effect, request in methods:
            self.method(name, effect)(request)

    def of(self, request: type[Request[Any]]) -> Method:
        """Return the method of a request type; raise KeyError for an undeclared type."""
        return self.methods[self._names[request]]

    def key_of(self, push: type[P]) -> str:
        """Return the JSON key of a type of pushed message."""
        return self._keys[push]
