"""Objects of CiA 402-2 by name, their indices for each axis of a multi-axis device, and the option codes.

Indices are for axis 0. Axis a (0 to 7) has the same profile objects 0x800 * a higher, and its PDOs 64 * a higher (CiA
402-2, 5.1; CiA 301, 7.4.1). Objects outside 0x6000 to 0x67FF belong to the device and are the same for all axes.
"""

from __future__ import annotations

from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.cia402.state import Command, State
from canopen_control.od.indices import ERROR_BEHAVIOUR
from canopen_control.od.model import AXIS_STEP
from canopen_control.od.model import PROFILE_START as _FIRST

if TYPE_CHECKING:
    from collections.abc import Container, Mapping


AXES = 8
_LAST = _FIRST + AXIS_STEP - 1
_DRIVE_PROFILE = 402

ABORT_CONNECTION_OPTION = 0x6007
ERROR_CODE = 0x603F
CONTROLWORD = 0x6040
STATUSWORD = 0x6041
VL_TARGET_VELOCITY = 0x6042
VL_VELOCITY_DEMAND = 0x6043
VL_VELOCITY_ACTUAL = 0x6044
VL_MIN_MAX_AMOUNT = 0x6046
VL_ACCELERATION = 0x6048
VL_DECELERATION = 0x6049
VL_QUICK_STOP = 0x604A
QUICK_STOP_OPTION = 0x605A
SHUTDOWN_OPTION = 0x605B
DISABLE_OPERATION_OPTION = 0x605C
HALT_OPTION = 0x605D
FAULT_REACTION_OPTION = 0x605E
MODES_OF_OPERATION = 0x6060
MODES_OF_OPERATION_DISPLAY = 0x6061
POSITION_DEMAND = 0x6062
POSITION_ACTUAL_INTERNAL = 0x6063
POSITION_ACTUAL = 0x6064
FOLLOWING_ERROR_WINDOW = 0x6065
FOLLOWING_ERROR_TIMEOUT = 0x6066
POSITION_WINDOW = 0x6067
POSITION_WINDOW_TIME = 0x6068
VELOCITY_SENSOR_ACTUAL = 0x6069
SENSOR_SELECTION = 0x606A
VELOCITY_DEMAND = 0x606B
VELOCITY_ACTUAL = 0x606C
VELOCITY_WINDOW = 0x606D
VELOCITY_WINDOW_TIME = 0x606E
VELOCITY_THRESHOLD = 0x606F
VELOCITY_THRESHOLD_TIME = 0x6070
TARGET_TORQUE = 0x6071
MAX_TORQUE = 0x6072
MAX_CURRENT = 0x6073
TORQUE_DEMAND = 0x6074
MOTOR_RATED_CURRENT = 0x6075
MOTOR_RATED_TORQUE = 0x6076
TORQUE_ACTUAL = 0x6077
CURRENT_ACTUAL = 0x6078
DC_LINK_VOLTAGE = 0x6079
TARGET_POSITION = 0x607A
POSITION_RANGE_LIMIT = 0x607B
HOME_OFFSET = 0x607C
SOFTWARE_POSITION_LIMIT = 0x607D
POLARITY = 0x607E
MAX_PROFILE_VELOCITY = 0x607F
MAX_MOTOR_SPEED = 0x6080
PROFILE_VELOCITY = 0x6081
END_VELOCITY = 0x6082
PROFILE_ACCELERATION = 0x6083
PROFILE_DECELERATION = 0x6084
QUICK_STOP_DECELERATION = 0x6085
MOTION_PROFILE_TYPE = 0x6086
TORQUE_SLOPE = 0x6087
TORQUE_PROFILE_TYPE = 0x6088
POSITION_ENCODER_RESOLUTION = 0x608F
VELOCITY_ENCODER_RESOLUTION = 0x6090
GEAR_RATIO = 0x6091
FEED_CONSTANT = 0x6092
VELOCITY_FACTOR = 0x6096
ACCELERATION_FACTOR = 0x6097
HOMING_METHOD = 0x6098
HOMING_SPEEDS = 0x6099
HOMING_ACCELERATION = 0x609A
PROFILE_JERK = 0x60A4
SI_UNIT_POSITION = 0x60A8
SI_UNIT_VELOCITY = 0x60A9
POSITION_OFFSET = 0x60B0
VELOCITY_OFFSET = 0x60B1
TORQUE_OFFSET = 0x60B2
TOUCH_PROBE_FUNCTION = 0x60B8
TOUCH_PROBE_STATUS = 0x60B9
TOUCH_PROBE_1_POSITIVE = 0x60BA
TOUCH_PROBE_1_NEGATIVE = 0x60BB
TOUCH_PROBE_2_POSITIVE = 0x60BC
TOUCH_PROBE_2_NEGATIVE = 0x60BD
INTERPOLATION_SUB_MODE = 0x60C0
INTERPOLATION_DATA = 0x60C1
INTERPOLATION_TIME_PERIOD = 0x60C2
INTERPOLATION_BUFFER = 0x60C4
MAX_ACCELERATION = 0x60C5
MAX_DECELERATION = 0x60C6
POSITIVE_TORQUE_LIMIT = 0x60E0
NEGATIVE_TORQUE_LIMIT = 0x60E1
SUPPORTED_HOMING_METHODS = 0x60E3
ADDITIONAL_POSITION_ACTUAL = 0x60E4
ADDITIONAL_VELOCITY_ACTUAL = 0x60E5
POSITIONING_OPTION = 0x60F2
FOLLOWING_ERROR_ACTUAL = 0x60F4
MAX_SLIPPAGE = 0x60F8
VELOCITY_CONTROL_PARAMETERS = 0x60F9
CONTROL_EFFORT = 0x60FA
POSITION_CONTROL_PARAMETERS = 0x60FB
POSITION_DEMAND_INTERNAL = 0x60FC
DIGITAL_INPUTS = 0x60FD
DIGITAL_OUTPUTS = 0x60FE
TARGET_VELOCITY = 0x60FF
MOTOR_TYPE = 0x6402
MOTOR_CATALOGUE_NUMBER = 0x6403
MOTOR_MANUFACTURER = 0x6404
SUPPORTED_DRIVE_MODES = 0x6502
DRIVE_CATALOGUE_NUMBER = 0x6503
DRIVE_MANUFACTURER = 0x6505
SINGLE_DEVICE_TYPE = 0x67FF

