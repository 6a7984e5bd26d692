"""Emergency object (EMCY), producer and consumer (CiA 301, 7.2.7, 7.5.2.2 to 7.5.2.4, 7.5.2.17 and 7.5.2.18).

The producer keeps the active errors, the error register (0x1001) computed from them, and the history (0x1003, newest
first). Each new error is sent once. When an error is cleared, an error reset (0x0000) is sent with the remaining
register bits. The consumer accepts 3 to 8 bytes, because some devices omit the manufacturer-specific part. The numbers
of active errors and of waiting messages are limited in both.
"""

from __future__ import annotations

import enum
from collections import deque
from dataclasses import dataclass

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.outbox import Outbox
from canopen_control.frame import CanFrame

# Error codes: CiA 301, 7.2.7; CiA 402-2 for drives. A code that is missing here takes the text of the closest class
# (its first 12, 8 or 4 bits). Class FFxx is manufacturer-specific.


class ErrorRegister(enum.IntFlag):
    """Bits of the error register 0x1001 (CiA 301, 7.5.2.2); GENERIC is set whenever another bit is set."""

    NONE = 0
    GENERIC = 0x01
    CURRENT = 0x02
    VOLTAGE = 0x04
    TEMPERATURE = 0x08
    COMMUNICATION = 0x10
    DEVICE_PROFILE = 0x20
    MANUFACTURER = 0x80


ERROR_TEXTS: dict[int, str] = {
    0x0000: "error reset or no error",
    0x1000: "generic error",
    0x2000: "current",
    0x2100: "current, device input side",
    0x2110: "short circuit or earth leakage, input side",
    0x2120: "earth leakage, input side",
    0x2130: "short circuit, input side",
    0x2200: "current inside the device",
    0x2213: "over-current in ramp function",
    0x2214: "over-current in the sequence",
    0x2220: "continuous over-current inside the device",
    0x2230: "short circuit or earth leakage inside the device",
    0x2240: "earth leakage inside the device",
    0x2250: "short circuit inside the device",
    0x2300: "current, device output side",
    0x2310: "continuous over-current",
    0x2320: "short circuit or earth leakage, motor side",
    0x2330: "earth leakage, motor side",
    0x2340: "short circuit, motor side",
    0x2350: "load level fault (I2t, thermal)",
    0x3000: "voltage",
    0x3100: "mains voltage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3130: "mains phase failure",
    0x3140: "mains frequency",
    0x3200: "voltage inside the device",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x3230: "load error",
    0x3300: "output voltage",
    0x3310: "output over-voltage",
    0x3320: "armature circuit",
    0x3330: "field circuit",
    0x4000: "temperature",
    0x4100: "ambient temperature",
    0x4110: "ambient temperature too high",
    0x4120: "ambient temperature too low",
    0x4130: "supply air temperature",
    0x4140: "air outlet temperature",
    0x4200: "device temperature",
    0x4210: "device temperature too high",
    0x4220: "device temperature too low",
    0x4300: "drive temperature",
    0x4310: "drive temperature too high",
    0x4320: "drive temperature too low",
    0x4400: "supply temperature",
    0x4410: "supply temperature too high",
    0x4420: "supply temperature too low",
    0x5000: "device hardware",
    0x5100: "supply",
    0x5110: "low-voltage supply",
    0x5120: "supply of the intermediate circuit",
    0x5200: "control hardware",
    0x5210: "measurement circuit",
    0x5220: "computing circuit",
    0x5300: "operating unit",
    0x5400: "power section",
    0x5410: "output stages",
    0x5420: "chopper",
    0x5430: "input stages",
    0x5440: "contacts",
    0x5441: "contact 1: shutdown or enable input",
    0x5450: "fuses",
    0x5500: "hardware memory",
    0x5510: "working memory",
    0x5520: "program memory",
    0x5530: "non-volatile memory",
    0x6000: "device software",
    0x6010: "software reset (watchdog)",
    0x6100: "internal software",
    0x6200: "user software",
    0x6300: "data set",
    0x6310: "loss of parameters",
    0x6320: "parameter error",
    0x7000: "additional modules",
    0x7100: "power module",
    0x7110: "brake chopper",
    0x7111: "brake chopper failure",
    0x7112: "brake chopper over-current",
    0x7113: "brake chopper protective circuit",
    0x7120: "motor",
    0x7121: "motor blocked",
    0x7122: "motor error or commutation malfunction",
    0x7123: "motor tilted",
    0x7200: "measurement circuit module",
    0x7300: "sensor",
    0x7301: "tacho fault",
    0x7302: "tacho wrong polarity",
    0x7303: "resolver 1 fault",
    0x7304: "resolver 2 fault",
    0x7305: "incremental sensor 1 fault",
    0x7306: "incremental sensor 2 fault",
    0x7307: "incremental sensor 3 fault",
    0x7310: "speed sensor",
    0x7320: "position sensor",
    0x7400: "computation circuit module",
    0x7500: "communication module",
    0x7510: "serial interface 1",
    0x7520: "serial interface 2",
    0x7600: "data storage module",
    0x8000: "monitoring",
    0x8100: "communication",
    0x8110: "CAN overrun (objects lost)",
    0x8120: "CAN in error passive mode",
    0x8130: "life guard or heartbeat error",
    0x8140: "recovered from bus-off",
    0x8150: "CAN-ID collision",
    0x8200: "protocol error",
    0x8210: "PDO not processed: too short",
    0x8220: "PDO too long",
    0x8230: "DAM MPDO not processed: destination not available",
    0x8240: "unexpected SYNC data length",
    0x8250: "RPDO timeout",
    0x8300: "torque control",
    0x8311: "excess torque",
    0x8312: "difficult start-up",
    0x8313: "standstill torque",
    0x8321: "insufficient torque",
    0x8331: "torque fault",
    0x8400: "velocity control",
    0x8500: "position control",
    0x8600: "positioning",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "synchronisation control",
    0x8800: "winding control",
    0x8900: "process data monitoring",
    0x8A00: "control monitoring",
    0x9000: "external error",
    0xF000: "additional functions",
    0xF001: "deceleration",
    0xF002: "sub-synchronous run",
    0xF003: "stroke operation",
    0xF004: "control",
    0xFF00: "device specific",
}

