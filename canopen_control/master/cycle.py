"""Process data of a bus: PDOs, compiled once and exchanged in every cycle.

Directions are from the device's view: a TPDO is received here, an RPDO is sent. During operation no object is looked up
by index, a received frame costs one dictionary look-up and one unpack, and an object mapped into several RPDOs (such as
the controlword of most drives) has the same value in all of them. An RPDO that moves an axis is sent automatically, at
every SYNC or periodically; any other RPDO, such as that of an I/O module, is sent only after a value was written.
"""

from __future__ import annotations

import struct
import sys
from typing import TYPE_CHECKING, Any, Final

from canopen_control.cia301.pdo import MAX_BITS, MappedObject, PdoCodec
from canopen_control.cia402.objects import CONTROLWORD, STATUSWORD
from canopen_control.cia402.state import HALT_BIT
from canopen_control.frame import RECORD

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.cia402.motors import MotorMap
    from canopen_control.master.plan_builder import PlannedPdo
    from canopen_control.od.model import Value


_HEAD: Final = "<IB3x"  # head of a record, see `canopen_control.frame`
_NEVER: Final = -1
_NO_END: Final = (1 << 62) - 1
MISSED_SYNCS = 3  # default number of SYNCs without a TPDO after which its values are stale
CYCLIC_SYNCHRONOUS = range(1, 241)  # transmission types of PDOs exchanged at SYNCs (CiA 301, 7.5.2.35)


