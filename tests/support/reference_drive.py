"""A drive's power state machine written down from the diagram alone, sharing no table with the package.

States are the numbers that the statusword shows; every rule is spelled out, so that a mistake in the package's tables
cannot repeat itself here.
"""

from __future__ import annotations

NRSO, SOD, RTSO, SO, OE, QSA, FRA, FAULT = 0x00, 0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08


class ReferenceDrive:
    """`write` takes a controlword, `step` lets happen what happens by itself; `taken` lists transition numbers."""

    def __init__(self, quick_stop_option: int = 2, ramp_steps: int = 2, knows_16: bool = True) -> None:
        self.state = NRSO
        self.taken: list[int] = [0]
        self.quick_stop_option = quick_stop_option
        self.ramp_steps = ramp_steps
        self.knows_16 = knows_16
        self.cause_present = False
        self.mains = True
        self.remote = True
        self.reached = False
        self.noise = 0
        self.mode = 0
        self.last = 0
        self.left = 0
        self.after_ramp: tuple[int, int] | None = None

    @property
    def statusword(self) -> int:
        word = self.state | (0x0010 if self.mains else 0) | (0x0200 if self.remote else 0)
        if self.state in (SOD, FAULT, FRA):
            word |= 0x20 & self.noise
        return word | (0x0400 if self.reached else 0) | (self.noise & 0xF880)

    def go(self, number: int, state: int) -> None:
        self.taken.append(number)
        self.state = state
        self.after_ramp = None
        self.reached = False

    def ramp(self, number: int, state: int) -> None:
        if self.after_ramp is None:
            self.left, self.after_ramp = self.ramp_steps, (number, state)

    def fault(self) -> None:
        if self.state not in (FRA, FAULT):
            self.go(13, FRA)
            self.left = self.ramp_steps

    def lose_mains(self) -> None:
        self.mains = False
        if self.state in (RTSO, SO, OE, QSA):
            self.go({RTSO: 7, SO: 10, OE: 9, QSA: 12}[self.state], SOD)

    def step(self) -> None:
        if self.state == NRSO:
            self.go(1, SOD)
        elif self.left > 0 and (self.state in (FRA, QSA) or self.after_ramp):
            self.left -= 1
        elif self.state == FRA:
            self.go(14, FAULT)
        elif self.state == QSA:
            if self.quick_stop_option <= 4:
                self.go(12, SOD)
            else:
                self.reached = True
        elif self.after_ramp:
            self.go(*self.after_ramp)

    def write(self, word: int) -> None:
        before, self.last = self.last, word
        if self.state == FAULT:
            if word & 0x80 and not before & 0x80 and not self.cause_present:
                self.go(15, SOD)
            return
        if word & 0x80 or self.state in (NRSO, FRA):
            return
        if word & 0x02 == 0:
            self.disable_voltage()
        elif word & 0x04 == 0:
            self.quick_stop()
        elif word & 0x01 == 0:
            self.shutdown()
        elif word & 0x08 == 0:
            self.switch_on()
        else:
            self.enable_operation()

    def disable_voltage(self) -> None:
        if self.state in (RTSO, SO, OE, QSA):
            self.go({RTSO: 7, SO: 10, OE: 9, QSA: 12}[self.state], SOD)

    def quick_stop(self) -> None:
        if self.state in (RTSO, SO):
            self.go({RTSO: 7, SO: 10}[self.state], SOD)
        elif self.state == OE:
            self.go(11, QSA)
            self.left = self.ramp_steps

    def shutdown(self) -> None:
        if self.state == SOD and self.mains:
            self.go(2, RTSO)
        elif self.state == SO:
            self.go(6, RTSO)
        elif self.state == OE:
            self.ramp(8, RTSO)

    def switch_on(self) -> None:
        if self.state == RTSO:
            self.go(3, SO)
        elif self.state == OE:
            self.ramp(5, SO)

    def enable_operation(self) -> None:
        if self.state == SO:
            self.go(4, OE)
        elif self.state == QSA and self.quick_stop_option >= 5 and self.knows_16:
            self.go(16, OE)
        elif self.state == OE:
            self.after_ramp = None