REGISTER_TEXTS: dict[ErrorRegister, str] = {
    ErrorRegister.GENERIC: "generic",
    ErrorRegister.CURRENT: "current",
    ErrorRegister.VOLTAGE: "voltage",
    ErrorRegister.TEMPERATURE: "temperature",
    ErrorRegister.COMMUNICATION: "communication",
    ErrorRegister.DEVICE_PROFILE: "device profile",
    ErrorRegister.MANUFACTURER: "manufacturer",
}


def error_text(code: int) -> str:
    """Return the meaning of an error code or of the closest class in the table, else "unknown error code"."""
    masks = (0xFFFF, 0xFFF0, 0xFF00, 0xF000) if code >> 12 else (0xFFFF, 0xFF00)
    for mask in masks:
        if (text := ERROR_TEXTS.get(code & mask)) is not None:
            return text
    return f"unknown error code 0x{code:04X}"


def code_text(code: int) -> str:
    """Return an error code of EMCY, 0x1003 or 0x603F with its meaning, such as "0x8611 (following error)"."""
    return f"0x{code:04X} ({error_text(code)})"


def register_text(register: int) -> str:
    """Return the names of the set bits of an error register, separated by commas; empty for 0."""
    return ", ".join(text for bit, text in REGISTER_TEXTS.items() if register & bit)


def is_reset_code(code: int) -> bool:
    """Whether an error code means an error reset or no error: 00xx."""
    return code <= 0xFF


EMCY_COB_ID = 0x080
NO_ERROR = 0x0000
MANUFACTURER_BYTES = 5


@dataclass(frozen=True, slots=True)
class EmcyMessage:
    """Emergency message; `data` are the manufacturer-specific bytes: 5 in the standard, fewer from some devices."""

    node_id: int
    error_code: int
    error_register: int
    data: bytes = bytes(MANUFACTURER_BYTES)

    @classmethod
    def parse(cls, frame: CanFrame, node_id: int | None = None) -> EmcyMessage | None:
        """Return the message in `frame`, or None if it is not an emergency message.

        Without `node_id` the COB-ID must be between 0x081 and 0x0FF. Frames of fewer than 3 bytes are rejected.
        """
        if node_id is None:
            if not EMCY_COB_ID < frame.can_id <= EMCY_COB_ID + 127:
                return None
            node_id = frame.can_id - EMCY_COB_ID
        data = frame.data
        # CiA 301, 7.2.7: 8 bytes; some devices omit manufacturer-specific bytes
        if len(data) < 3:
            return None
        return cls(node_id, data[0] | data[1] << 8, data[2], data[3:8])

    def encode(self, cob_id: int | None = None) -> CanFrame:
        """Return the 8-byte frame; without `cob_id` its COB-ID is 0x080 + node-ID."""
        head = bytes((self.error_code & 0xFF, self.error_code >> 8 & 0xFF, self.error_register & 0xFF))
        data = head + self.data[:MANUFACTURER_BYTES].ljust(MANUFACTURER_BYTES, b"\0")
        return CanFrame(EMCY_COB_ID + self.node_id if cob_id is None else cob_id, data)

    @property
    def is_reset(self) -> bool:
        """Whether the message reports an error reset or no error: code 00xx."""
        return is_reset_code(self.error_code)

    def __str__(self) -> str:
        """Return the code, its meaning, the register and nonzero manufacturer-specific bytes in one line."""
        extra = f", data {self.data.hex(' ')}" if any(self.data) else ""
        return f"{code_text(self.error_code)}, register 0x{self.error_register:02X}{extra}"


