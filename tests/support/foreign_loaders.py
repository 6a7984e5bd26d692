"""Devices of other makers that take programs (CiA 302-3), by the rules of their public sources, in virtual time.

Each answers an object as the device does: bytes, None for no answer, or an abort code as a ProgramAbort.
"""

from __future__ import annotations

import zlib

DATA, CONTROL, IDENTIFICATION, FLASH = 0x1F50, 0x1F51, 0x1F56, 0x1F57
STATE, UNKNOWN, RANGE, WRITE_ONLY = 0x08000022, 0x06020000, 0x06090030, 0x06010001
STOP, START, CLEAR, CONFIRM = 0, 1, 3, 0x80
MS = 1_000_000


class ProgramAbort(Exception):
    """The abort code of an answer."""

    def __init__(self, code):
        super().__init__(f"0x{code:08X}")
        self.code = code


class ZephyrDevice:
    """An application with two slots: it takes programs itself, and runs a new one on trial until that is confirmed.

    0x1F51 is written in PRE-OPERATIONAL alone, a download wants a fresh clear, nothing is stopped or started on trial.
    """

    boot_ns, erase_ns = 300 * MS, 400 * MS

    def __init__(self):
        self.now, self.pre_operational, self.silent_until = 0, False, 0
        self.status, self.flash, self.busy_until = START, 0, 0
        self.running, self.permanent, self.slot = b"old", b"old", None
        self.boots = 0

    def wait(self, ns):
        self.now += ns

    def enter_pre_operational(self):
        self.pre_operational = self.now >= self.silent_until

    def boot(self):
        """Boot: a program on trial that was not confirmed is gone."""
        self.boots += 1
        self.silent_until = self.now + self.boot_ns
        self.pre_operational = False
        if self.status == START and self.slot is not None:
            self.running, self.slot, self.status = self.slot, None, CONFIRM
        else:
            self.running, self.status = self.permanent, START

    def read(self, index):
        if self.now < self.silent_until:
            return None
        if index == CONTROL:
            return bytes((self.status,))
        if index == IDENTIFICATION:
            return zlib.crc32(self.running if self.slot is None else self.slot).to_bytes(4, "little")
        if index == FLASH:
            return (1 if self.now < self.busy_until else self.flash).to_bytes(4, "little")
        raise ProgramAbort(WRITE_ONLY if index == DATA else UNKNOWN)

    def write(self, index, data):
        if self.now < self.silent_until:
            return None
        if index == DATA:
            if self.status != CLEAR or self.slot is not None:
                self.flash = 8
                raise ProgramAbort(STATE)
            self.slot, self.busy_until = data, self.now + 50 * MS
            return b""
        if not self.pre_operational:
            raise ProgramAbort(STATE)
        return self._command(data[0])

    def _command(self, command):
        on_trial = self.status == CONFIRM
        if command == CONFIRM and on_trial:
            self.permanent, self.status = self.running, START
        elif on_trial or (command == CLEAR and self.status != STOP):
            raise ProgramAbort(STATE)
        elif command == STOP:
            self.status = STOP
        elif command == CLEAR:
            self.slot, self.flash, self.status = None, 0, CLEAR
            self.busy_until = self.now + self.erase_ns
        elif command == START:
            self.status = START
            self.boot()
            return None  # the process has ended before the answer was sent
        else:
            raise ProgramAbort(RANGE)
        return b""


class WaitingLoader:
    """A loader beside a CANopenNode application: a reset waits for an SDO for half a second, else the program starts.

    It has one slot, 0x1F50 and 0x1F51 alone, and tells nothing of its flash.
    """

    boot_ns, waits_ns = 200 * MS, 500 * MS

    def __init__(self, program=b"old"):
        self.now, self.silent_until, self.starts_at = 0, 0, None
        self.program, self.loading, self.cleared, self.boots = program, False, False, 0

    def wait(self, ns):
        self.now += ns
        if self.starts_at is not None and self.now >= self.starts_at:
            self.starts_at = None
            self.loading = not self.program

    def enter_pre_operational(self):
        pass

    def boot(self):
        self.boots += 1
        self.loading, self.cleared = True, False
        self.silent_until = self.now + self.boot_ns
        self.starts_at = self.silent_until + self.waits_ns

    def read(self, index):
        if self.now < self.silent_until:
            return None
        self.starts_at = None
        if index == CONTROL:
            return bytes((CLEAR if self.cleared else STOP if self.loading else START,))
        raise ProgramAbort(UNKNOWN)

    def write(self, index, data):
        if self.now < self.silent_until:
            return None
        self.starts_at = None
        if index == DATA:
            if not self.cleared:
                raise ProgramAbort(STATE)
            self.program, self.cleared = data, False
            return b""
        if data == b"\0" and not self.loading:
            self.boot()
            return None
        if data == b"\3" and self.loading:
            self.program, self.cleared = b"", True
        elif data == b"\1" and self.program:
            self.boot()
            self.starts_at = self.silent_until
            return None
        return b""
