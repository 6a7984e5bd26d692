"""What a URDF says beside its joints: which links are round, and which plugins Gazebo is to load.

The law of the file: a link is round if its collision, else its visual, has exactly one cylinder or sphere; nothing here
is a mistake of the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.hardware.urdf import Element

__all__ = ["GazeboPlugin", "gazebo_plugins", "radii"]


@dataclass(frozen=True)
class GazeboPlugin:
    """A `<plugin>` of a `<gazebo>` tag."""

    name: str
    filename: str
    line: int = 0


def gazebo_plugins(root: Element) -> tuple[GazeboPlugin, ...]:
    """Return the plugins of all `<gazebo>` tags of a `<robot>`."""
    return tuple(
        GazeboPlugin(plugin.attributes.get("name", ""), plugin.attributes.get("filename", ""), plugin.line)
        for gazebo in root.children
        if gazebo.tag == "gazebo"
        for plugin in gazebo.children
        if plugin.tag == "plugin"
    )


def radii(root: Element) -> dict[str, float]:
    """Return the radius of every round link of a `<robot>`, in m."""
    found: dict[str, float] = {}
    for link in root.children:
        if link.tag != "link":
            continue
        for tag in ("collision", "visual"):
            radius = _radius([each for each in link.children if each.tag == tag])
            if radius is not None:
                found.setdefault(link.attributes.get("name", ""), radius)
    return found


def _radius(shapes: Sequence[Element]) -> float | None:
    """Return the radius of the only round shape among these."""
    geometries = [geometry.children for each in shapes if (geometry := each.child("geometry")) is not None]
    round_ones = [one for children in geometries for one in children if one.tag in ("cylinder", "sphere")]
    if len(round_ones) != 1:
        return None
    try:
        return float(round_ones[0].attributes.get("radius", ""))
    except ValueError:
        return None
