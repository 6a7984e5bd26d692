"""Control socket of a virtual node: state, inputs and fault injection.

Real drives have no such socket. Positions and velocities of a plant are the motor's own counts and counts/s, its torque
and all forces on it per mille of the rated torque; those of an axis are the values on the bus.
"""

from __future__ import annotations

from typing import Annotated, Final

import msgspec

from canopen_control.rpc.messages.declare import Api, Done, Effect, Request

# Bodies in the world of simulated robots; virtual drives and recordings report them.


class WorldShape(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Object in a world: `kind` is "box", "cylinder" (along z), "ellipsoid", or "patch" of the floor.

    `size` are its lengths in m along its own axes; `position` of its middle in m and `rotation`, the quaternion w, x,
    y, z, are those in the world; it `moves` where it can be pushed. It is part of another `robot` where that is named;
    `grip` is the friction of a patch.
    """

    name: str
    kind: str
    size: tuple[float, float, float]
    position: tuple[float, float, float]
    rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    moves: bool = False
    robot: str = ""
    grip: float = 0.0


Inputs = Annotated[int, msgspec.Meta(ge=0, le=0xFFFFFFFF)]


class DriveHello(msgspec.Struct, frozen=True, kw_only=True):
    """Greeting of a virtual node; `channel` is its bus, such as "local:robby", `pid` its process."""

    node_id: int
    name: str = ""
    channel: str = ""
    version: str = ""
    protocol: int = 0
    pid: int = 0


class DriveEvent(msgspec.Struct, frozen=True):
    """Event of the node, as a sentence."""

    text: str


DRIVE: Final[Api[DriveHello, DriveEvent]] = Api("drive", DriveHello, {"event": DriveEvent})


# -- faults


class FaultListing(msgspec.Struct, frozen=True, kw_only=True):
    """Fault that can be injected, and whether it is active.

    `row` is its number in the catalogue of real drives' behaviour (0: not in it), `acts` where it acts, "wire", "node",
    "axis", "input" or "output", `does` what the drive does, `reaction` how a correct master reacts; `once`: it goes off
    by itself.
    """

    name: str
    row: int = 0
    acts: str = ""
    does: str = ""
    reaction: str = ""
    once: bool = False
    on: bool = False


@DRIVE.method("faults", Effect.READS)
class ListFaults(Request[tuple[FaultListing, ...]], frozen=True):
    """Faults available in the node; those of inputs and axes depend on its kind."""


class ActiveFaults(msgspec.Struct, frozen=True):
    """Names of the active faults."""

    active: list[str]


@DRIVE.method("fault", Effect.CHANGES)
class SwitchFault(Request[ActiveFaults], frozen=True, kw_only=True):
    """Inject or clear a fault."""

    name: str
    on: bool = True


# -- quirks


class QuirkListing(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Quirk of a drive: behaviour of a healthy drive of a manufacturer that deviates from the standards.

    `does` is what the drive does, `clause` what it departs from, `source` where that is documented, `acts` where it
    acts, "axis" or "node". One with a strength has a `unit`, a `default` and the bounds `low` and `high`. `on` is how
    it is active, such as "brake_delay=0.5@1".
    """

    name: str
    does: str
    clause: str
    source: str
    acts: str
    unit: str = ""
    default: float | None = None
    low: float | None = None
    high: float | None = None
    on: list[str] = []


@DRIVE.method("quirks", Effect.READS)
class ListQuirks(Request[tuple[QuirkListing, ...]], frozen=True):
    """Quirks available in the node."""


class ActiveQuirks(msgspec.Struct, frozen=True):
    """Active quirks, as text."""

    active: list[str]


@DRIVE.method("quirk", Effect.CHANGES)
class SwitchQuirk(Request[ActiveQuirks], frozen=True, kw_only=True):
    """Switch a quirk on or off; `quirk` is NAME, NAME=VALUE, NAME@AXIS or NAME=VALUE@AXIS."""

    quirk: str
    on: bool = True


# -- what the node is doing


class PlantState(msgspec.Struct, frozen=True):
    """State of a motor: `position` in counts, `velocity` in counts/s, `torque` in per mille of the rated torque."""

    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0


class Spread(msgspec.Struct, frozen=True):
    """Minimum, mean and maximum of many values."""

    min: float
    mean: float
    max: float


class SetPointQuality(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Timing and evenness of set-points in a cyclic mode since the axis was enabled or `restart_quality`.

    `taken` set-points of RPDOs that counted; `missed`: periods in which none counted; `doubled`: set-points that
    repeated the one before in the middle of a motion; `overwritten`: those that the next one replaced before they
    counted. `velocity` is the demanded velocity while the axis moved and `acceleration` the standard deviation of its
    change, by second differences of the demanded position every 0.5 ms, in the units of the drive and seconds.
    `velocity_ripple` and `acceleration_ripple` are the standard deviations of the first and the second differences
    relative to the mean magnitude of the first: 0 for even motion at constant velocity. `phase_us` is the time from a
    SYNC to the arrival of the RPDO with the set-point. What never was is absent.
    """

    taken: int = 0
    missed: int = 0
    doubled: int = 0
    overwritten: int = 0
    velocity: Spread | None = None
    velocity_ripple: float | None = None
    acceleration: float | None = None
    acceleration_ripple: float | None = None
    phase_us: Spread | None = None


class AxisState(msgspec.Struct, frozen=True, kw_only=True):
    """State of an axis: `state` as in CiA 402, such as "SWITCHED_ON", `mode` such as "PV".

    `statusword` is 0x6041, `controlword` 0x6040, `position` 0x6064 and `velocity` 0x606C in the units of the drive;
    `set_points` exists after the axis was enabled in a cyclic mode (CSP, CSV, CST, interpolated position).
    """

    axis: int
    state: str
    statusword: int
    controlword: int
    mode: str
    position: int
    velocity: int
    plant: PlantState
    set_points: SetPointQuality | None = None


class BasePose(msgspec.Struct, frozen=True, omit_defaults=True):
    """Pose of a base in its world at a monotonic time in ns: m and rad, the heading not wrapped.

    `z` is above the floor of its start, `roll` and `pitch` are those of REP 103, positive to the right side and to the
    front down.
    """

    x: float
    y: float
    heading: float
    time_ns: int
    z: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0


class WorldState(msgspec.Struct, frozen=True, omit_defaults=True):
    """State of the axes' common world: the `base` they move, and its `sensors` by name.

    An IMU has its quaternion (w, x, y, z), the angular velocities in rad/s and the accelerations in m/s2, ten numbers;
    a range finder one in m, negative for nothing in reach; a force-torque sensor forces in N and torques in Nm, six.
    `others` are further values of an external engine, by name. In a `changeable` world payloads, pushes, blocked joints
    and another friction can be requested.
    """

    base: BasePose | None = None
    others: dict[str, float] = {}
    sensors: dict[str, tuple[float, ...]] = {}
    changeable: bool = False


class SignalState(msgspec.Struct, frozen=True, omit_defaults=True):
    """Signal of a device other than a drive, such as "di3": an input as applied, an `output` at its terminal."""

    name: str
    value: float
    output: bool = False
    unit: str = ""


class DriveState(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """State of a node: NMT state such as "OPERATIONAL" and errors; `world` if its axes belong to one.

    `error_register` is 0x1001, `errors` are the EMCY codes that are active, `faults` those that are switched on,
    `quirks` too, as they are written. `signals` are those of a device that is not a drive.
    """

    node_id: int
    name: str
    nmt_state: str
    error_register: int
    errors: list[int]
    faults: list[str]
    axes: tuple[AxisState, ...]
    world: WorldState | None = None
    signals: tuple[SignalState, ...] = ()
    quirks: list[str] = []


@DRIVE.method("state", Effect.READS)
class GetDriveState(Request[DriveState], frozen=True):
    """State of the node, its motors and their mechanics."""


# -- what acts on it from outside


@DRIVE.method("inputs", Effect.CHANGES)
class SetInputs(Request[Done], frozen=True, kw_only=True):
    """Set bits of an axis's digital inputs 0x60FD; they stay until they are set again."""

    value: Inputs
    axis: int = 0


@DRIVE.method("signals", Effect.CHANGES)
class SetSignals(Request[Done], frozen=True, kw_only=True):
    """Set inputs of a device other than a drive by name, in units, all or none; they stay until they are set again.

    `values` such as {"di0": 1, "position": 3.14}.
    """

    values: dict[str, float]


@DRIVE.method("plant", Effect.CHANGES)
class SetPlant(Request[Done], frozen=True, kw_only=True):
    """Set numbers of an axis's plant by their names in a plant file, all or none.

    Of one under load these are above all `external` and `friction`, torques in per mille of the rated one, `inertia` as
    a multiple of the motor's own, `backlash` in counts, and whether it is `stalled`.
    """

    numbers: dict[str, float | bool]
    axis: int = 0


@DRIVE.method("restart_quality", Effect.CHANGES)
class RestartQuality(Request[Done], frozen=True, kw_only=True):
    """Restart the set-point statistics of an axis."""

    axis: int = 0


# -- what happens in a world that has physics


@DRIVE.method("payload", Effect.CHANGES)
class AddPayload(Request[Done], frozen=True, kw_only=True):
    """Add `mass` kg to a link at once; a negative mass removes it.

    `on` is the link, "" the heaviest one; `position` in m in its frame.
    """

    mass: float
    on: str = ""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


@DRIVE.method("push", Effect.CHANGES)
class PushRobot(Request[Done], frozen=True, kw_only=True):
    """Push a link (""; the heaviest one) at its centre of mass with a `force` in N along the axes of the world."""

    force: tuple[float, float, float]
    on: str = ""
    seconds: Annotated[float, msgspec.Meta(gt=0)] = 0.2


@DRIVE.method("block", Effect.CHANGES)
class BlockJoint(Request[Done], frozen=True, kw_only=True):
    """Block a joint moved by a drive, or unblock it."""

    joint: str
    on: bool = True


@DRIVE.method("grip", Effect.CHANGES)
class SetGrip(Request[Done], frozen=True, kw_only=True):
    """Change the sliding friction of wheels on the floor, except on patches."""

    friction: Annotated[float, msgspec.Meta(ge=0)]


WorldAct = AddPayload | PushRobot | BlockJoint | SetGrip
"""What may happen in a world, at a time or on request."""


# -- what the axes do together


@DRIVE.method("world", Effect.READS)
class GetWorld(Request[WorldState], frozen=True):
    """True pose of the base moved by the node's axes; the same for every node of that world."""


@DRIVE.method("shapes", Effect.READS)
class GetWorldShapes(Request[tuple[WorldShape, ...]], frozen=True):
    """Present objects of the world other than the robot: patches, boxes, ramps, walls, other robots."""
