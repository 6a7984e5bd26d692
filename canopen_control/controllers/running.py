"""The controllers that are active: their part of the cycle, their commands, and what they tell.

The law of the file: `update` and `broadcast` run over lists made at the last switch and never raise; whoever fails is
named in `failed`, for the manager to stop. A controller that another one commands runs after it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.controllers.base import ControllerEvent, is_moving
from canopen_control.controllers.chain import ends_of, in_order
from canopen_control.controllers.slots import Rate, Slot
from canopen_control.hardware.interfaces import OK

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.controllers.slots import Ends, Part
    from canopen_control.rpc.messages.samples import ControllerSample

__all__ = ["RunningControllers"]

_EVERY_CYCLE: Final = 0.99  # a period of the manager that differs by less is the cycle's

Failures = list[tuple["Controller", str]]
Samples = dict[str, "ControllerSample"]


class RunningControllers:
    """The active controllers in running order; `update_rate` in Hz is the most they run at, `cycle` in s the cycle's.

    What happens is added to `events`; `divide` parts what an independent controller moves into what stops together.
    """

    def __init__(self, update_rate: int, cycle: float, events: list[ControllerEvent]) -> None:
        self.update_rate = update_rate
        self.failed: Failures = []
        self.divide: Callable[[Ends], Sequence[Ends]] = lambda ends: (ends,)
        self.now = 0
        self._events = events
        every = 0 if update_rate * cycle >= _EVERY_CYCLE else update_rate
        self._period = max(cycle, 1.0 / update_rate)
        self._commanding_rate, self._telling_rate = Rate(every), Rate(every)
        self._order: list[Slot] = []
        self._commanding: list[Slot] = []
        self._telling: list[Slot] = []

    def arrange(self, controllers: Collection[Controller], active: Sequence[Controller]) -> None:
        """Have these of all `controllers` run from the next cycle on; those that did go on."""
        before = {slot.controller.name: slot for slot in self._order}
        were_enabled = {each for slot in self._order for part in slot.parts if part.enabled for each in part.ends}
        self._order = []
        for controller in in_order(active):
            rate = controller.update_rate if controller.update_rate < self.update_rate else 0
            ends = ends_of(controller, controllers)
            slot = Slot(controller, rate, self.divide(ends) if controller.independent else (ends,))
            if controller.name in before:
                slot.take_over(before[controller.name], were_enabled)
            self._order.append(slot)
        self._commanding = [slot for slot in self._order if not slot.only_tells]
        self._telling = [slot for slot in self._order if slot.only_tells]

    @property
    def controllers(self) -> tuple[Controller, ...]:
        """They, in the order they run."""
        return tuple(slot.controller for slot in self._order)

    def samples(self, wall_offset_ns: int) -> Samples:
        """Return what they have published last, by name; who cannot tell it has failed."""
        found: Samples = {}
        for controller in self.controllers:
            try:
                sample = controller.sample(wall_offset_ns)
            except Exception as error:  # noqa: BLE001 - no controller ends the robot, whatever it raises
                self._fail_once(controller, f"sample raised {type(error).__name__}: {error}")
                continue
            if sample is None:
                continue
            if type(sample) is controller.tells:
                found[controller.name] = sample
            else:
                self._fail_once(controller, f"sample returned {type(sample).__name__}, which is not what it `tells`")
        return found

    # --------------------------------------------------------------------------------------------------- the cycle

    def update(self, now: int, period: float) -> float:
        """Run those that command, if the manager is due in this cycle; `now` in ns, `period` of the cycle in s.

        Return the time since they last ran in s, negative if it is not due.
        """
        self.now = now
        for slot in self._commanding:
            for part in slot.parts:
                if part.follows() is not part.enabled:
                    self._power_changed(slot, part, now)
        rate = self._commanding_rate
        elapsed = rate.step(now, period) if rate.hz else period
        if elapsed >= 0.0:
            self._run(self._commanding, now, elapsed)
        return elapsed

    def broadcast(self, now: int, period: float) -> None:
        """Run those that only tell, once the commands of the cycle are on their way."""
        rate = self._telling_rate
        elapsed = rate.step(now, period) if rate.hz else period
        if elapsed >= 0.0:
            self._run(self._telling, now, elapsed)

    def _run(self, slots: Sequence[Slot], now: int, period: float) -> None:
        for slot in slots:
            elapsed = period if not slot.rate.hz else slot.rate.step(now, self._period)
            if elapsed < 0.0:
                continue
            try:
                result = slot.controller.update(now, elapsed)
            except Exception as error:  # noqa: BLE001 - no controller ends the cycle, whatever it raises
                self.failed.append((slot.controller, f"update raised {type(error).__name__}: {error}"))
                continue
            if result is not OK:
                self.failed.append((slot.controller, "update reported an error"))

    def _power_changed(self, slot: Slot, part: Part, now: int) -> None:
        """Forget a command in the cycle in which one of the drives that it moves is no longer enabled."""
        if part.enabled:
            off = [each for each in part.ends if not each.enabled]
            self._forget(slot, now, part.ends if len(slot.parts) > 1 else None, slot.controller.explain(off))
        part.enabled = not part.enabled

    # ------------------------------------------------------------------------------------------------ their commands

    @property
    def holders(self) -> set[object]:
        """With whom commands end that are in force."""
        return {slot.controller.life.holder for slot in self._commanding} - {None}

    def slot_of(self, controller: Controller) -> Slot | None:
        """Return the place of a controller, None if it is not active."""
        return next((slot for slot in self._order if slot.controller is controller), None)

    def let_go(self, holder: object, why: str = "is gone") -> None:
        """End the commands that a commander gave who is gone, unless somebody else has commanded since.

        `why` says of him what makes him count as gone.
        """
        for slot in self._commanding:
            controller = slot.controller
            if controller.life.holder is holder:
                source, moving = controller.life.source, is_moving(controller.commands)
                self._forget(slot, self.now, why=f"{source} {why}")
                if moving:
                    text = f"{controller.name}: {source} {why}, and its command with it; {controller.standing}"
                    self._events.append(ControllerEvent("commander_gone", controller.name, text))

    def set_aside(self, joints: Iterable[str], now: int) -> None:
        """Let joints that a user has taken out alone forget their commands, while the others of a controller go on."""
        names = frozenset(joints)
        for slot in self._commanding:
            ends = tuple(each for part in slot.parts for each in part.ends if each.joint in names)
            if ends and slot.controller.independent:
                for each in ends:
                    each.set_aside = True
                self._forget(slot, now, ends)

    def forget(self, now: int, why: str) -> None:
        """Let every one forget its command; `why` is a clause that says who or what takes it back."""
        for slot in self._commanding:
            self._forget(slot, now, why=why)

    def _forget(self, slot: Slot, now: int, some: Ends | None = None, why: str = "") -> None:
        try:
            slot.forget(now, some, why)
        except Exception as error:  # noqa: BLE001 - no controller ends the cycle, whatever it raises
            self.failed.append((slot.controller, f"forget raised {type(error).__name__}: {error}"))

    def _fail_once(self, controller: Controller, reason: str) -> None:
        if all(each is not controller for each, _ in self.failed):
            self.failed.append((controller, reason))
