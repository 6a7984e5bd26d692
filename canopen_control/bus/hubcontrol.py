"""What a hub can be asked and told through its control socket: one table, a method a line.

A request is {"id", "method", "params"}; what is wrong with one is answered with a sentence and changes nothing.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from canopen_control.bus import error_frames
from canopen_control.bus.faults import DropRule
from canopen_control.errors import CanopenError, ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.bus.exchange import Exchange, Member
    from canopen_control.frame import CanFrame
    from canopen_control.host.jsonlines import Connection

__all__ = ["ERROR_KINDS", "PROTOCOL", "Control"]

PROTOCOL = 1
_NS_PER_MS = 1_000_000
_MAX_BITRATE = 1_000_000  # classic CAN

ERROR_KINDS: dict[str, Callable[[], CanFrame]] = {
    "bus-error": error_frames.protocol_error_frame,
    "error-passive": error_frames.passive_frame,
    "error-active": error_frames.active_frame,
    "overrun": lambda: error_frames.overrun_frame(0),
}


class Control:
    """Serves the requests of one hub; `after` is called when the exchange may have something to send."""

    def __init__(self, name: str, exchange: Exchange, now: Callable[[], int], after: Callable[[], None]) -> None:
        self._name, self._exchange, self._now, self._after = name, exchange, now, after
        self._started = now()
        self._methods: dict[str, Callable[[_Params], object]] = {
            "status": self._status,
            "cut": lambda params: exchange.cut(self._label(params)),
            "uncut": lambda params: exchange.cut(self._label(params), mend=True),
            "bus_off": lambda params: exchange.bus_off(self._label(params)),
            "restart": lambda params: exchange.bus_off(self._label(params), restart=True),
            "error_frame": self._error_frame,
            "drop": self._drop,
            "delay": self._delay,
            "bitrate": self._bitrate,
            "clear": lambda _params: exchange.clear_faults(),
        }

    def on_connect(self, connection: Connection) -> None:
        """Greet a client."""
        connection.send({"hello": {"bus": self._name, "protocol": PROTOCOL, "pid": os.getpid()}})

    def on_message(self, connection: Connection, message: dict[str, object]) -> None:
        """Answer a request; one without an id is done and not answered."""
        answer = self.handle(message)
        if "id" in message:
            connection.send({"id": message["id"], **answer})

    def handle(self, message: Mapping[str, object]) -> dict[str, object]:
        """Do what a request says; return {"result"} or {"error"}."""
        method, params = message.get("method"), message.get("params", {})
        try:
            if not isinstance(method, str) or method not in self._methods:
                raise ConfigError(f"no method {method!r}; there are: {', '.join(self._methods)}")
            if not isinstance(params, dict):
                raise ConfigError("params is an object")
            result = self._methods[method](_Params(params))
        except CanopenError as error:
            return {"error": {"kind": type(error).__name__, "message": str(error)}}
        self._after()
        return {"result": result}

    def _label(self, params: _Params, *, optional: bool = False) -> str:
        """Return a label that somebody has or whose wires are faulty; "" for everybody where that makes sense."""
        label = params.text("label", "" if optional else None)
        faults = self._exchange.faults
        known = [member.label for member in self._exchange.members.values()]
        if label in known or faults.silences(label) or label in faults.delays or (optional and not label):
            return label
        raise ConfigError(f"nobody called {label!r} on local:{self._name}; there are: {', '.join(known) or 'none'}")

    def _error_frame(self, params: _Params) -> None:
        kind = params.text("kind", "bus-error")
        if kind not in ERROR_KINDS:
            raise ConfigError(f"no error frame {kind!r}; there are: {', '.join(ERROR_KINDS)}")
        frame = ERROR_KINDS[kind]()
        self._exchange.report(self._label(params, optional=True), frame)

    def _drop(self, params: _Params) -> None:
        self._exchange.faults.drops.append(
            DropRule(
                self._label(params, optional=True),
                params.integer("can_id", None, 0, 0xFFFFFFFF),
                params.integer("every", 1, 1, 1 << 31) or 1,
                params.integer("count", None, 1, 1 << 31),
            )
        )

    def _delay(self, params: _Params) -> None:
        milliseconds = params.integer("ms", None, 0, 60_000)
        if milliseconds is None:
            raise ConfigError("delay wants ms, 0 to 60000")
        self._exchange.faults.delay(self._label(params, optional=True), milliseconds * _NS_PER_MS)

    def _bitrate(self, params: _Params) -> None:
        self._exchange.pace(params.integer("bitrate", None, 0, _MAX_BITRATE), self._now())

    def _status(self, _params: _Params) -> dict[str, object]:
        exchange, now = self._exchange, self._now()
        return {
            "bus": self._name,
            "pid": os.getpid(),
            "uptime_s": (now - self._started) / 1e9,
            "bitrate": None if exchange.wire is None else exchange.wire.bitrate,
            "load": exchange.load(now),
            "frames": exchange.frames,
            "dropped": exchange.dropped,
            "members": [self._member(member) for member in exchange.members.values()],
            "cut": sorted(exchange.faults.cut),
            "bus_off": sorted(exchange.faults.bus_off),
            "delays_ms": {label: delay / _NS_PER_MS for label, delay in exchange.faults.delays.items()},
            "drops": [rule.as_dict() for rule in exchange.faults.drops],
        }

    @staticmethod
    def _member(member: Member) -> dict[str, object]:
        return {
            "label": member.label,
            "pid": member.pid,
            "rx": member.rx,
            "tx": member.tx,
            "lost": member.lost,
            "queued": len(member.outbox) // 16,
        }


class _Params:
    """The parameters of a request, by name and type; `ConfigError` for what is missing or wrong."""

    def __init__(self, values: Mapping[str, object]) -> None:
        self._values = values

    def text(self, key: str, default: str | None) -> str:
        value = self._values.get(key, default)
        if not isinstance(value, str):
            raise ConfigError(f"{key} is missing or no text")
        return value

    def integer(self, key: str, default: int | None, low: int, high: int) -> int | None:
        value = self._values.get(key, default)
        if value is None:
            return default
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise ConfigError(f"{key} is no integer from {low} to {high}: {value!r}")
        return value