NAMES: Mapping[int, str] = MappingProxyType(
    {
        value: name.replace("_", " ").lower()
        for name, value in list(globals().items())
        if isinstance(value, int) and _FIRST <= value <= _LAST and not name.startswith("_")
    }
)
"""Names of all profile objects above, by index on axis 0."""

MOTION = frozenset(
    (
        CONTROLWORD,
        MODES_OF_OPERATION,
        TARGET_POSITION,
        TARGET_VELOCITY,
        TARGET_TORQUE,
        VL_TARGET_VELOCITY,
        INTERPOLATION_DATA,
        VELOCITY_OFFSET,
        TORQUE_OFFSET,
    )
)
"""Objects that can move an axis."""


def axis_index(index: int, axis: int) -> int:
    """Return the index for `axis` of a profile object given by its index on axis 0; other indices are unchanged.

    Raise ValueError unless `axis` is 0 to 7.
    """
    # CiA 402-2, 5.1: up to eight axes, whose objects are 0x800 apart
    if not 0 <= axis < AXES:
        raise ValueError(f"axis {axis} does not exist: a device has the axes 0 to {AXES - 1}")
    return index + AXIS_STEP * axis if _FIRST <= index <= _LAST else index


def axis_of(index: int) -> tuple[int, int]:
    """Return the index on axis 0 and the axis of a profile object (0x6000 to 0x9FFF), else (index, 0)."""
    if not _FIRST <= index < _FIRST + AXES * AXIS_STEP:
        return index, 0
    axis = (index - _FIRST) // AXIS_STEP
    return index - AXIS_STEP * axis, axis


def axis_count(indices: Container[int]) -> int:
    """Return the number of axes, derived from the indices of a device's objects.

    An axis exists if this axis and all lower axes have a controlword.
    """
    present = (axis_index(CONTROLWORD, axis) in indices for axis in range(AXES))
    return next((axis for axis, is_present in enumerate(present) if not is_present), AXES)