class EmcyProducer:
    """Producer of the EMCY messages of one node, with the `error_register` (0x1001) and the `history` (0x1003).

    `cob_id` (0x1014) can be changed; `enabled` is the inverse of its bit 31. `inhibit_ns` (0x1015) is the minimum time
    between two messages. `allowed` is True while the NMT state permits EMCY; otherwise errors enter the register and
    the history, but are not sent. At most `active_limit` errors are active and `queue_limit` messages wait; beyond that
    the oldest error or message is dropped. `lost` counts dropped messages.
    """

    def __init__(
        self,
        node_id: int,
        *,
        inhibit_ns: int = 0,
        history_size: int = 8,
        active_limit: int = 32,
        queue_limit: int = 32,
    ) -> None:
        self.node_id = node_id
        self.cob_id = EMCY_COB_ID + node_id
        self.enabled = True
        self.allowed = True
        self.inhibit_ns = inhibit_ns
        self.active_limit = active_limit
        self._active: dict[int, int] = {}
        self._history: deque[int] = deque(maxlen=history_size)
        self._waiting: deque[EmcyMessage] = deque(maxlen=queue_limit)
        self._ready_ns: int | None = None  # time of the next message allowed; None: now
        self.outgoing: Outbox[CanFrame] = Outbox()
        self._lost = 0

    @property
    def error_register(self) -> int:
        """Error register 0x1001, computed from the active errors."""
        register = 0
        for bits in self._active.values():
            register |= bits
        # CiA 301, 7.5.2.2: bit 0 is set with every other bit
        return register | ErrorRegister.GENERIC if self._active else 0

    @property
    def active(self) -> tuple[int, ...]:
        """Codes of the active errors, oldest first."""
        return tuple(self._active)

    @property
    def history(self) -> tuple[int, ...]:
        """History of errors (0x1003) from subindex 1 on, newest first.

        The error code is in bits 0 to 15, two manufacturer-specific bytes above it.
        """
        return tuple(self._history)

    @property
    def lost(self) -> int:
        """Number of messages dropped because the queue was full."""
        return self._lost + self.outgoing.lost

    def raise_error(self, code: int, register: int, now: int, data: bytes = b"") -> bool:
        """Activate an error and send its EMCY message if permitted; return False if the error is already active."""
        # CiA 301, 7.2.7: an error is sent once when it occurs
        if code in self._active:
            return False
        if len(self._active) >= self.active_limit:
            del self._active[next(iter(self._active))]
        self._active[code] = register
        data = data[:MANUFACTURER_BYTES].ljust(MANUFACTURER_BYTES, b"\0")
        self._history.appendleft(code & 0xFFFF | int.from_bytes(data[:2], "little") << 16)
        self._send(EmcyMessage(self.node_id, code, self.error_register, data), now)
        return True

    def report(self, code: int, now: int, data: bytes = b"", *, register: int = 0) -> None:
        """Raise an error and clear it at once, for an event without duration such as 0x8110 (lost frames).

        The error register therefore never keeps a bit that no later message would clear.
        """
        if self.raise_error(code, register, now, data):
            self.clear_error(code, now)

    def clear_error(self, code: int, now: int) -> bool:
        """Remove an error and send an error reset with the remaining register bits; return False if not active."""
        if self._active.pop(code, None) is None:
            return False
        # CiA 301, 7.2.7: error code 0x0000, and the errors that remain in the register
        self._send(EmcyMessage(self.node_id, NO_ERROR, self.error_register), now)
        return True

    def reset(self) -> None:
        """Clear errors, history and waiting messages (NMT reset node)."""
        self._active.clear()
        self._history.clear()
        self._waiting.clear()
        self._ready_ns = None

    def read_history(self, subindex: int) -> int | None:
        """Return 0x1003:`subindex`; subindex 0 is the number of entries. None if the entry does not exist."""
        if subindex == 0:
            return len(self._history)
        return self._history[subindex - 1] if 1 <= subindex <= len(self._history) else None

    def write_history_count(self, value: int) -> AbortCode | None:
        """Write 0x1003:00: 0 clears the history; return the abort code for any other value (CiA 301, 7.5.2.4)."""
        if value:
            return AbortCode.INVALID_VALUE
        self._history.clear()
        return None

    def receive(self, frame: CanFrame, now: int) -> None:
        """Ignore the frame; an EMCY producer receives nothing."""

    def tick(self, now: int) -> None:
        """Send the waiting messages that the inhibit time permits; discard all while the NMT state forbids EMCY."""
        if not self.allowed:
            self._waiting.clear()
        while self._waiting and (self._ready_ns is None or now >= self._ready_ns):
            self._put(self._waiting.popleft(), now)

    def next_deadline(self) -> int | None:
        return self._ready_ns if self._waiting else None

    def frames(self) -> list[CanFrame]:
        return self.outgoing.drain()

    def events(self) -> list[object]:
        return []

    def _send(self, message: EmcyMessage, now: int) -> None:
        # CiA 301, 7.5.2.17: bit 31 of 0x1014; 7.3.2.2.5: no EMCY while INITIALISING or STOPPED
        if not (self.enabled and self.allowed):
            return
        self.tick(now)
        if not self._waiting and (self._ready_ns is None or now >= self._ready_ns):
            self._put(message, now)
            return
        self._lost += len(self._waiting) == self._waiting.maxlen
        self._waiting.append(message)

    def _put(self, message: EmcyMessage, now: int) -> None:
        self.outgoing.put(message.encode(self.cob_id))
        # CiA 301, 7.5.2.18: the inhibit time separates two messages
        self._ready_ns = now + self.inhibit_ns if self.inhibit_ns else None


