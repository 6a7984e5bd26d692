"""Common parameters of wheeled bases: odometry frames and covariances, and limits of the twist axes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeVar

from canopen_control.controllers.limiters import VelocityLimits
from canopen_control.controllers.params import CommonParams
from canopen_control.errors import RobotConfigError
from canopen_control.yamlfile.convert import setting

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from canopen_control.controllers.params import Params


NAN: Final = math.nan
Six = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class TwistAxisLimits:
    """Limits of one twist axis, such as `linear.x`; nan means unlimited."""

    max_velocity: float = setting(
        NAN, low=0.0, nan=True, help="largest velocity in m/s or rad/s, forward or to the left"
    )
    min_velocity: float = setting(
        NAN,
        high=0.0,
        nan=True,
        help="largest velocity backward or to the right, as a negative number; absent: minus `max_velocity`",
    )
    max_acceleration: float = setting(
        NAN, low=0.0, nan=True, help="acceleration limit in m/s^2 or rad/s^2, forward or to the left"
    )
    max_deceleration: float = setting(
        NAN,
        high=0.0,
        nan=True,
        help="deceleration limit of a motion forward or to the left, as a negative number; absent: minus "
        "`max_acceleration`",
    )
    max_acceleration_reverse: float = setting(
        NAN, high=0.0, nan=True, help="acceleration limit backward or to the right, as a negative number"
    )
    max_deceleration_reverse: float = setting(
        NAN, low=0.0, nan=True, help="deceleration limit of a motion backward or to the right"
    )
    max_jerk: float = setting(NAN, low=0.0, nan=True, help="upper jerk limit in m/s^3 or rad/s^3")
    min_jerk: float = setting(
        NAN, high=0.0, nan=True, help="lower jerk limit, a negative number; absent: minus `max_jerk`"
    )

    @property
    def freezes(self) -> bool:
        """Whether the jerk limit is 0, which keeps the axis at constant speed."""
        return self.max_jerk == 0.0

    def limits(self) -> VelocityLimits:
        return VelocityLimits(
            self.min_velocity,
            self.max_velocity,
            self.max_acceleration_reverse,
            self.max_acceleration,
            self.max_deceleration,
            self.max_deceleration_reverse,
            self.min_jerk,
            self.max_jerk,
        )


@dataclass(frozen=True)
class BaseParams(CommonParams):
    """Parameters of every wheeled base: odometry frames, their transform, and covariances."""

    odom_frame_id: str = setting("odom", help="parent frame of the odometry")
    base_frame_id: str = setting("base_link", help="child frame of the odometry")
    pose_covariance_diagonal: Six = setting(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), help="diagonal of the covariance of the odometry's pose"
    )
    twist_covariance_diagonal: Six = setting(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), help="diagonal of the covariance of the odometry's twist"
    )
    enable_odom_tf: bool = setting(
        True, help="whether to publish the transform from the odometry frame to the base frame"
    )

    def mistakes(self) -> Iterator[tuple[bool, str]]:
        """Yield pairs of a flag, True for a failed check, and the error text; the base class has no checks."""
        return iter(())

    def frame_ids(self, namespace: str = "") -> tuple[str, str]:
        """Return the names of the odometry frame and the base frame, with prefix."""
        prefix = self.frame_prefix(namespace)
        return prefix + self.odom_frame_id, prefix + self.base_frame_id

    def frame_prefix(self, namespace: str) -> str:
        """Return the prefix of frame names for a namespace; empty by default."""
        del namespace
        return ""


P = TypeVar("P", bound=BaseParams)


@dataclass(frozen=True)
class PrefixedParams(BaseParams):
    """Parameters of a base whose frame names may have a prefix."""

    tf_frame_prefix_enable: bool = setting(True, help="whether frame names get a prefix")
    tf_frame_prefix: str = setting("", help="prefix of the frame names; empty: the namespace")

    def frame_prefix(self, namespace: str) -> str:
        return tf_prefix(self.tf_frame_prefix, namespace, enable=self.tf_frame_prefix_enable)


def read_checked(params: Params, cls: type[P], renames: Mapping[str, str] | None = None) -> P:
    """Return the checked parameters of a base, or raise RobotConfigError with all errors in them.

    `renames` is passed to `Params.read`.
    """
    settings = params.read(cls, renames)
    refuse(params.name, settings.mistakes())
    return settings


def refuse(name: str, checks: Iterable[tuple[bool, str]]) -> None:
    """Raise RobotConfigError with the texts of all failed checks, if any; `name` is the controller."""
    problems = [text for wrong, text in checks if wrong]
    if problems:
        raise RobotConfigError("\n".join(f"{name}: {text}" for text in problems))


def tf_prefix(prefix: str, namespace: str, *, enable: bool = True) -> str:
    """Return the prefix of frame names: `prefix` with its first `~` as the namespace, or the namespace alone."""
    if not enable:
        return ""
    text = prefix.replace("~", namespace, 1) if prefix else namespace
    if not text.endswith("/"):
        text += "/"
    return text.removeprefix("/")
