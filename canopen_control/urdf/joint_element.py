"""`<joint>` elements of a robot description: limits, mimic joints, and poses of the child links.

As in URDF and robot_state_publisher, the pose of a child link is the joint's origin followed by the joint's motion: a
rotation about its axis or a translation along its axis. A mimic joint is at `multiplier * position + offset` of another
joint. Fixed joints never move; the position of a floating or planar joint is unknown. Lengths are in m, angles in rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.errors import nearest
from canopen_control.urdf.document import NOWHERE, ElementPlace
from canopen_control.urdf.geometry import ORIGIN, Pose, Vector, about, along, from_rpy

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.urdf.document import Element, UrdfDocument


# -- command and state interfaces: standard names, bounds and initial values


POSITION: Final = "position"
VELOCITY: Final = "velocity"
EFFORT: Final = "effort"
ACCELERATION: Final = "acceleration"


@dataclass(frozen=True)
class InterfaceInfo:
    """Tag <command_interface> or <state_interface> with its bounds and initial value in SI units.

    Absent bounds are infinite, an absent initial value is nan. `limited` is False if `<limits enable="false"/>` is in
    the tag or in its joint.
    """

    name: str
    minimum: float = -math.inf
    maximum: float = math.inf
    initial_value: float = math.nan
    parameters: dict[str, str] = field(default_factory=dict)
    limited: bool = True


def read_interfaces(document: UrdfDocument, element: Element, tag: str) -> dict[str, InterfaceInfo]:
    """Read the interfaces of a <joint>, <sensor> or <gpio>; `tag` is command_interface or state_interface."""
    interfaces: dict[str, InterfaceInfo] = {}
    for child in element.children:
        if child.tag != tag:
            continue
        name, parameters = document.name(child), child.parameters()
        if name in interfaces:
            document.error(child, f"{element.attributes.get('name')}: {tag} {name!r} is defined twice")
        low = document.decimal(child, parameters, "min", -math.inf)
        high = document.decimal(child, parameters, "max", math.inf)
        initial = document.decimal(child, parameters, "initial_value", math.nan)
        limited = _limited(element) and _limited(child)
        interfaces[name] = InterfaceInfo(name, low, high, initial, parameters, limited)
    return interfaces


def _limited(element: Element) -> bool:
    limits = element.child("limits")
    return limits is None or limits.attributes.get("enable", "true").strip().lower() != "false"


_TYPES: Final = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_NEEDS_LIMITS: Final = ("revolute", "prismatic")
_TURNING: Final = ("revolute", "continuous")


@dataclass(frozen=True)
class UrdfLimits:
    """Tag <limit> of a joint, in rad or m, rad/s or m/s, and Nm or N; absent limits are infinite."""

    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    effort: float = math.inf

    @property
    def speed(self) -> float:
        """Maximum velocity; infinite if the limit is 0, which exporters write for an unknown limit."""
        return abs(self.velocity) or math.inf

    @property
    def max_effort(self) -> float:
        """Magnitude of the effort limit (ros2_control takes the absolute value); 0 permits no effort."""
        return abs(self.effort)


@dataclass(frozen=True, slots=True)
class HardLimits:
    """All limits of a joint in SI units, with rad, s and Nm (m and N if prismatic); infinite if unlimited."""

    min_position: float = -math.inf
    max_position: float = math.inf
    max_velocity: float = math.inf
    max_effort: float = math.inf
    max_acceleration: float = math.inf
    max_deceleration: float = math.inf
    max_jerk: float = math.inf

    @property
    def has_ends(self) -> bool:
        """Whether the position has a lower or an upper limit."""
        return math.isfinite(self.min_position) or math.isfinite(self.max_position)


@dataclass(frozen=True)
class SoftLimits:
    """Tag <safety_controller> of a joint: soft position limits in rad or m; both are 0 if absent.

    `k_position` is in 1/s, `k_velocity` in Nm s/rad (N s/m if prismatic).
    """

    lower: float = 0.0
    upper: float = 0.0
    k_position: float = 0.0
    k_velocity: float = 0.0


@dataclass(frozen=True)
class Dynamics:
    """Tag <dynamics> of a joint: damping in Nm s/rad (N s/m), friction in Nm (N); None if absent."""

    damping: float | None = None
    friction: float | None = None


@dataclass(frozen=True)
class Mimic:
    """Tag <mimic> of a joint, whose position is `multiplier` times the position of `joint`, plus `offset`."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


class Transform(NamedTuple):
    """Transform from the frame `parent` to the frame `child`, as published on /tf."""

    parent: str
    child: str
    pose: Pose


