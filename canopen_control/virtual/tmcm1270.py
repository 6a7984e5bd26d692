"""The device model of the TMCM-1270 (PD42-x-1270), a stepper drive of Trinamic for CANopen.

It does what its EDS and the public manuals of its family say, and nothing else. Positions are microsteps, velocities
pps (microsteps per second), accelerations pps per second. Velocity, accelerations and the quick-stop ramp have no
usable default: until they are written, nothing moves. In profile velocity 0x6083 decelerates too. Bits 5 and 9 of the
controlword do nothing in profile position, where bit 12 shows a set-point under way. In CSP it goes to the target
within 0x60C2 and stands there until the next one comes. Bit 14 of the statusword is set while it moves, bit 15 is the
direction. Homing method 35 needs no power. There is no 0x6007: what a lost heartbeat does is 0x1029:01, whose default
goes to PRE-OPERATIONAL and lets the motor turn on; NMT STOPPED in operation is a fault. Bit 30 of its TPDOs' COB-IDs is
set by default and may be cleared: `cob_id: auto` of ros2_canopen does that to real drives.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from canopen_control.virtual.device_model import DeviceModel, Limit, MissingSetPoint

if TYPE_CHECKING:
    from canopen_control.od.model import ObjectDictionary
    from canopen_control.virtual.object_store import ObjectStore

__all__ = ["IDENTITY", "TMCM1270", "is_tmcm1270"]

IDENTITY = (0x286, 0x4F6)  # 0x1018:01 and :02
_MICROSTEPS, _FULL_STEPS, _SWITCHES, _ENABLE_DELAY = 0x2000, 0x2001, 0x2005, 0x200A
_BOTH_DISABLED = 3
_MOVING, _NEGATIVE = 1 << 14, 1 << 15


def is_tmcm1270(od: ObjectDictionary) -> bool:
    """Whether the dictionary is this drive's, by vendor id and product code."""
    entries = (od.get(0x1018, 1), od.get(0x1018, 2))
    return tuple(None if entry is None else entry.value for entry in entries) == IDENTITY


def _velocity_bits(velocity: float) -> int:
    return (_MOVING if abs(velocity) >= 0.5 else 0) | (_NEGATIVE if velocity < 0.0 else 0)


def _switches_disabled(store: ObjectStore) -> bool:
    return store.number(_SWITCHES) & _BOTH_DISABLED == _BOTH_DISABLED


def _microsteps(store: ObjectStore) -> int:
    return store.number(_MICROSTEPS)


TMCM1270 = DeviceModel(
    name="TMCM-1270",
    unset_ramp=0.0,
    unset_velocity=0.0,
    velocity_ramp_both_ways=True,
    ramps_positions=True,
    single_set_point=True,
    homing_methods=frozenset((0, 17, 18, 19, 21, 35)),
    homing_halts=False,
    homes_without_power=True,
    counts_per_revolution=51_200,
    delays=MappingProxyType({4: _ENABLE_DELAY}),
    communication_data=bytes.fromhex("00FF000000"),
    missing=MissingSetPoint(),
    recovers_sync=False,
    rpdo_error=(0x6320, bytes.fromhex("00FF000000")),
    software_limit=Limit(0xFF01, b"\x01", b"\x02"),
    switch_limit=Limit(0xFF01, b"\x04", b"\x03"),
    switches_disabled=_switches_disabled,
    velocity_bits=_velocity_bits,
    identity=MappingProxyType(
        {
            (0x1008, 0): "TMCM-1270",
            (0x1009, 0): "virtual",
            (0x100A, 0): "3.26",
            (0x1018, 3): 0x0003001A,
            (_MICROSTEPS, 0): 8,
            (0x2003, 0): 128,
            (0x2004, 0): 8,
            (0x2704, 0): 1000,
            (0x2707, 0): 1000,
        }
    ),
    display=MappingProxyType({(0x2107, 0): _microsteps}),
)