class ReceivedPdo:
    """TPDO of a node, with the last received values, their time `stamp`, and frame counters.

    `values` are the raw numbers in mapping order, initially zeros; `stamp` is -1 before the first frame. `every` is the
    number of SYNCs per transmission, 0 for an event-driven TPDO. While `expected` is set, `supervision.PdoWatch` counts
    SYNCs without a frame in `silent`, from the time `since` on, and sets `overdue` after `allowed_silence` SYNCs.
    `age_limit_ns` is the maximum age of values with an event timer, 0 without a limit; `timer_silence` is this time in
    SYNCs (or cycles of a bus without SYNC) if the TPDO is supervised by its timer, else 0.
    """

    __slots__ = (
        "age_limit_ns",
        "allowed_silence",
        "checked",
        "cob_id",
        "codec",
        "count",
        "every",
        "expected",
        "length",
        "long",
        "missed",
        "overdue",
        "reported_lengths",
        "short",
        "silent",
        "since",
        "stamp",
        "timer_silence",
        "unpack",
        "values",
    )

    def __init__(self, cob_id: int, objects: Sequence[MappedObject], transmission_type: int = 255) -> None:
        self.cob_id = cob_id
        self.codec = PdoCodec(objects)
        compiled = self.codec.struct
        self.unpack: Callable[[bytes], tuple[Value, ...]] = (
            self.codec.unpack if compiled is None else compiled.unpack_from
        )
        self.length = self.codec.length
        self.every = transmission_type if transmission_type in CYCLIC_SYNCHRONOUS else 0
        self.age_limit_ns = self.timer_silence = 0
        self.allow(MISSED_SYNCS)
        self.expected = self.overdue = False
        self.reported_lengths = 0  # a bit for each wrong length already reported
        self.checked = self.silent = self.since = 0
        self.values: tuple[Value, ...] = (0,) * len(objects)
        self.stamp = _NEVER
        self.count = self.short = self.long = 0

    def receive(self, data: bytes, length: int, now: int) -> None:
        """Decode a received frame; `data` has eight bytes, `length` of which were received.

        A frame that is too short only increments a counter.
        """
        if length != self.length:
            # CiA 301, 7.2.2.5: a short PDO is not processed; of a long one the first bytes are used
            if length < self.length:
                self.short += 1
                return
            self.long += 1
        self.values = self.unpack(data)
        self.stamp = now
        self.count += 1

    def use(self, layout: PlannedPdo, planned: Sequence[MappedObject]) -> None:
        """Adopt the COB-ID and mapping that the node has kept; `layout` must contain the `planned` objects.

        `values` remain in the order of the `planned` objects.
        """
        self.cob_id, self.codec = layout.cob_id, PdoCodec(layout.objects)
        self.length = self.codec.length
        self.every = layout.transmission_type if layout.transmission_type in CYCLIC_SYNCHRONOUS else 0
        self.timer_silence = 0  # the node may have refused the event timer too
        self.allow(self.missed)
        unpack = self.codec.unpack if self.codec.struct is None else self.codec.struct.unpack_from
        addresses = [mapped[:2] for mapped in layout.objects]
        order = [addresses.index(mapped[:2]) for mapped in planned]
        if order == list(range(len(addresses))):
            self.unpack = unpack
        else:
            self.unpack = lambda data: tuple([values[position] for values in (unpack(data),) for position in order])

    def allow(self, missed: int) -> None:
        """Set the number of consecutive missing frames after which the TPDO is overdue."""
        self.missed = missed
        self.allowed_silence = missed * self.every if self.every else self.timer_silence or _NO_END

    def supervise_timer(self, period_ns: int) -> None:
        """Supervise an event-driven TPDO by its event timer, which is counted in SYNCs of this period."""
        # CiA 301, 7.5.2.37: an event-driven TPDO is sent at the latest when its event timer has elapsed
        self.timer_silence = max(self.missed, -(-self.age_limit_ns // period_ns)) if not self.every else 0
        self.allow(self.missed)

    def preset(self, position: int, value: Value) -> None:
        """Set the initial value of an object, which is valid until the first frame."""
        self.values = (*self.values[:position], value, *self.values[position + 1 :])

    def forget(self) -> None:
        """Invalidate the received values when the node is lost or has restarted."""
        self.stamp = _NEVER
        self.expected = self.overdue = False
        self.silent = 0


class Input:
    """Object in a TPDO; `value` is the raw number in the last received frame."""

    __slots__ = ("pdo", "position")

    def __init__(self, pdo: ReceivedPdo, position: int) -> None:
        self.pdo, self.position = pdo, position

    @property
    def value(self) -> int:
        """Raw number; before the first frame the initial value, 0 by default."""
        return self.pdo.values[self.position]  # type: ignore[return-value]  # mapped drive objects are integers

    @property
    def fresh(self) -> bool:
        """Whether a frame has been received since the node booted."""
        return self.pdo.stamp >= 0

    def age_ns(self, now: int) -> int | None:
        """Return the age of the value in ns, or None if no frame has been received since the node booted."""
        return now - self.pdo.stamp if self.pdo.stamp >= 0 else None


class Output:
    """Object in one or more RPDOs; `places` are these RPDOs, with the object's position in each.

    `driven` is set if the object moves an axis.
    """

    __slots__ = ("driven", "places", "value")

    def __init__(self) -> None:
        self.value: Any = 0  # usually an integer, and always for objects that move an axis
        self.driven = False
        self.places: list[tuple[SentPdo, int]] = []

    def drive(self) -> None:
        """Mark the object as moving an axis, so that its RPDOs are sent automatically."""
        self.driven = True
        for pdo, _ in self.places:
            pdo.repeated = pdo.changed = True

    def set(self, value: int) -> None:
        """Set the raw number for the next frames; if it differs, mark the RPDOs as changed."""
        if value != self.value:
            self.value = value
            for pdo, position in self.places:
                pdo.values[position] = value
                pdo.changed = True

    def write(self, value: Value) -> None:
        """Set the value for the next frames, and send the RPDOs even if the value is unchanged."""
        self.record(value)
        for pdo, _ in self.places:
            pdo.changed = True

    def record(self, value: Value) -> None:
        """Store a value that the node already has; only those of its RPDOs that move an axis are sent."""
        self.value = value
        for pdo, position in self.places:
            pdo.values[position] = value
            pdo.changed = pdo.changed or pdo.repeated


_ECHOES: Final = 16  # frames with other values that are recognised as those of this master


class SentPdo:
    """RPDO of a node, with its packed frame `record`; sent only while `enabled`.

    `values` are the raw numbers in mapping order, which the outputs set. `repeated` is set if the RPDO is sent
    automatically. `refresh` is the number of cycles after which an unchanged RPDO is repeated because the node
    supervises its reception, 0 if it does not.
    """

    __slots__ = (
        "_packer",
        "_previous",
        "_previous_at",
        "changed",
        "cob_id",
        "codec",
        "count",
        "cyclic",
        "enabled",
        "outputs",
        "record",
        "refresh",
        "repeated",
        "sent_in",
        "values",
    )

    def __init__(
        self, cob_id: int, objects: Sequence[MappedObject], outputs: Sequence[Output], *, cyclic: bool
    ) -> None:
        self.cob_id, self.cyclic = cob_id, cyclic
        self.codec = PdoCodec(objects)
        self.record = RECORD.pack(cob_id, self.codec.length, b"")
        self._previous, self._previous_at = [self.record] * _ECHOES, 0
        self._packer = _packer(self.codec)
        self.enabled, self.count = False, 0
        self.refresh = 0
        self.sent_in = 0  # cycle of the last transmission
        self._set_outputs(outputs)

    def use(self, layout: PlannedPdo, outputs: Sequence[Output]) -> None:
        """Adopt the COB-ID and mapping that the node has kept; `outputs` are the mapped objects."""
        for output in self.outputs:
            output.places = [place for place in output.places if place[0] is not self]
        self.cob_id, self.codec = layout.cob_id, PdoCodec(layout.objects)
        self._packer = _packer(self.codec)
        self.cyclic = layout.transmission_type in CYCLIC_SYNCHRONOUS
        self._set_outputs(outputs)

    def _set_outputs(self, outputs: Sequence[Output]) -> None:
        self.outputs = outputs
        self.repeated = self.changed = any(output.driven for output in outputs)
        self.values: list[Value] = [output.value for output in outputs]
        for position, output in enumerate(outputs):
            output.places.append((self, position))

    def start(self) -> None:
        """Enable the RPDO when the node becomes OPERATIONAL; an RPDO that moves an axis is sent in the next cycle."""
        self.enabled, self.changed = True, self.repeated

    def was_sent(self, data: bytes) -> bool:
        """Whether one of the last frames had these data: an adapter may echo them some cycles later."""
        record = RECORD.pack(self.cob_id, len(data), data)
        return record == self.record or record in self._previous

    def pack(self) -> None:
        """Pack the values into the record.

        Raise LocalProtocolError, with the record unchanged, if a value does not fit.
        """
        packer, codec = self._packer, self.codec
        self._previous[self._previous_at] = self.record
        self._previous_at = (self._previous_at + 1) % _ECHOES
        if packer is None:
            self.record = RECORD.pack(self.cob_id, codec.length, codec.pack(self.values))
        else:
            try:
                self.record = packer(self.cob_id, codec.length, *self.values)
            except (struct.error, OverflowError):
                codec.pack(self.values)  # raises an error that names the object
                raise
        self.changed = False


def _packer(codec: PdoCodec) -> Callable[..., bytes] | None:
    """Return a function that packs a whole record at once, or None if the mapping does not permit that.

    Records have the host's byte order, values are little-endian; a mapping with objects that are not whole bytes cannot
    be packed this way.
    """
    if codec.struct is None or sys.byteorder != "little":
        return None
    return struct.Struct(f"{_HEAD}{codec.struct.format[1:]}{MAX_BITS // 8 - codec.length}x").pack


class ProcessImage:
    """Process image of a bus: the objects in the PDOs of all nodes, with their values.

    `inputs` maps the COB-ID of a TPDO to its `ReceivedPdo`; `refresh` is the number of cycles after which an unchanged
    RPDO that moves an axis is repeated, in case a frame was lost.
    """

    def __init__(self, refresh: int = 5) -> None:
        self.refresh = refresh
        self.inputs: dict[int, ReceivedPdo] = {}
        self.outputs: list[SentPdo] = []
        self._inputs: dict[tuple[int, int, int], Input] = {}
        self._outputs: dict[tuple[int, int, int], Output] = {}
        self._of_axes: dict[tuple[int, int, int], Output] = {}  # replace an output that several axes share
        self._records: list[bytes] = []
        self._cycle = 0

    def add_tpdo(
        self, node_id: int, cob_id: int, objects: Sequence[MappedObject], transmission_type: int = 255
    ) -> ReceivedPdo:
        """Add a TPDO of a node; an object in several TPDOs is read from the first one added."""
        pdo = ReceivedPdo(cob_id, objects, transmission_type)
        self.inputs[cob_id] = pdo
        for position, mapped in enumerate(objects):
            self._inputs.setdefault((node_id, mapped.index, mapped.subindex), Input(pdo, position))
        return pdo

    def add_rpdo(
        self,
        node_id: int,
        cob_id: int,
        objects: Sequence[MappedObject],
        transmission_type: int = 255,
        *,
        deadline: int = 0,
    ) -> SentPdo:
        """Add an RPDO of a node; an object in several RPDOs has the same value in all of them.

        `deadline` is the number of cycles without the RPDO after which the node sends EMCY 0x8250, 0 for never. The
        RPDO is repeated in half that time, so that neither a late cycle nor one lost frame causes the error.
        """
        outputs = self.outputs_of(node_id, objects)
        pdo = SentPdo(cob_id, objects, outputs, cyclic=transmission_type in CYCLIC_SYNCHRONOUS)
        pdo.refresh = max(1, min(self.refresh, deadline // 2)) if deadline else 0
        self.outputs.append(pdo)
        return pdo

    def outputs_of(self, node_id: int, objects: Sequence[MappedObject]) -> list[Output]:
        """Return the outputs for objects of a node; missing ones are created."""
        return [self._outputs.setdefault((node_id, mapped.index, mapped.subindex), Output()) for mapped in objects]

    def preset(self, node_id: int, values: Mapping[tuple[int, int], Value]) -> None:
        """Set initial values of a node's process data, by (index, subindex)."""
        for (index, subindex), value in values.items():
            if (output := self._outputs.get((node_id, index, subindex))) is not None:
                output.record(value)
            if (present := self._inputs.get((node_id, index, subindex))) is not None:
                present.pdo.preset(present.position, value)

    def input(self, node_id: int, index: int, subindex: int = 0) -> Input | None:
        """Return the input of an object, or None if no TPDO maps it."""
        return self._inputs.get((node_id, index, subindex))

    def output(self, node_id: int, index: int, subindex: int = 0) -> Output | None:
        """Return the output of an object, or None if no RPDO maps it."""
        return self._of_axes.get((node_id, index, subindex)) or self._outputs.get((node_id, index, subindex))

    def share(self, node_id: int, address: tuple[int, int], copy: tuple[int, int]) -> None:
        """Use the input and output of the object at `address` for `copy` too; no effect if no PDO maps the object."""
        if (present := self._inputs.get((node_id, *address))) is not None:
            self._inputs[node_id, *copy] = present
        if (output := self._outputs.get((node_id, *address))) is not None:
            self._outputs[node_id, *copy] = output

    def put_before(self, node_id: int, index: int, output: Output) -> None:
        """Make `output()` return the given output for object `index`; RPDOs are unchanged."""
        self._of_axes[node_id, index, 0] = output

    def collect(self, sync: bytes = b"") -> bytes:
        """Collect the frame records of one cycle: the RPDOs that are due, then the record `sync`."""
        records, cycle = self._records, self._cycle + 1
        self._cycle, idle_since = cycle, cycle - self.refresh
        records.clear()
        for pdo in self.outputs:
            if pdo.changed:
                if not pdo.enabled:
                    continue
                pdo.pack()
            elif not pdo.enabled or not (
                (pdo.repeated and (pdo.cyclic or pdo.sent_in <= idle_since))
                or (pdo.refresh and pdo.count and pdo.sent_in <= cycle - pdo.refresh)
            ):
                continue
            pdo.sent_in = cycle
            pdo.count += 1
            records.append(pdo.record)
        if not records:
            return sync
        records.append(sync)
        return b"".join(records)


# Process data of objects that the motors of one device share, presented as separate objects per axis (`cia402.motors`).
#
# The controlword of the device is combined from those of its axes: an enabling bit is set if all axes set it, halt and
# fault reset are set if any axis sets them. So all axes are enabled together, and a stop of one axis stops all. An axis
# in a fault reacts only to a fault reset, and its enabling bits are ignored, so that the other axes can still be
# stopped in a controlled way.


_ANY: Final = HALT_BIT | 0x80  # bits that are set if any axis sets them: halt, fault reset
_FAULT_MASK: Final = 0x4F
_FAULTS: Final = (0x08, 0x0F)  # masked statuswords: FAULT, FAULT REACTION ACTIVE (CiA 402-2, table 30)


class AxisControlword(Output):
    """Controlword of one axis; `whole` is the controlword of the device, `axes` the controlwords of all its axes."""

    __slots__ = ("axes", "statusword", "whole")

    def __init__(self, whole: Output, statusword: Input | None, axes: list[AxisControlword]) -> None:
        super().__init__()
        self.whole, self.statusword, self.axes = whole, statusword, axes
        axes.append(self)

    @property
    def counts(self) -> bool:
        """Whether the enabling bits of the axis are used; they are ignored while the axis is in a fault."""
        status = self.statusword
        return status is None or not status.fresh or status.value & _FAULT_MASK not in _FAULTS

    def drive(self) -> None:
        """Mark the controlword as moving an axis, so that the RPDOs with the device's controlword are sent."""
        self.driven = True
        self.whole.drive()

    def set(self, value: int) -> None:
        """Set the controlword of this axis, and the combined controlword of the device."""
        self.value = value
        self.whole.set(combined(self.axes))


def combined(axes: Sequence[AxisControlword]) -> int:
    """Return the controlword of a device, combined from the controlwords of the axes that joints use."""
    every, some = 0xFFFF, 0
    for axis in axes:
        if axis.driven:  # used by a joint
            some |= axis.value
            if axis.counts:
                every &= axis.value
    return (0 if every == 0xFFFF else every & ~_ANY) | some & _ANY


def share_objects(image: ProcessImage, node_id: int, motors: MotorMap) -> None:
    """Add the objects that a node's axes share to `image`, once per axis; the node's PDOs must already be there."""
    for address, copies in motors.shared.items():
        for copy in copies:
            image.share(node_id, address, copy)
    whole = image.output(node_id, CONTROLWORD)
    if whole is None:
        return
    axes: list[AxisControlword] = []
    for index, _ in ((CONTROLWORD, 0), *motors.shared[CONTROLWORD, 0]):
        statusword = image.input(node_id, STATUSWORD + index - CONTROLWORD)
        image.put_before(node_id, index, AxisControlword(whole, statusword, axes))