@dataclass(frozen=True)
class Joint:
    """Joint between two links; `origin` is its pose in the parent link's frame, `place` the position of the tag."""

    name: str
    type: str
    parent: str
    child: str
    origin: Pose = ORIGIN
    axis: Vector = (1.0, 0.0, 0.0)
    limits: UrdfLimits = UrdfLimits()
    mimic: Mimic | None = None
    place: ElementPlace = NOWHERE
    soft: SoftLimits | None = None
    dynamics: Dynamics = Dynamics()

    @property
    def fixed(self) -> bool:
        return self.type == "fixed"

    def range_of(self, interface: str) -> tuple[float, float]:
        """Return the minimum and maximum of an interface according to the URDF limits; infinite if unlimited."""
        limits = self.limits
        if interface == POSITION:
            return (-math.inf, math.inf) if self.type == "continuous" else (limits.lower, limits.upper)
        most = {VELOCITY: limits.speed, EFFORT: limits.max_effort}.get(interface, math.inf)
        return -most, most

    def position_in(self, positions: Mapping[str, float | None]) -> float:
        """Return the position of the joint in rad or m, or nan if unknown; `positions` maps joint names to positions.

        The position of a mimic joint is derived from that of the joint it mimics.
        """
        position = positions.get(self.mimic.joint if self.mimic is not None else self.name)
        if position is None:
            return math.nan
        return position if self.mimic is None else self.mimic.multiplier * position + self.mimic.offset

    def pose(self, position: float) -> Pose:
        """Return the pose of the child link in the parent link's frame when the joint is at `position`, in rad or m."""
        if self.type in _TURNING:
            return self.origin.then(Pose(rotation=about(self.axis, position)))
        if self.type == "prismatic":
            return self.origin.then(Pose(along(self.axis, position)))
        return self.origin

    def transform(self, positions: Mapping[str, float | None]) -> Transform | None:
        """Return the transform from the parent link to the child link, or None if unknown.

        It is unknown if the position is unknown, or if the joint is planar or floating.
        """
        position = 0.0 if self.fixed else self.position_in(positions)
        if not math.isfinite(position) or not (self.fixed or self.type in _TURNING or self.type == "prismatic"):
            return None
        return Transform(self.parent, self.child, self.pose(position))


def read_joint(document: UrdfDocument, element: Element) -> Joint:
    """Return the joint of a <joint> tag; record errors in the document."""
    name = document.name(element)
    kind = element.attributes.get("type", "")
    if kind not in _TYPES:
        document.error(element, f"joint {name}: unknown type {kind!r}{nearest(kind, _TYPES)}")
    axis, limit = element.child("axis"), element.child("limit")
    if limit is None and kind in _NEEDS_LIMITS:
        document.error(element, f"joint {name}: a {kind} joint needs <limit lower= upper= effort= velocity=>")
    return Joint(
        name,
        kind,
        _link_of(document, element, "parent"),
        _link_of(document, element, "child"),
        _origin(document, element.child("origin")),
        document.vector(axis, "xyz", (1.0, 0.0, 0.0)),
        _limits(document, limit, kind),
        _mimic(document, element),
        element.place,
        _soft_limits(document, element.child("safety_controller")),
        _dynamics(document, element.child("dynamics")),
    )


def _origin(document: UrdfDocument, element: Element | None) -> Pose:
    xyz, rpy = (document.vector(element, key, (0.0, 0.0, 0.0)) for key in ("xyz", "rpy"))
    return Pose(xyz, from_rpy(rpy))


def _link_of(document: UrdfDocument, element: Element, tag: str) -> str:
    child = element.child(tag)
    if child is None or not child.attributes.get("link"):
        document.error(element, f"joint {element.attributes.get('name', '?')}: <{tag} link=...> is missing")
        return ""
    return child.attributes["link"]


def _limits(document: UrdfDocument, limit: Element | None, kind: str) -> UrdfLimits:
    if limit is None:
        return UrdfLimits()
    bounded = kind in _NEEDS_LIMITS
    return UrdfLimits(
        document.number(limit, "lower", 0.0) if bounded else -math.inf,
        document.number(limit, "upper", 0.0) if bounded else math.inf,
        document.number(limit, "velocity", math.inf),
        document.number(limit, "effort", math.inf),
    )


def _soft_limits(document: UrdfDocument, safety: Element | None) -> SoftLimits | None:
    if safety is None:
        return None
    keys = ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity")
    return SoftLimits(*(document.number(safety, key, 0.0) for key in keys))


def _dynamics(document: UrdfDocument, dynamics: Element | None) -> Dynamics:
    if dynamics is None:
        return Dynamics()
    attributes = dynamics.attributes
    return Dynamics(
        *(document.number(dynamics, key, 0.0) if key in attributes else None for key in ("damping", "friction"))
    )


def _mimic(document: UrdfDocument, element: Element) -> Mimic | None:
    mimic = element.child("mimic")
    if mimic is None:
        return None
    multiplier, offset = document.number(mimic, "multiplier", 1.0), document.number(mimic, "offset", 0.0)
    return Mimic(mimic.attributes.get("joint", ""), multiplier, offset)