class EmcyConsumer:
    """Consumer of one node's EMCY messages; keeps up to `active_limit` active errors and drops the oldest.

    `register` is the last reported error register, 0 before any message; `malformed` counts frames of fewer than 3
    bytes.
    """

    def __init__(self, node_id: int, *, active_limit: int = 32) -> None:
        self.node_id = node_id
        self.cob_id = EMCY_COB_ID + node_id
        self.active_limit = active_limit
        self.register = 0
        self.malformed = 0
        self._active: dict[int, int] = {}  # error code: register bits that were new with it
        self._possibly_cleared: set[int] = set()  # errors reported before the last error reset
        self._events: Outbox[EmcyMessage] = Outbox()

    @property
    def active(self) -> tuple[int, ...]:
        """Error codes that the node has reported and not reset, oldest first."""
        return tuple(self._active)

    @property
    def lost(self) -> int:
        """Number of messages dropped before the owner fetched them."""
        return self._events.lost

    def forget(self) -> None:
        """Clear the active errors after the node has restarted."""
        self._active.clear()
        self.register = 0

    def receive(self, frame: CanFrame, now: int) -> None:  # noqa: ARG002 - the verb of every core
        if frame.can_id != self.cob_id:
            return
        message = EmcyMessage.parse(frame, self.node_id)
        if message is None:
            self.malformed += 1
            return
        self._note(message)
        self._events.put(message)

    def tick(self, now: int) -> None:
        """Do nothing; this core has no timers."""

    def next_deadline(self) -> None:
        """Return None; this core has no timers."""

    def frames(self) -> list[CanFrame]:
        return []

    def events(self) -> list[EmcyMessage]:
        return self._events.drain()

    def _note(self, message: EmcyMessage) -> None:
        """Add the error of `message`; remove errors whose register bits are now clear.

        An error without register bits, as from a device that leaves the register at 0, remains until an error reset.
        """
        register, code = message.error_register, message.error_code
        reset = message.is_reset
        present = {
            active_code: bits for active_code, bits in self._active.items() if bits & register or not (bits or reset)
        }
        if reset:
            self._possibly_cleared = set(present)  # CiA 301, 7.2.7: an error reset does not name the error
        else:
            # The bits that are new with this error belong to it. The error remains until all of them are clear.
            error_bits = present.pop(code, 0)
            bits = register & ~ErrorRegister.GENERIC
            new = bits & ~self.register
            if new or not error_bits or code in self._possibly_cleared:  # otherwise the same error was reported again
                error_bits |= new or bits or register
            self._possibly_cleared.discard(code)
            if len(present) >= self.active_limit:
                del present[next(iter(present))]
            present[code] = error_bits
        self._active, self.register = present, register