def object_name(index: int) -> str | None:
    """Return the name of a profile object, with the axis number unless it is 0; None for other objects."""
    base, axis = axis_of(index)
    name = NAMES.get(base)
    return f"{name} (axis {axis})" if name and axis else name


def has_loss_reaction(addresses: Container[tuple[int, int]], offset: int = 0) -> bool:
    """Whether an object of the drive defines the reaction of the axis at `offset` to the loss of the master.

    Both objects are optional (CiA 402-2, 0x6007, and CiA 301, 7.5.2.32: 0x1029:01 of the whole node); without them the
    reaction is the manufacturer's.
    """
    return (ABORT_CONNECTION_OPTION + offset, 0) in addresses or (ERROR_BEHAVIOUR, 1) in addresses


def is_drive_profile(device_type: int) -> bool:
    """Whether the device profile in 0x1000 is CiA 402 (bits 0 to 15)."""
    # CiA 301, 7.5.2.1: bits 0 to 15 of 0x1000 are the number of the device profile
    return device_type & 0xFFFF == _DRIVE_PROFILE


# Option codes 0x605A to 0x605E and 0x6007: how a drive stops, and the state in which it is afterwards.
#
# Each code is a row of a table (CiA 402-2, 6.3.5 and 6.2.5). Negative codes are manufacturer-specific, and a code
# without a row is reserved; `DEFAULTS` has the default values. The master never infers the state of a drive from an
# option code: it reads the statusword. Virtual drives and explanations of values use these tables.


class Reaction(Enum):
    """Way in which a drive stops its motor; each value is a description in words."""

    DISABLE = "drive function off, the motor coasts"
    SLOW_DOWN_RAMP = "slow-down ramp"
    QUICK_STOP_RAMP = "quick-stop ramp"
    CURRENT_LIMIT = "at the current limit"
    VOLTAGE_LIMIT = "at the voltage limit"


class Option(NamedTuple):
    """Meaning of an option code: how the drive stops its motor, and the state at standstill."""

    reaction: Reaction
    final_state: State


_RAMPS = (Reaction.SLOW_DOWN_RAMP, Reaction.QUICK_STOP_RAMP, Reaction.CURRENT_LIMIT, Reaction.VOLTAGE_LIMIT)


def _ramps(first: int, final_state: State) -> dict[int, Option]:
    return {code: Option(reaction, final_state) for code, reaction in enumerate(_RAMPS, first)}


def _two(final_state: State) -> dict[int, Option]:
    return {0: Option(Reaction.DISABLE, final_state), 1: Option(Reaction.SLOW_DOWN_RAMP, final_state)}


OPTION_CODES: Mapping[int, Mapping[int, Option]] = MappingProxyType(
    {
        QUICK_STOP_OPTION: {
            0: Option(Reaction.DISABLE, State.SWITCH_ON_DISABLED),
            **_ramps(1, State.SWITCH_ON_DISABLED),
            **_ramps(5, State.QUICK_STOP_ACTIVE),
        },
        SHUTDOWN_OPTION: _two(State.READY_TO_SWITCH_ON),
        DISABLE_OPERATION_OPTION: _two(State.SWITCHED_ON),
        HALT_OPTION: _ramps(1, State.OPERATION_ENABLED),
        FAULT_REACTION_OPTION: {
            0: Option(Reaction.DISABLE, State.FAULT),
            **_ramps(1, State.FAULT),
        },
    }
)
"""Option codes and their meanings, by the index of the option code object."""

ABORT_CONNECTION: Mapping[int, Command | State | None] = MappingProxyType(
    {0: None, 1: State.FAULT, 2: Command.DISABLE_VOLTAGE, 3: Command.QUICK_STOP}
)
"""Values of 0x6007 (connection lost): no reaction, a fault, or the effect of a command."""

DEFAULTS: Mapping[int, int] = MappingProxyType(
    {
        ABORT_CONNECTION_OPTION: 1,
        QUICK_STOP_OPTION: 2,
        SHUTDOWN_OPTION: 0,
        DISABLE_OPERATION_OPTION: 1,
        HALT_OPTION: 1,
        FAULT_REACTION_OPTION: 2,
    }
)
"""Default of each option code in CiA 402-2, which also applies if the object does not exist."""
